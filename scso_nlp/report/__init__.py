"""What a run leaves behind: result files, and a page about them."""
