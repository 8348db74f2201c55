"""Names that stand in a model's own files, so that a wrong one is refused before OpenSim starts."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from scso_nlp.exceptions import FileFormatError, NameMismatchError
from scso_nlp.opensim.setup_xml import MotionInput, read_xml
from scso_nlp.validation import matches

#: Names that OpenSim makes up for parts without one, and paths of parts that share one.
_MADE_UP = re.compile(r".*(_to_|_coord_\d|/).*")


@dataclass(frozen=True, kw_only=True)
class ModelNames:
    """Names of what a model and its force sets hold, wherever it stands; more than OpenSim may make of it.

    Attributes
    ----------
    source : Path
        The model.
    coordinates, joints, muscles, forces : tuple of str
        `forces` are muscles, actuators and all else in a force set. All are empty where the files are not
        well-formed XML and only OpenSim can read them: then nothing is refused.
    """

    source: Path
    coordinates: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    muscles: tuple[str, ...] = ()
    forces: tuple[str, ...] = ()

    def require(self, kind: str, wanted: Iterable[str], known: Sequence[str]) -> None:
        """Refuse names and patterns of a user's that fit none that is known.

        Raises
        ------
        NameMismatchError
            The closest names are suggested.
        """
        for name in wanted if known else ():
            if _MADE_UP.fullmatch(name):
                continue
            try:
                matches(kind, name, known)
            except NameMismatchError as error:
                raise NameMismatchError(f"{self.source}: {error}") from None


def model_names(motion: MotionInput) -> ModelNames:
    """Read the names of a motion input's model and force sets.

    Parameters
    ----------
    motion : MotionInput

    Returns
    -------
    ModelNames

    Raises
    ------
    DataError
        A file that cannot be read.
    """
    try:
        return names_in(motion.model, *motion.actuators)
    except FileFormatError:
        return ModelNames(source=motion.model)


def names_in(model: Path, *force_sets: Path) -> ModelNames:
    """Read the names of a model and force sets.

    Parameters
    ----------
    model : Path
    *force_sets : Path

    Returns
    -------
    ModelNames

    Raises
    ------
    DataError
        A file that cannot be read.
    FileFormatError
        A file that is not well-formed XML.
    """
    roots = [read_xml(path) for path in (model, *force_sets)]
    named = [element for root in roots for element in root.iter() if element.get("name")]
    joints = [element for root in roots for element in _members(root, "JointSet")]
    forces = [
        element for root in roots for kind in ("ForceSet", "ActuatorSet") for element in _members(root, kind)
    ]
    muscles = [element for element in named if "Muscle" in element.tag]
    return ModelNames(
        source=model,
        coordinates=_names(element for element in named if element.tag == "Coordinate"),
        joints=_names((*(element for element in named if element.tag.endswith("Joint")), *joints)),
        muscles=_names(muscles),
        forces=_names((*muscles, *forces, *(e for e in named if e.tag.endswith(("Actuator", "Motor"))))),
    )


def _members(root: Element, kind: str) -> list[Element]:
    return [element for group in root.iter(kind) for element in group.iterfind("objects/*")]


def _names(elements: Iterable[Element]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for element in elements if (name := element.get("name", "").strip())))
