"""OpenCap: sessions with ``sessionMetadata.yaml`` and ``OpenSimData/{Model,Kinematics,Dynamics}``.

Every motion in ``Kinematics`` is a trial of the person that the metadata name. OpenCap measures no ground
reaction: an ExternalLoads file is taken from ``Dynamics/<trial>`` where somebody has put one.
"""

from __future__ import annotations

from pathlib import Path

from scso_nlp.exceptions import FileFormatError
from scso_nlp.files import LARGEST_TOML, read_text
from scso_nlp.studies.layouts.folders import folders, loads_in, matching, one
from scso_nlp.studies.trial import Trial

METADATA = "sessionMetadata.yaml"


def find(root: Path) -> tuple[Trial, ...]:
    """Find all motions of all sessions."""
    return tuple(trial for session in folders(root) for trial in _trials(session))


def _trials(session: Path) -> list[Trial]:
    data = session / "OpenSimData"
    if not (session / METADATA).is_file() or not data.is_dir():
        return []
    # one folder of model files, in sessions of several cameras one for each set-up of them
    models = matching(data / "Model", "*.osim", "*/*.osim")
    model, no_model = one("model", models, "OpenSimData/Model/*.osim")
    found = []
    for motion in matching(data / "Kinematics", "*.mot", "*.sto", "*/*.mot"):
        loads, no_loads = one(
            "external_loads", loads_in(data / "Dynamics" / motion.stem), f"Dynamics/{motion.stem}/*.xml"
        )
        found.append(
            Trial(
                subject=_subject(session),
                trial=motion.stem,
                source=motion,
                settings={**model, "coordinates": motion, **loads, "name": motion.stem},
                missing=(*no_model, *no_loads),
            )
        )
    return found


def _subject(session: Path) -> str:
    """Name the person as the metadata do, or else by the session."""
    import yaml  # comes with Dask

    path = session / METADATA
    try:
        values = yaml.safe_load(read_text(path, LARGEST_TOML))
    except yaml.YAMLError as error:
        raise FileFormatError(f"{path} is not YAML: {' '.join(str(error).split())}") from None
    told = values.get("subjectID") if isinstance(values, dict) else None
    return str(told) if told else session.name
