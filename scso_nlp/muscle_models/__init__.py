"""Muscle models: from activation to tendon force, one file per model."""

from scso_nlp.muscle_models.compliant_tendon import CompliantTendon as CompliantTendon
from scso_nlp.muscle_models.muscle_model import MuscleModel as MuscleModel
from scso_nlp.muscle_models.no_physiology import NoPhysiology as NoPhysiology
from scso_nlp.muscle_models.rigid_tendon import RigidTendon as RigidTendon
