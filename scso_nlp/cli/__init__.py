"""The command line: one file per command. Each command imports what it needs only when it runs."""

from typing import Annotated

import typer

from scso_nlp.cli.batch import batch
from scso_nlp.cli.calibrate import calibrate
from scso_nlp.cli.compare import compare
from scso_nlp.cli.doctor import doctor
from scso_nlp.cli.example import example
from scso_nlp.cli.info import info
from scso_nlp.cli.init import init
from scso_nlp.cli.plot import plot
from scso_nlp.cli.reach import reach
from scso_nlp.cli.report import report
from scso_nlp.cli.run import run
from scso_nlp.versions import versions

__all__ = ["app"]

app = typer.Typer(
    name="scso",
    help="Muscle forces with mechanically stable joints, from OpenSim models and motions.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(asked: bool) -> None:
    """Print the package's version and those of what it stands on."""
    if asked:
        typer.echo("\n".join(f"{name} {version}" for name, version in versions().items()))
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print versions and end.")
    ] = False,
) -> None:
    """Take the options that stand before a command."""


for _command in (run, batch, init, info, doctor, example, compare, plot, report, reach, calibrate):
    app.command()(_command)
