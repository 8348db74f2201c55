"""Moment balance, stability margins, and what stability is within reach (which is solved for)."""
