"""Solving: two verbs, programs for IPOPT, rows for matrix inequalities, and the judge of what comes out."""

from scso_nlp.solver.critical_gain import critical_q as critical_q
from scso_nlp.solver.equal_effort import EqualEffort as EqualEffort
from scso_nlp.solver.equal_effort import at_effort as at_effort
from scso_nlp.solver.extremes import Ranges as Ranges
from scso_nlp.solver.extremes import ranges as ranges
from scso_nlp.solver.feasible_gain import feasible_q as feasible_q
from scso_nlp.solver.ipopt import SolverOptions as SolverOptions
from scso_nlp.solver.judge import observe as observe
from scso_nlp.solver.random_patterns import random_patterns as random_patterns
from scso_nlp.solver.reach import Reach as Reach
from scso_nlp.solver.reach import reachable_stability as reachable_stability
from scso_nlp.solver.verbs import solve_framewise as solve_framewise
from scso_nlp.solver.verbs import solve_trajectory as solve_trajectory
