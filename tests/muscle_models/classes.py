"""The muscle classes under the names of their files, and their curves at OpenSim's default parameters."""

from __future__ import annotations

import functools

import casadi as ca

from scso_nlp.muscle_models.degroote2016 import DeGroote2016Curves
from scso_nlp.muscle_models.millard2012 import Millard2012Curves
from scso_nlp.muscle_models.rigid_tendon_muscle import RigidTendonMuscleCurves
from scso_nlp.muscle_models.thelen2003 import Thelen2003Curves

thelen2003, millard2012, degroote2016 = Thelen2003Curves(), Millard2012Curves(), DeGroote2016Curves()
rigid_tendon_muscle = RigidTendonMuscleCurves()
ELASTIC = [thelen2003, millard2012, degroote2016]
ALL = [*ELASTIC, rigid_tendon_muscle]


def name_of(curves):
    return curves.OPENSIM_CLASS


class AtDefaults:
    """A muscle class whose curves take their arguments alone, at OpenSim's default parameters."""

    def __init__(self, curves):
        self.curves = curves

    def __getattr__(self, name):
        return functools.partial(getattr(self.curves, name), parameters=self.curves.DEFAULT_CURVE_PARAMETERS)


def slope(curve):
    """Slope of an elementwise function by automatic differentiation: of numbers, a number or a column."""

    def evaluate(at):
        at = ca.DM(at)
        x = ca.MX.sym("x", at.shape)
        derivative = ca.jtimes(curve(x), x, ca.DM.ones(at.shape))
        return ca.Function("slope", [x], [ca.densify(derivative)])(at)

    return evaluate
