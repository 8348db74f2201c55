"""Pose2Sim: folders with a ``Config.toml``, each trial with a folder ``kinematics`` of models and motions.

Every pair of a scaled model and a motion of the same name is a trial: one, or one for each person in sight.
Pose2Sim measures no ground reaction: an ExternalLoads file is taken from the trial's folder where somebody
has put one.
"""

from __future__ import annotations

import glob
from pathlib import Path

from scso_nlp.studies.layouts.folders import folders, loads_in, matching, one
from scso_nlp.studies.trial import Trial

CONFIG = "Config.toml"


def find(root: Path) -> tuple[Trial, ...]:
    """Find all motions of all trials."""
    return tuple(trial for folder in folders(root) for trial in _trials(root, folder))


def _trials(root: Path, folder: Path) -> list[Trial]:
    inside = folder / "kinematics"
    is_known = any((place / CONFIG).is_file() for place in (folder, *folder.parents[:2]))
    if not is_known or not inside.is_dir():
        return []
    loads, no_loads = one("external_loads", loads_in(folder), "an ExternalLoads file beside kinematics")
    motions = matching(inside, "*.mot")
    above = folder.relative_to(root).parts[:-1]
    found = []
    for motion in motions:
        own = matching(inside, f"{glob.escape(motion.stem)}.osim") or matching(inside, "*.osim")
        model, no_model = one("model", own, "kinematics/*.osim")
        found.append(
            Trial(
                subject="_".join(above) or root.name,
                trial=folder.name if len(motions) == 1 else f"{folder.name}_{motion.stem}",
                source=motion,
                settings={**model, "coordinates": motion, **loads, "name": motion.stem},
                missing=(*no_model, *no_loads),
            )
        )
    return found
