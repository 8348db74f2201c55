"""Published passive stiffness of the lumbar spine, spread over the coordinates of a model.

The stiffness of tissue without activation that a model does not hold itself. Whoever has measured
numbers gives them to the stability constraints directly, as ``passive_stiffness`` by row or as a
``passive_matrix``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError
from scso_nlp.validation import FloatArray, positions, read_only

#: Passive stiffness of one lumbar level by direction of turn [N·m/deg]. Schmidt et al. (1998), in vitro.
LUMBAR_LEVEL_STIFFNESS: Mapping[str, float] = MappingProxyType(
    {"axial": 8.4, "flexion": 1.8, "extension": 2.6, "lateral": 2.3}
)

#: Levels from L1/L2 to L5/S1.
LUMBAR_LEVELS = 5

#: How far a user's matrix may be from symmetric, over its largest entry [-]: round-off of a text file.
_SYMMETRY_TOLERANCE = 1e-9


@dataclass(frozen=True, kw_only=True)
@checked
class LumbarJoint:
    """What a model's joint stands for: so many levels in series, and which of its rows turn which way.

    Attributes
    ----------
    levels : int
        Lumbar levels that the joint lumps; stiffness in series is that of one level over their number.
    rows : mapping of str to str
        From a coordinate or stability row to ``"axial"``, ``"flexion"``, ``"extension"`` or ``"lateral"``.

    Raises
    ------
    DataError
        Levels below 1, or an unknown direction.
    """

    levels: int
    rows: Mapping[str, str]

    def __post_init__(self) -> None:
        if self.levels < 1:
            raise DataError(f"levels is {self.levels}, expected at least 1")
        for row, direction in self.rows.items():
            if direction not in LUMBAR_LEVEL_STIFFNESS:
                raise DataError(
                    f"direction of {row!r} is {direction!r}, expected one of "
                    f"{', '.join(LUMBAR_LEVEL_STIFFNESS)}"
                )
        object.__setattr__(self, "rows", MappingProxyType(dict(self.rows)))


@checked
def lumbar_passive_stiffness(*joints: LumbarJoint) -> dict[str, float]:
    r"""Passive stiffness of lumped lumbar joints by row.

    .. math:: K = \frac{180}{\pi} \frac{K_{level}}{n}

    Parameters
    ----------
    *joints : LumbarJoint

    Returns
    -------
    dict of str to float [N·m/rad]
        For ``passive_stiffness`` of a stability constraint.

    Raises
    ------
    DataError
        A row that stands in two joints.

    Notes
    -----
    The numbers hold for small turns from the neutral posture of specimens without muscles and without
    preload; flexed or loaded spines are stiffer.

    References
    ----------
    Schmidt et al. (1998), the passive stiffness per lumbar level.

    Examples
    --------
    >>> joint = scso.LumbarJoint(levels=5, rows={"L5_S1_z": "flexion", "L5_S1_x": "lateral"})
    >>> {row: round(value, 2) for row, value in scso.lumbar_passive_stiffness(joint).items()}
    {'L5_S1_z': 20.63, 'L5_S1_x': 26.36}
    """
    stiffness: dict[str, float] = {}
    for joint in joints:
        for row, direction in joint.rows.items():
            if row in stiffness:
                raise DataError(f"the row {row!r} stands in two joints, expected it in one")
            stiffness[row] = math.degrees(LUMBAR_LEVEL_STIFFNESS[direction]) / joint.levels
    return stiffness


def passive_matrix(
    coordinates: tuple[str, ...], matrix: object, names: tuple[str, ...] | None = None
) -> FloatArray:
    """Put a measured stiffness matrix into the order of the Hessian's coordinates.

    Parameters
    ----------
    coordinates : tuple of str
        Of the Hessian.
    matrix : array_like, shape (n_names, n_names) [N·m/rad]
        Symmetric and positive semi-definite.
    names : tuple of str, optional
        Coordinates of the matrix's rows and columns; those of the Hessian by default. Coordinates that the
        matrix does not name get zeros.

    Returns
    -------
    ndarray, shape (n_coordinates, n_coordinates) [N·m/rad]
        For ``passive_matrix`` of :class:`scso_nlp.constraints.HessianStability`.

    Raises
    ------
    NameMismatchError
        A name that is no coordinate of the Hessian.
    DataError
        Not square, not symmetric, or with a negative eigenvalue: no passive tissue is like that.
    """
    names = coordinates if names is None else tuple(names)
    given = read_only("passive_matrix", matrix, (len(names), len(names)), "n_names, n_names")
    largest = float(np.abs(given).max(initial=0.0))
    skew = np.abs(given - given.T)
    if skew.max(initial=0.0) > _SYMMETRY_TOLERANCE * largest:
        i, j = (int(index) for index in np.unravel_index(skew.argmax(), skew.shape))
        raise DataError(
            f"passive_matrix is not symmetric: {given[i, j]:g} at ({names[i]}, {names[j]}), "
            f"{given[j, i]:g} at ({names[j]}, {names[i]}) N·m/rad"
        )
    least = float(np.linalg.eigvalsh(given).min(initial=0.0))
    if least < -_SYMMETRY_TOLERANCE * max(largest, 1.0):
        raise DataError(f"passive_matrix has the eigenvalue {least:g} N·m/rad, expected none below 0")
    where = positions("coordinate", names, coordinates)
    full = np.zeros((len(coordinates), len(coordinates)))
    full[np.ix_(where, where)] = (given + given.T) / 2
    return full
