"""Public names of studies, each once."""

from .page import write_cohort as write_cohort
from .planning import Plan as Plan
from .planning import PlannedTrial as PlannedTrial
from .planning import plan as plan
from .record import Outcome as Outcome
from .record import Study as Study
from .record import StudyTrial as StudyTrial
from .record import outcomes as outcomes
from .results import StudyTables as StudyTables
from .results import read as read
from .results import write_tables as write_tables
from .running import StudyResult as StudyResult
from .running import run as run
