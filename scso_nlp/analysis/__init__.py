"""Numbers, comparisons and figures made from solutions; nothing here solves anything."""
