"""One motion with its muscles and actuators: what a problem, and every term of it, is about."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from scso_nlp.arguments import checked
from scso_nlp.muscles import ActuatorParameters, MuscleParameters
from scso_nlp.trajectory import MotionTrajectory
from scso_nlp.validation import same_names


@dataclass(frozen=True, kw_only=True)
@checked
class Motion:
    """Time series of a motion, and the constants of the muscles and actuators that make it.

    Attributes
    ----------
    trajectory : MotionTrajectory
    muscles : MuscleParameters
        Same names in the same order as the trajectory's.
    actuators : ActuatorParameters
        Likewise; none by default.

    Raises
    ------
    NameMismatchError
        Muscles or actuators differ from the trajectory's.
    """

    trajectory: MotionTrajectory
    muscles: MuscleParameters
    actuators: ActuatorParameters = field(default_factory=ActuatorParameters)

    def __post_init__(self) -> None:
        same_names("muscles", self.trajectory.muscles, self.muscles.muscles)
        same_names("actuators", self.trajectory.actuators, self.actuators.actuators)

    @property
    def name(self) -> str:
        """Name of the analysis; result files start with it."""
        return self.trajectory.name

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return self.trajectory.n_frames

    def __repr__(self) -> str:
        return repr(self.trajectory)

    def _repr_html_(self) -> str:
        return self.trajectory._repr_html_()

    def frames(self, start: int | Iterable[int], stop: int | None = None) -> Motion:
        """Keep some frames, as :meth:`MotionTrajectory.frames`."""
        return replace(self, trajectory=self.trajectory.frames(start, stop))
