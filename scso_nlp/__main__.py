"""Run the command line with ``python -m scso_nlp``."""

from scso_nlp.cli import app

app(prog_name="scso")
