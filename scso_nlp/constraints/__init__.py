"""Constraints: what must hold, one file per term."""

from scso_nlp.constraints.activation_dynamics import ActivationDynamics as ActivationDynamics
from scso_nlp.constraints.activation_rate import ActivationRate as ActivationRate
from scso_nlp.constraints.constraint import FrameConstraint as FrameConstraint
from scso_nlp.constraints.constraint import FramePairConstraint as FramePairConstraint
from scso_nlp.constraints.coordinate_stability import CoordinateStability as CoordinateStability
from scso_nlp.constraints.hessian_stability import HessianStability as HessianStability
from scso_nlp.constraints.joint_stability import JointStability as JointStability
from scso_nlp.constraints.moment_equilibrium import MomentEquilibrium as MomentEquilibrium
