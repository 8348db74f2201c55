"""Settings to begin with for a model and motion: rows that muscles can keep, and a gain at which they can."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.declared_settings import SETTINGS, template
from scso_nlp.muscle_models.stiffness_law import PUBLISHED_GAINS
from scso_nlp.run import describe, extract
from scso_nlp.settings import read_settings
from scso_nlp.solver.advice import PRICE, rounded_up
from scso_nlp.solver.feasible_gain import feasible_q

#: At most so many frames, evenly spread, are asked for the gain that they need.
MOST_FRAMES = 200
#: Share by which the gain is above the least that all frames need, where muscles would be at their limits.
RESERVE = 0.1


@dataclass(frozen=True, kw_only=True)
@checked
class FirstSettings:
    """Stability settings that suit a motion.

    Attributes
    ----------
    setup : Path
        The AnalyzeTool setup file.
    joints, rows : tuple of str
        Joints with axes that muscles can make stable, and these axes.
    left_out : str
        What is left out, and why.
    q : float [-]
    soft : float or None [objective per N·m/rad]
        None where all levels can be kept at `q`.
    least : tuple of float [-]
        Least gain at which each frame that was looked at has an answer; infinite where no gain is enough, NaN
        where muscles and actuators cannot make the moments.
    """

    setup: Path
    joints: tuple[str, ...]
    rows: tuple[str, ...]
    left_out: str
    q: float
    soft: float | None
    least: tuple[float, ...]

    @property
    def n_enough(self) -> int:
        """Number of frames that have an answer at `q`."""
        return sum(gain <= self.q for gain in self.least)

    @property
    def reasons(self) -> dict[str, str]:
        """Why each setting is as it is, one sentence each, by name."""
        n, known = len(self.least), [gain for gain in self.least if math.isfinite(gain)]
        without_moments = sum(map(math.isnan, self.least))
        gain = f"{self.n_enough} of {n} frames looked at have an answer at q = {self.q:g}; "
        gain += f"they need {min(known):.3g} to {max(known):.3g}" if known else "no gain is enough"
        gain += "; published gains are {:g} to {:g}, that of the trunk is 5".format(*PUBLISHED_GAINS)
        if without_moments:
            gain += (
                f"; in {without_moments} frames muscles and actuators cannot make the moments at any gain: "
            )
            gain += "add reserves (--actuators RESERVES.xml)"
        rows = f"rows about {', '.join(self.rows)}"
        rows += f"; left out where {self.left_out}" if self.left_out else ""
        hard = "none, as all levels can be kept"
        if self.soft is not None:
            n_short = n - self.n_enough - without_moments
            hard = f"{n_short} frames cannot keep their levels and miss them at this price"
        return {"q": gain, "joints": rows, "soft": hard}

    def text(self, folder: Path) -> str:
        """Write the settings file, paths relative to its folder.

        Parameters
        ----------
        folder : Path
            Where the file will stand.

        Returns
        -------
        str
        """
        setup = self.setup.resolve()
        inside = setup.is_relative_to(folder.resolve())
        path = os.path.relpath(setup, folder.resolve()) if inside else str(setup)
        values = {
            "setup": json.dumps(path, ensure_ascii=False),
            "q": f"{self.q:g}",
            "joints": json.dumps(list(self.joints), ensure_ascii=False),
        }
        if self.soft is not None:
            values["soft"] = f"{self.soft:g}"
        return template(values, self.reasons)


@checked
def first_settings(setup: str | os.PathLike[str]) -> FirstSettings:
    """Find stability settings of ``potvin-brown`` that suit the motion of a setup file.

    Parameters
    ----------
    setup : path
        AnalyzeTool setup file.

    Returns
    -------
    FirstSettings
        Levels are hard where all frames can keep level 0 at a gain within the published ones.

    Raises
    ------
    DataError, EngineError
        Input that cannot be used, or muscles can make no joint axis stable.
    """
    settings, output = read_settings(setup, {"stability": "potvin-brown"})
    motion = extract(settings, output)
    problem = describe(settings, motion)
    step = math.ceil(motion.n_frames / MOST_FRAMES)
    least = feasible_q(problem.frames(range(0, motion.n_frames, step)))
    # NaN where no gain is of any help
    most = float(np.max(least, where=~np.isnan(least), initial=0.0))
    is_hard = most <= PUBLISHED_GAINS[1]
    default = float(SETTINGS["q"].default)
    (stability,) = (term for term in problem.constraints if isinstance(term, JointStability))
    rows = stability.row_names(motion)
    return FirstSettings(
        setup=Path(setup),
        joints=tuple(dict.fromkeys(row.rpartition("_")[0] for row in rows)),
        rows=rows,
        left_out=stability.left_out(motion),
        q=min(max(default, rounded_up((1 + RESERVE) * most)), PUBLISHED_GAINS[1])
        if is_hard
        else PUBLISHED_GAINS[1],
        soft=None if is_hard else PRICE,
        least=tuple(least.tolist()),
    )
