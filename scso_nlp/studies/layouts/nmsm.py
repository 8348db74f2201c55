"""NMSM Pipeline: ``preprocessed/{IKData,IDData,GRFData,EMGData}``, files of a trial under one name.

Every motion in ``IKData`` is a trial. The model lies above ``preprocessed``. Files in ``GRFData`` say nothing
of the bodies that they act on: an ExternalLoads file that names it is taken where there is one.
"""

from __future__ import annotations

from pathlib import Path

from scso_nlp.exceptions import DataError
from scso_nlp.opensim.setup_xml import read_external_loads
from scso_nlp.studies.layouts.folders import folders, loads_in, matching, nearest, one
from scso_nlp.studies.trial import Trial

#: Folders beside ``IKData``, one of which is there.
BESIDE = ("IDData", "GRFData", "EMGData", "MAData")


def find(root: Path) -> tuple[Trial, ...]:
    """Find all motions."""
    return tuple(trial for folder in folders(root) for trial in _trials(root, folder))


def _trials(root: Path, folder: Path) -> list[Trial]:
    motions = matching(folder / "IKData", "*.mot", "*.sto")
    if not motions or not any((folder / name).is_dir() for name in BESIDE):
        return []
    subject = folder.parent if folder.name == "preprocessed" and folder != root else folder
    model, no_model = one(
        "model", nearest(subject, root, "*.osim", "[Mm]odel*/*.osim"), "*.osim above preprocessed"
    )
    loads = {path: _data(path) for place in (folder, folder / "GRFData", subject) for path in loads_in(place)}
    found = []
    for motion in motions:
        fitting = tuple(path for path, data in loads.items() if data == motion.stem)
        external, no_loads = one(
            "external_loads", fitting, f"an ExternalLoads file for GRFData/{motion.stem}.*"
        )
        found.append(
            Trial(
                subject="_".join(subject.relative_to(root).parts) or root.name,
                trial=motion.stem,
                source=motion,
                settings={**model, "coordinates": motion, **external, "name": motion.stem},
                missing=(*no_model, *no_loads),
            )
        )
    return found


def _data(path: Path) -> str:
    """Name the data of an ExternalLoads file; empty where they are not there."""
    try:
        return read_external_loads(path).data.stem
    except DataError:
        return ""
