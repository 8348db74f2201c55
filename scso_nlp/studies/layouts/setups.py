"""Plain folders: ``subject/trial/setup.xml``, setups of OpenSim's AnalyzeTool at any depth.

The first folder below the study's is the subject, those below it are the trial. A folder with several setups
holds as many trials, each with the name of its file; a folder whose ``scso.toml`` names a motion is one.
"""

from __future__ import annotations

from pathlib import Path

from scso_nlp.exceptions import DataError
from scso_nlp.studies.layouts.folders import folders, matching, says
from scso_nlp.studies.trial import SETTINGS_FILE, Trial, settings_in

#: A settings file that names one of these describes a trial.
MOTIONS = ("setup", "coordinates", "states")


def find(root: Path) -> tuple[Trial, ...]:
    """Find all setups, and settings files that name a motion."""
    found: list[Trial] = []
    for folder in folders(root):
        if _names_motion(folder):
            found.append(named(root, folder / SETTINGS_FILE, is_alone=True))
            continue
        setups = [path for path in matching(folder, "*.xml") if is_setup(path)]
        found += [named(root, path, is_alone=len(setups) == 1) for path in setups]
    return tuple(found)


def _names_motion(folder: Path) -> bool:
    """Tell if a folder's settings file describes a trial; one that cannot be read does, to be told of."""
    try:
        return any(name in settings_in(folder) for name in MOTIONS)
    except DataError:
        return True


def is_setup(path: Path) -> bool:
    """Tell if a file is a setup of AnalyzeTool with a StaticOptimization."""
    return says(path, b"<AnalyzeTool", b"<StaticOptimization")


def named(root: Path, source: Path, *, is_alone: bool) -> Trial:
    """Make the trial of a setup or settings file, called by its place in the study.

    Parameters
    ----------
    root : Path
    source : Path
    is_alone : bool
        There is no other in its folder, so that the folder names it.

    Returns
    -------
    Trial
    """
    parts = source.parent.relative_to(root).parts
    if len(parts) < 2 or not is_alone:
        parts += (source.stem,)
    subject, *rest = parts if len(parts) > 1 else (root.name, *parts)
    settings = {} if source.name == SETTINGS_FILE else {"setup": source}
    return Trial(subject=subject, trial="_".join(rest), source=source, settings=settings)
