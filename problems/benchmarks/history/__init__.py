"""Small cases over commits, for asv: ``asv run --config problems/benchmarks/asv.conf.json COMMITS``."""
