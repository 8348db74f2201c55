"""What a solve gives back: arrays, a status per frame, rows with margins and multipliers, a report.

Data only: :mod:`scso_nlp.solver.judge` is the one place where they are made of a solver's unknowns.
"""

from scso_nlp.solution.muscle import MuscleResult as MuscleResult
from scso_nlp.solution.rows import ACTIVE_MARGIN as ACTIVE_MARGIN
from scso_nlp.solution.rows import SMALLEST_EIGENVALUE as SMALLEST_EIGENVALUE
from scso_nlp.solution.rows import MatrixResult as MatrixResult
from scso_nlp.solution.rows import MomentBalance as MomentBalance
from scso_nlp.solution.rows import Optimality as Optimality
from scso_nlp.solution.rows import RowResult as RowResult
from scso_nlp.solution.rows import StabilityMargin as StabilityMargin
from scso_nlp.solution.solution import Solution as Solution
from scso_nlp.solution.solution import SolveFailed as SolveFailed
from scso_nlp.solution.solution import SolveReport as SolveReport
from scso_nlp.solution.status import InfeasibilityProof as InfeasibilityProof
from scso_nlp.solution.status import Shortfall as Shortfall
from scso_nlp.solution.status import Status as Status
