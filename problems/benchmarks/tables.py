"""The command line of tables that compare answers with OpenSim's, one row for every setup."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from problems.benchmarks.setups import write_setups
from scso_nlp.exceptions import ScsoError
from scso_nlp.opensim.engine import opensim_version


def title(setup: Path) -> str:
    """Say how a table calls a setup."""
    return f"{setup.parent.name}/{setup.name}"


def table_command(
    about: str | None, heads: Sequence[str], row: Callable[[Path, int], str], *, frames: int, of_what: str
) -> None:
    """Print a table row by row, and write it, as the command line asks.

    Parameters
    ----------
    about : str
        For ``--help``.
    heads : sequence of str
    row : callable
        Takes a setup and about how many frames, gives the row as Markdown. What it raises as RuntimeError
        or ScsoError stands in the row instead.
    frames : int
        By default.
    of_what : str
        Which frames these are, for ``--help``.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("setups", nargs="*", type=Path, metavar="SETUP.xml")
    parser.add_argument(
        "--data", type=Path, help="folder of the third-party data: compare those without setup"
    )
    parser.add_argument("--frames", type=int, default=frames, help=f"{of_what}, about")
    parser.add_argument("--output", type=Path, help="write the table into this file too")
    arguments = parser.parse_args()
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    print(f"OpenSim {opensim_version()}\n" + "\n".join(lines), flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        made = write_setups(arguments.data.resolve(), Path(scratch)) if arguments.data else []
        for setup in [*arguments.setups, *made]:
            try:
                lines.append(row(setup.resolve(), arguments.frames))
            except (RuntimeError, ScsoError) as error:
                lines.append(f"| {title(setup)} | no comparison: {error} |")
            print(lines[-1], flush=True)
    if arguments.output is not None:
        arguments.output.write_text("\n".join(lines) + "\n", encoding="utf-8")
