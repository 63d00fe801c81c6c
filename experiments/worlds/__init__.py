"""What several studies film: kinds of flights and what spoils their recordings."""
