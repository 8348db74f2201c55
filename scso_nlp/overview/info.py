"""What a model, or a setup with its model, holds: everything that one asks before the first run."""

from __future__ import annotations

import dataclasses
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scso_nlp.arguments import checked
from scso_nlp.exceptions import FileFormatError
from scso_nlp.files import absolute, require_file
from scso_nlp.opensim.description import ModelDescription, describe_model
from scso_nlp.opensim.setup_xml import MotionInput, read_xml
from scso_nlp.overview import model_tables
from scso_nlp.overview.input_tables import input_tables
from scso_nlp.overview.inputs import Inputs, look_at_inputs
from scso_nlp.overview.table import Table, as_html, as_text
from scso_nlp.report.record import plain
from scso_nlp.settings import read_settings

#: Columns of text where there is no terminal.
WIDTH = 120


@dataclass(frozen=True, kw_only=True)
@checked
class ModelInfo:
    """What a model holds, and what a setup brings beside it.

    In a notebook it shows itself as tables; ``print`` writes them as text.

    Attributes
    ----------
    source : Path
        The file that was asked about.
    model : Path
    description : ModelDescription
        Bodies, joints and their axes, coordinates, muscles, actuators.
    inputs : Inputs or None
        Columns, units, times and loads of a setup's motion; None for a model alone.
    files_of_actuators : mapping of str to str
        Name of the force set file that each actuator of a setup is from; those of the model are not there.
    """

    source: Path
    model: Path
    description: ModelDescription
    inputs: Inputs | None = None
    files_of_actuators: dict[str, str] = dataclasses.field(default_factory=dict)

    @property
    def stable_rows(self) -> tuple[str, ...]:
        """Rows that muscles can keep: a free coordinate turns the axis and a muscle pulls about it."""
        return tuple(axis.row for axis in self.description.axes if axis.can_be_stable)

    def tables(self, *, muscles: bool = False) -> tuple[Table, ...]:
        """Sort it into tables of text.

        Parameters
        ----------
        muscles : bool
            One row for every muscle, instead of one for every class of them.

        Returns
        -------
        tuple of Table
        """
        model = self.description
        of_muscles = model_tables.muscles if muscles else model_tables.muscle_classes
        return (
            model_tables.model(model, self.model),
            model_tables.joints(model),
            model_tables.coordinates(model, self.inputs),
            of_muscles(model),
            *model_tables.actuators(model, self.files_of_actuators),
            *(input_tables(self.inputs, model) if self.inputs else ()),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as text, numbers, lists and mappings."""
        return {"stable_rows": list(self.stable_rows), **plain(self)}

    def to_json(self) -> str:
        """Return :meth:`to_dict` as text."""
        return json.dumps(self.to_dict(), indent=2, ensure_ascii=False)

    def __str__(self) -> str:
        return as_text(self.tables(), WIDTH)

    def __repr__(self) -> str:
        model = self.description
        return (
            f"ModelInfo({self.source.name}: {len(model.bodies) - 1} bodies, {len(model.joints)} joints, "
            f"{len(model.coordinates)} coordinates, {len(model.muscles)} muscles, "
            f"{len(self.stable_rows)} rows that can be made stable)"
        )

    def _repr_html_(self) -> str:
        return as_html(self.tables())


@checked
def info(source: str | os.PathLike[str] | MotionInput) -> ModelInfo:
    """Say what a model holds, and whether a setup's files fit it.

    Parameters
    ----------
    source : path or MotionInput
        A model (``.osim``), an AnalyzeTool setup file, a settings file (``.toml``), or a description.

    Returns
    -------
    ModelInfo

    Raises
    ------
    DataError, FileFormatError
        A file that is missing, or is not what it should be. Files of a motion that do not fit the model raise
        nothing: that is in :attr:`~scso_nlp.overview.inputs.Inputs.problem`.
    EngineError
        OpenSim refused the model.

    Notes
    -----
    OpenSim reads the model in a process of its own; with a setup it also tries some frames of the motion,
    which tells whether units are proven wrong.

    Examples
    --------
    >>> found = scso.info(example_folder("elbow") / "elbow.osim")
    >>> [joint.name for joint in found.description.joints]
    ['elbow']
    """
    if isinstance(source, MotionInput):
        return _of_motion(source.motion, source)
    path = absolute(source)
    require_file(path)
    if _is_model(path):
        return ModelInfo(source=path, model=path, description=describe_model(path))
    return _of_motion(path, read_settings(path)[0].motion)


def _of_motion(source: Path, motion: MotionInput) -> ModelInfo:
    description = describe_model(
        motion.model,
        actuators=motion.actuators,
        replace_force_set=motion.replace_force_set,
        outside_force_set=motion.outside_force_set,
    )
    return ModelInfo(
        source=source,
        model=motion.model,
        description=description,
        inputs=look_at_inputs(motion, description),
        files_of_actuators=_files_of_actuators(motion),
    )


def _is_model(path: Path) -> bool:
    if path.suffix.lower() in (".osim", ".toml"):
        return path.suffix.lower() == ".osim"
    root = read_xml(path)
    return root.tag == "Model" or root.find("Model") is not None


def _files_of_actuators(motion: MotionInput) -> dict[str, str]:
    found = {}
    for path in motion.actuators:
        try:
            members = read_xml(path).iterfind(".//objects/*[@name]")
        # OpenSim reads some that the standard does not allow
        except FileFormatError:
            continue
        found.update({member.get("name", ""): path.name for member in members})
    return found
