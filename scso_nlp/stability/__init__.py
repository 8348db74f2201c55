"""The numbers that go into stability rows: path curvature, moment arms and external work. NumPy only."""

from scso_nlp.stability.buckling import buckling_factor
from scso_nlp.stability.external_work import external_work
from scso_nlp.stability.potvin_brown import potvin_brown
from scso_nlp.stability.rows import (
    AXES,
    StabilityRows,
    geometric_stability,
    joint_stability,
    select_rows,
)

__all__ = [
    "AXES",
    "StabilityRows",
    "buckling_factor",
    "external_work",
    "geometric_stability",
    "joint_stability",
    "potvin_brown",
    "select_rows",
]
