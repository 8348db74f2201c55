"""IPOPT, called with numbers; its answers as numbers and a status."""

from __future__ import annotations

import contextlib
import functools
import io
import logging
import mmap
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import FrameType

import casadi as ca
import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import EngineError, ProblemError
from scso_nlp.solution import Status
from scso_nlp.solver.threads import one_thread
from scso_nlp.text import shown
from scso_nlp.transcription.build import Nlp
from scso_nlp.validation import FloatArray

_LOG = logging.getLogger("scso_nlp")

#: OpenBLAS, below IPOPT's linear algebra, takes 128 MB at once for every thread [bytes].
BLAS_BUFFER = 2**28

_STATUS = {
    "Solve_Succeeded": Status.SOLVED,
    "Feasible_Point_Found": Status.SOLVED,
    "Solved_To_Acceptable_Level": Status.ACCEPTABLE,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
    "Maximum_CpuTime_Exceeded": Status.ITERATION_LIMIT,
    "Maximum_WallTime_Exceeded": Status.ITERATION_LIMIT,
    "Not_Enough_Degrees_Of_Freedom": Status.INFEASIBLE,
}


#: Error of IPOPT's conditions at which it stays at a start: its push from bounds, times large multipliers, is
#: above tighter ones. The point itself is judged without the push.
_CONFIRMED = 1e-8

#: Barrier parameter of a start at the optimum, over that error [-].
_LAST_BARRIER = 1e-4

#: Options for starts at the optimum: stay there, or give up soon.
_CONFIRMING: dict[str, object] = {
    "warm_start_init_point": "yes",
    "warm_start_bound_push": 1e-14,
    "warm_start_bound_frac": 1e-14,
    "warm_start_slack_bound_push": 1e-14,
    "warm_start_slack_bound_frac": 1e-14,
    "warm_start_mult_bound_push": 1e-12,
    "mu_strategy": "monotone",
}


@dataclass(frozen=True, kw_only=True)
@checked
class SolverOptions:
    """Options of both solvers.

    Attributes
    ----------
    tolerance : float
        IPOPT's scaled optimality tolerance, of solves that do not begin at the optimum.
    max_iterations : int
        Per program: the whole trajectory, or one frame.
    frames_per_program : int
        Where no term couples frames, `solve_trajectory` cuts longer motions into programs of this size at
        most, because one difficult frame shortens the steps of all frames of its program. The answer does
        not depend on it; coupled motions are never cut.
    presolve : bool
        Whether frames with a convex objective and affine rows are first solved one by one, by a sequence of
        quadratic programs: IPOPT then starts at their optima and confirms them. Coupled frames and curved
        rows are solved so together, where they turn out convex; coupled frames with curved equations or
        another objective begin where they are without coupling.
    ipopt : mapping of str to number or str
        Further IPOPT options by their own names; they win.

    Examples
    --------
    >>> cold = scso.SolverOptions(presolve=False, max_iterations=50)
    >>> scso.solve_trajectory(problem, options=cold).activation[1].round(6)
    array([0.347652, 0.143856, 0.047952])
    """

    tolerance: float = 1e-10
    max_iterations: int = 500
    frames_per_program: int = 128
    presolve: bool = True
    ipopt: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 1:
            raise ProblemError(f"tolerance is {self.tolerance:g}, expected a number between 0 and 1")
        for name in ("max_iterations", "frames_per_program"):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or not 1 <= value < 2**31:
                raise ProblemError(f"{name} is {shown(value)}, expected a whole number of at least 1")


@dataclass(frozen=True, kw_only=True)
class IpoptAnswer:
    """Last iterate, multipliers of the rows, status and iteration count of one call."""

    x: FloatArray
    lam_g: FloatArray
    status: Status
    iterations: int


