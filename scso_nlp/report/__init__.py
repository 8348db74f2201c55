"""What a reader gets to see of results: one page."""
