"""``scso doctor``: what a setup holds, and what to do with it."""

from __future__ import annotations

import json
import shutil
import sys
from typing import Annotated, Any

import typer

from scso_nlp.cli.exit_codes import BAD_INPUT, FRAME_FAILED, exit_codes
from scso_nlp.cli.options import Source, Verbose, with_every_setting
from scso_nlp.progress import stages_shown
from scso_nlp.signals import undisturbed


@with_every_setting
def doctor(
    source: Source,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="All of it, as JSON.")] = False,
    verbose: Verbose = False,
    **changes: Any,
) -> None:
    """Say what scso info says of a setup, and advise: stability that is there, the q it takes, reserves.

    Takes the settings of scso run and writes no files; without stability among them it looks at every row
    that muscles can keep. Exit code 0: nothing stands in the way; 1: some frame has no answer, or a row is
    out of reach; 2: input that cannot be used.
    """
    with exit_codes(verbose):
        typer.echo(f"{source.name}: asking OpenSim ...", err=True)
        with undisturbed():
            from scso_nlp.overview.advice import advice_tables
            from scso_nlp.overview.diagnosis import diagnose
            from scso_nlp.overview.info import WIDTH, info
            from scso_nlp.overview.inputs import collected_notes
            from scso_nlp.overview.table import as_text
            from scso_nlp.settings import read_settings

        width = shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDTH
        settings, where = read_settings(source, changes)
        found = info(settings.motion)
        if not as_json:
            typer.echo(as_text(found.tables(), width))
        if found.inputs is not None and found.inputs.problem:
            if as_json:
                typer.echo(_as_json(info=found.to_dict()))
            raise typer.Exit(BAD_INPUT)
        typer.echo(f"{source.name}: solving with and without stability ...", err=True)
        # what there is to be said has been said above
        with collected_notes(), stages_shown(delay=0.0):
            diagnosis = diagnose(settings, where, found.description)
        clamped = {c.name: c.range for c in found.description.coordinates if c.is_clamped}
        advice = advice_tables(diagnosis, str(source), clamped)
        if as_json:
            about = {**diagnosis.to_dict(), "advice": advice[-1].notes}
            typer.echo(_as_json(info=found.to_dict(), **about))
        else:
            typer.echo(as_text(advice, width), nl=False)
        solved = diagnosis.baseline.is_solved.all()
        if not solved or any(row.is_out_of_reach.any() for row in diagnosis.rows):
            raise typer.Exit(FRAME_FAILED)


def _as_json(**known: Any) -> str:
    return json.dumps(known, indent=2, ensure_ascii=False)
