"""Constraints: what must hold, one file per term."""
