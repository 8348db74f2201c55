"""``scso reach``: how much stability a motion can have, before anything is asked of its muscles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from scso_nlp.cli.exit_codes import FRAME_FAILED, exit_codes
from scso_nlp.cli.options import Source, Verbose, with_every_setting
from scso_nlp.messages import STAGES
from scso_nlp.progress import stages_shown
from scso_nlp.signals import undisturbed

if TYPE_CHECKING:
    from scso_nlp.solver.reach import Reach
    from scso_nlp.validation import FloatArray


@with_every_setting
def reach(source: Source, *, verbose: Verbose = False, **changes: Any) -> None:
    """Say how much stability every row can have, all other rows kept, and from which q on it costs nothing.

    Takes the settings of scso run and writes no files. Exit code 0: all levels can be reached; 1: some
    cannot; 2: input that cannot be used.
    """
    with exit_codes(verbose):
        with undisturbed():
            from scso_nlp.exceptions import ProblemError
            from scso_nlp.run import describe, extract
            from scso_nlp.settings import read_settings
            from scso_nlp.solver.critical_gain import critical_q
            from scso_nlp.solver.reach import reachable_stability

        settings, where = read_settings(source, changes)
        if settings.stability is None:
            raise ProblemError("stability is off, choose what to look at with --stability")
        with stages_shown(delay=0.0):
            problem = describe(settings, extract(settings, where))
            STAGES.info("solving %d frames for the most stability of each row", problem.motion.n_frames)
            found = reachable_stability(problem)
            critical = critical_q(problem)
        typer.echo(f"{problem.motion.name}: {problem.motion.n_frames} frames")
        if problem.coupled_terms:
            typer.echo(f"  left out, because they couple frames: {', '.join(problem.coupled_terms)}")
        for each in found:
            for line in _rows(each):
                typer.echo(line)
        typer.echo(_gain(critical, problem.motion.trajectory.time))
        if not all(each.is_reachable.all() for each in found):
            raise typer.Exit(FRAME_FAILED)


def _rows(reach: Reach) -> list[str]:
    """One line per row: level, least reach and when, frames out of reach, what would help there."""
    import numpy as np

    from scso_nlp.trajectory import time_text

    width = max(len(row) for row in reach.rows)
    lines = [f"  {'row':<{width}}  {'level':>8}  {'least reach':>11}  [N·m/rad], all other rows kept"]
    for i, row in enumerate(reach.rows):
        highest = reach.highest[:, i]
        alone = int(np.isnan(highest).sum())
        if alone == highest.size:
            lines.append(f"  {row:<{width}}  the other rows alone are out of reach in every frame")
            continue
        k = int(np.nanargmin(highest))
        text = f"  {row:<{width}}  {reach.level[i]:8.4g}  {highest[k]:11.4g}  "
        text += f"at t = {time_text(reach.time[k])} s"
        beyond = int((~reach.is_reachable_by_row[:, i]).sum())
        if beyond:
            text += f"; out of reach in {beyond} of {highest.size} frames"
            if helpers := reach.helpers(k, i):
                text += f", stronger {', '.join(helpers)} would help"
        lines.append(text)
    return lines


def _gain(critical: FloatArray, time: FloatArray) -> str:
    """Say from which q on static optimization keeps all rows."""
    import numpy as np

    from scso_nlp.trajectory import time_text

    never = int(np.isinf(critical).sum())
    finite = np.where(np.isfinite(critical), critical, -np.inf)
    k = int(np.argmax(finite))
    if not np.isfinite(finite[k]):
        return "  no stiffness proportional to force makes static optimization keep the rows in any frame"
    text = f"  static optimization keeps all rows from q = {finite[k]:.4g} on (t = {time_text(time[k])} s)"
    return text + (f", but in {never} frames at no q" if never else "")
