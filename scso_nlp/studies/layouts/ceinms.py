"""CEINMS: ``<subject>/<trial>/`` with an inverse kinematics file beside inverse dynamics or EMG.

The motion is ``ik.*``, ``*_ik.*`` or ``*inverse_kinematics*``; inverse dynamics or EMG are named likewise.
The model lies with the trial or above it, loads with the trial.
"""

from __future__ import annotations

import re
from pathlib import Path

from scso_nlp.studies.layouts.folders import folders, loads_in, matching, nearest, one
from scso_nlp.studies.trial import Trial

_MOTION = re.compile(r"(.*_)?ik|.*inverse_?kinematics.*", re.IGNORECASE)
_BESIDE = re.compile(r"(.*_)?id|.*inverse_?dynamics.*|.*emg.*", re.IGNORECASE)


def find(root: Path) -> tuple[Trial, ...]:
    """Find all folders with a motion."""
    return tuple(trial for folder in folders(root) for trial in _trials(root, folder))


def _trials(root: Path, folder: Path) -> list[Trial]:
    files = matching(folder, "*.mot", "*.sto")
    motions = tuple(path for path in files if _MOTION.fullmatch(path.stem))
    if not motions or not any(_BESIDE.fullmatch(path.stem) for path in files):
        return []
    model, no_model = one(
        "model", nearest(folder, root, "*.osim", "[Mm]odel*/*.osim"), "*.osim in this folder or above"
    )
    motion, no_motion = one("coordinates", motions, "ik.mot")
    loads, no_loads = one("external_loads", loads_in(folder), "an ExternalLoads file in this folder")
    *above, trial = folder.relative_to(root).parts or (root.name,)
    return [
        Trial(
            subject="_".join(above) or root.name,
            trial=trial,
            source=folder,
            settings={**model, **motion, **loads, "name": trial},
            missing=(*no_model, *no_motion, *no_loads),
        )
    ]
