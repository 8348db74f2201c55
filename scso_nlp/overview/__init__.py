"""What a model and a setup hold, in tables for a terminal or a notebook, and what to make of it."""
