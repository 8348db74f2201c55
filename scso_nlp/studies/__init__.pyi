"""Public names of studies, each once."""

from .planning import Plan as Plan
from .planning import PlannedTrial as PlannedTrial
from .planning import plan as plan
from .record import Outcome as Outcome
from .record import Study as Study
from .record import StudyTrial as StudyTrial
from .record import outcomes as outcomes
from .running import StudyResult as StudyResult
from .running import run as run
