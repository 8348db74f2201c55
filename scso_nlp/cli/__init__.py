"""The command line: one file per command. Each command imports what it needs only when it runs."""

import typer

from scso_nlp.cli.compare import compare
from scso_nlp.cli.example import example
from scso_nlp.cli.init import init
from scso_nlp.cli.reach import reach
from scso_nlp.cli.report import report
from scso_nlp.cli.run import run

__all__ = ["app"]

app = typer.Typer(
    name="scso",
    help="Muscle forces with mechanically stable joints, from OpenSim models and motions.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for _command in (run, init, example, compare, report, reach):
    app.command()(_command)
