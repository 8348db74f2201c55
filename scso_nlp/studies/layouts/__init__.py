"""Folder layouts that labs have: one file with one recogniser each. A new one is a file and a line here."""

from __future__ import annotations

from pathlib import Path

from scso_nlp.exceptions import DataError
from scso_nlp.studies.layouts import ceinms, nmsm, opencap, pose2sim, setups
from scso_nlp.studies.trial import Trial

#: Recognisers by name; the first that finds a trial decides for the whole folder.
LAYOUTS = {
    "setup files of AnalyzeTool, or scso.toml": setups.find,
    "OpenCap sessions": opencap.find,
    "Pose2Sim trials": pose2sim.find,
    "an NMSM tree": nmsm.find,
    "a CEINMS tree": ceinms.find,
}


def trials_in(root: Path) -> tuple[str, tuple[Trial, ...]]:
    """Find the trials of a folder.

    Parameters
    ----------
    root : Path

    Returns
    -------
    str, tuple of Trial
        The layout's name, and what it found, in order.

    Raises
    ------
    DataError
        No layout that is known, or a file that cannot be read.
    """
    for name, find in LAYOUTS.items():
        if found := find(root):
            return name, found
    raise DataError(
        f"{root} holds no trial: expected {', '.join(LAYOUTS)}; or name the trials in a study file, see the "
        "guide to studies"
    )
