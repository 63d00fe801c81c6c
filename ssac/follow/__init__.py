"""A small and distant object followed where its events are too few to be told from noise alone."""
