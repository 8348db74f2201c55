"""Objectives: what the solver minimises, one file per term."""

from scso_nlp.objectives.activation_effort import ActivationEffort as ActivationEffort
from scso_nlp.objectives.function_objective import FunctionObjective as FunctionObjective
from scso_nlp.objectives.objective import FrameObjective as FrameObjective
from scso_nlp.objectives.objective import FramePairObjective as FramePairObjective
