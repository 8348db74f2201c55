"""What came out of a study, read back from its folder as tables."""

from __future__ import annotations

import functools
import itertools
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.display import card
from scso_nlp.display import table as html_table
from scso_nlp.files import absolute
from scso_nlp.messages import COUNTS
from scso_nlp.progress import stages_shown
from scso_nlp.studies.cycles import POINTS, Curve
from scso_nlp.studies.record import Study, StudyTrial, outcomes, read_study
from scso_nlp.studies.solve import load_motions, read_solve
from scso_nlp.studies.statistics import mean_curves, mean_numbers, paired_differences
from scso_nlp.studies.summary import Number
from scso_nlp.studies.tables import pandas, write_frames
from scso_nlp.validation import FloatArray, positions

if TYPE_CHECKING:
    import pandas as pd

#: What a row of every table is of.
KEYS = ("subject", "trial", "condition")


@dataclass(frozen=True, kw_only=True, eq=False)
class StudyTables:
    """What came out of a study, as tables.

    Attributes
    ----------
    folder : Path
    plan : Study
        What was asked.
    reference : str
        The condition that others are compared with.
    trials : DataFrame
        One row for every trial and condition: state, settings of the grid, verdict.
    table : DataFrame
        The tidy table, one row for every number: subject, trial, condition, quantity, name, statistic,
        value, unit.
    cycles : DataFrame
        One row for every curve over a cycle, its values from p0 to p100.
    """

    folder: Path
    plan: Study
    reference: str
    trials: pd.DataFrame
    table: pd.DataFrame
    cycles: pd.DataFrame

    @property
    def conditions(self) -> tuple[str, ...]:
        """Conditions, the reference first."""
        names = dict.fromkeys(trial.condition for trial in self.plan.trials)
        return (self.reference, *(name for name in names if name != self.reference))

    @property
    def statistics(self) -> pd.DataFrame:
        """Means over people, see :func:`~scso_nlp.studies.statistics.mean_numbers`."""
        return mean_numbers(self.table)

    @property
    def differences(self) -> pd.DataFrame:
        """Conditions less reference: :func:`~scso_nlp.studies.statistics.paired_differences`."""
        return paired_differences(self.table, self.reference)

    @property
    def bands(self) -> pd.DataFrame:
        """Means and spreads of curves, see :func:`~scso_nlp.studies.statistics.mean_curves`."""
        return mean_curves(self.cycles)

    def __str__(self) -> str:
        done = self.trials["state"].eq("done").sum()
        people = self.trials["subject"].nunique()
        recordings = len(self.trials[["subject", "trial"]].drop_duplicates())
        first = (
            f"{self.plan.name}: {recordings} trial{'s' * (recordings != 1)} of {people} "
            f"{'people' if people != 1 else 'person'} by {len(self.conditions)} "
            f"condition{'s' * (len(self.conditions) != 1)}, {done} of {len(self.trials)} done"
        )
        others = self.trials.loc[self.trials["state"].ne("done"), "state"].value_counts(sort=False)
        return "\n".join([first, *(f"{n} {state}" for state, n in others.items())])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        is_done = self.trials["state"].eq("done").groupby(self.trials["condition"], sort=False)
        rows = [(condition, int(done.sum()), int((~done).sum())) for condition, done in is_done]
        return card(str(self), html_table(("condition", "done", "others"), rows))


@checked
def read(folder: str | os.PathLike[str], *, reference: str | None = None) -> StudyTables:
    """Read what came out of a study, from the files of its results.

    Parameters
    ----------
    folder : path
        As ``scso batch`` has written it; trials may still be missing.
    reference : str, optional
        The condition that others are compared with; by default the first without stability rows, or the
        first.

    Returns
    -------
    StudyTables
        A trial whose files cannot be read has the state "unreadable" and a sentence; the others are there.

    Raises
    ------
    DataError
        No study is there.
    FileFormatError
        Its plan is damaged.
    NameMismatchError
        The reference is no condition of it.
    ScsoError
        pandas or pyarrow is not installed.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> plan = scso.studies.plan(example_folder("elbow"), final_time=1.0)
    >>> with TemporaryDirectory() as folder:
    ...     result = scso.studies.run(plan, output=folder, workers=1)
    ...     study = scso.studies.read(folder)
    >>> study
    elbow: 1 trial of 1 person by 1 condition, 1 of 1 done
    >>> study.table.query("name == 'biceps' and statistic == 'peak'")["quantity"].tolist()
    ['activation', 'force']
    """
    pd, folder = pandas(), absolute(folder)
    plan = read_study(folder)
    conditions = tuple(dict.fromkeys(trial.condition for trial in plan.trials))
    if reference is not None:
        positions("condition", (reference,), conditions)
    plain = [trial.condition for trial in plan.trials if trial.settings.get("stability", "off") == "off"]
    trials: list[dict[str, Any]] = []
    numbers: list[tuple[Any, ...]] = []
    about: list[tuple[Any, ...]] = []
    values: list[FloatArray] = []
    with stages_shown():
        for _, group in itertools.groupby(outcomes(folder), lambda pair: (pair[0].subject, pair[0].trial)):
            motions = functools.cache(load_motions)
            for planned, outcome in group:
                keys = (planned.subject, planned.trial, planned.condition)
                solve = read_solve(folder, planned, outcome, motions)
                trials.append(dict(zip(KEYS, keys, strict=True)) | _varied(plan, planned) | solve.row)
                numbers += ((*keys, *number) for number in solve.numbers)
                about += ((*keys, *curve[:-1]) for curve in solve.curves)
                values += (curve.values for curve in solve.curves)
                COUNTS.info("reading results, %d of %d", len(trials), len(plan.trials))
    curves = pd.DataFrame(about, columns=[*KEYS, *Curve._fields[:-1]])
    points = pd.DataFrame(np.array(values).reshape(-1, len(POINTS)), columns=list(POINTS))
    return StudyTables(
        folder=folder,
        plan=plan,
        reference=reference or next(iter((*plain, *conditions)), ""),
        trials=pd.DataFrame(trials, columns=None if trials else list(KEYS)),
        table=pd.DataFrame(numbers, columns=[*KEYS, *Number._fields]),
        cycles=pd.concat([curves, points], axis=1),
    )


def _varied(plan: Study, planned: StudyTrial) -> dict[str, Any]:
    """Give the settings of the grid, numbers as they are where all of them are; all others as text."""
    found = {}
    for key, values in plan.grid.items():
        are_numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
        value = planned.settings.get(key)
        found[f"setting_{key}"] = value if are_numbers or value is None else str(value)
    return found


def write_tables(study: StudyTables) -> tuple[Path, ...]:
    """Write all tables of a study into its folder, as CSV and Parquet.

    Parameters
    ----------
    study : StudyTables

    Returns
    -------
    tuple of Path
        ``trials``, ``summary`` (the tidy table), ``cycles``, ``statistics``, ``differences`` and ``bands``.

    Raises
    ------
    DataError
        A file cannot be written.
    """
    tables = {
        "trials": study.trials,
        "summary": study.table,
        "cycles": study.cycles,
        "statistics": study.statistics,
        "differences": study.differences,
        "bands": study.bands,
    }
    with stages_shown():
        return write_frames(tables, study.folder)
