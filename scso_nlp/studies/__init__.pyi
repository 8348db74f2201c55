"""Public names of studies, each once."""

from .record import Outcome as Outcome
from .record import Study as Study
from .record import StudyTrial as StudyTrial
from .record import outcomes as outcomes
