"""Recordings that several studies share: flights, what spoils them, and public tracks."""