def compile_ipopt(nlp: Nlp, options: SolverOptions, *, confirm_within: int | None = None) -> ca.Function:
    """Make the solver function of a program.

    Parameters
    ----------
    nlp : Nlp
    options : SolverOptions
    confirm_within : int, optional
        Most iterations for starts with multipliers that are the optimum already, to rounding.
    """
    ipopt: dict[str, object] = {
        "tol": options.tolerance,
        "max_iter": options.max_iterations,
        # Powers with a broken exponent are not defined below a bound of 0.
        "bound_relax_factor": 0.0,
        "mu_strategy": "monotone" if nlp.rows_are_affine else "adaptive",
        "print_level": 0,
        "sb": "yes",
    }
    if nlp.rows_are_affine:
        ipopt |= {"jac_c_constant": "yes", "jac_d_constant": "yes"}
        if nlp.objective_is_quadratic:
            ipopt["hessian_constant"] = "yes"
    if confirm_within is not None:
        tolerance = max(options.tolerance, _CONFIRMED)
        ipopt |= _CONFIRMING | {"tol": tolerance, "mu_init": tolerance * _LAST_BARRIER}
        ipopt["max_iter"] = confirm_within
    if _LOG.isEnabledFor(logging.DEBUG):
        ipopt["print_level"] = 5
    ipopt |= dict(options.ipopt)
    casadi_options = {
        "ipopt": ipopt,
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": _LOG.isEnabledFor(logging.DEBUG),
        "calc_lam_p": False,  # multipliers of the parameters are not used and cost a gradient
        **nlp.derivatives,
    }
    try:
        return ca.nlpsol("solver", "ipopt", {"x": nlp.x, "p": nlp.p, "f": nlp.f, "g": nlp.g}, casadi_options)
    except (RuntimeError, NotImplementedError) as error:
        last = str(error).strip().splitlines()[-1]
        raise ProblemError(
            f"IPOPT refused the program or its options {dict(options.ipopt)}: {last}"
        ) from None


def call_ipopt(
    solver: ca.Function,
    *,
    x0: FloatArray,
    p: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    row_bounds: tuple[FloatArray, FloatArray],
    multipliers: tuple[FloatArray, FloatArray] | None = None,
) -> IpoptAnswer:
    """Solve once.

    Parameters
    ----------
    solver : ca.Function
    x0 : ndarray, shape (n_unknowns,)
    p : ndarray, shape (n_parameters,)
    bounds : pair of ndarray, shape (n_unknowns,)
    row_bounds : pair of ndarray, shape (n_rows,)
    multipliers : pair of ndarray, shapes (n_unknowns,) and (n_rows,), optional
        To begin with, of bounds and rows; only a confirming solver looks at them.

    Returns
    -------
    IpoptAnswer

    Notes
    -----
    What a signal handler raises meanwhile, such as KeyboardInterrupt, ends the solve and is raised from here.
    """
    _require_memory()
    given = {"x0": x0, "p": p, "lbx": bounds[0], "ubx": bounds[1], "lbg": row_bounds[0], "ubg": row_bounds[1]}
    if multipliers is not None:
        given["lam_x0"], given["lam_g0"] = multipliers
    with _interruptible(), one_thread(of_ipopt=True):
        answer = solver(**given)
    stats = solver.stats()
    status = _STATUS.get(stats["return_status"], Status.NUMERICAL_ERROR)
    _LOG.debug("IPOPT: %s after %d iterations", stats["return_status"], stats["iter_count"])
    x = np.asarray(answer["x"]).ravel()
    if not np.isfinite(x).all():
        status = Status.NUMERICAL_ERROR
    return IpoptAnswer(
        x=x, lam_g=np.asarray(answer["lam_g"]).ravel(), status=status, iterations=int(stats["iter_count"])
    )


@functools.cache
def _require_memory() -> None:
    """Raise unless IPOPT's linear algebra can get its buffers: without them it asks again for ever."""
    try:
        mmap.mmap(-1, BLAS_BUFFER).close()
    except OSError as error:
        raise EngineError(
            f"the solver needs {BLAS_BUFFER / 2**20:.0f} MB of memory, which the system does not give "
            f"({error.strerror or error}): raise the limit of this process (ulimit -v)"
        ) from None


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """Raise after the block what a signal handler has raised within it.

    CasADi lets Python's signal handlers run at every evaluation and stops IPOPT if one raises, but then drops
    the exception and says so on stderr. Python runs handlers in its main thread only.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    raised: list[BaseException] = []

    def remembering(handler: Callable[[int, FrameType | None], object]) -> Callable[..., None]:
        def remember(number: int, frame: FrameType | None) -> None:
            try:
                handler(number, frame)
            except BaseException as error:
                raised.append(error)
                quiet.enter_context(contextlib.redirect_stderr(io.StringIO()))
                raise

        return remember

    previous = {number: signal.getsignal(number) for number in signal.valid_signals()}
    handlers = {number: handler for number, handler in previous.items() if callable(handler)}
    own = {number: remembering(handler) for number, handler in handlers.items()}
    with contextlib.ExitStack() as quiet:
        try:
            for number, handler in own.items():
                signal.signal(number, handler)
            yield
        except BaseException:
            if raised:
                raise raised[0] from None
            raise
        finally:
            for number, handler in own.items():
                # a handler may have put another one in its place
                if signal.getsignal(number) is handler:
                    signal.signal(number, handlers[number])
    if raised:
        raise raised[0]
