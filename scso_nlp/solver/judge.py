"""The one place where unknowns become what a user receives.

Everything is evaluated from the arrays of the solution, unscaled: rows, matrices and their eigenvalues,
margins, balances, violations, statuses, and how well the conditions of an optimum hold. No solver grades its
own work.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.constraints.stability_constraint import StabilityConstraint
from scso_nlp.exceptions import NameMismatchError
from scso_nlp.solution import (
    SMALLEST_EIGENVALUE,
    InfeasibilityProof,
    MatrixResult,
    MomentBalance,
    RowResult,
    Shortfall,
    Solution,
    SolveReport,
    StabilityMargin,
    Status,
)
from scso_nlp.solver.feasibility import FEASIBILITY_TOLERANCE, Impossible, contradiction, worst_rows
from scso_nlp.solver.optimality import OPTIMALITY_TOLERANCE, optimality_of
from scso_nlp.solver.threads import one_thread
from scso_nlp.stability.hessian import smallest_eigenvalues
from scso_nlp.transcription.describe import FrameProgram, describe
from scso_nlp.transcription.layout import PROBLEM
from scso_nlp.transcription.rows import MatrixBlock, RowBlock
from scso_nlp.transcription.turns import matrix_models, matrix_sizes
from scso_nlp.validation import BoolArray, FloatArray

#: A frame whose rows are missed by more than this much of their scale is not solved [-].
LOOSE_VIOLATION = 1e-4
#: Rows that miss by less than this share of what their entries add up to are kept, whatever their unit [-].
ROUNDING = 1e-10
#: A frame that is further from its optimum than this is not solved [-].
LOOSE_OPTIMALITY = 1e-3


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What solving a program left: scaled unknowns, row multipliers, statuses and what was seen before.

    Attributes
    ----------
    program : FrameProgram
        With the rows that were chosen for its matrix inequalities.
    unknowns : ndarray, shape (n_frames, n_unknowns)
        NaN in frames for which no solver was called.
    multipliers : pair of ndarray, shapes (n_frames, n_rows) and (n_frames - 1, n_pair_rows)
        In the solver's sign and scale, of the unweighted objective of unknowns over `unit`; NaN where there
        are none.
    status : tuple of Status
    impossible : tuple of Impossible
        Rows proven to contradict each other while solving.
    unit : ndarray, shape (n_frames,), or None
        1 if not given, and where the objective has no degree.
    """

    program: FrameProgram
    unknowns: FloatArray
    multipliers: tuple[FloatArray, FloatArray]
    status: tuple[Status, ...]
    impossible: tuple[Impossible, ...] = ()
    unit: FloatArray | None = None


def judge(outcome: Outcome, report: SolveReport, *, is_graded: bool = True) -> Solution:
    """Turn what a solver left into a solution.

    Parameters
    ----------
    outcome : Outcome
    report : SolveReport
    is_graded : bool
        Hold frames against the conditions of an optimum too, not only against their rows. False for a point
        that nobody called an optimum.

    Returns
    -------
    Solution
    """
    program = outcome.program
    motion = program.problem.motion
    missing = np.asarray(np.isnan(outcome.unknowns).any(axis=1))
    finite = np.nan_to_num(outcome.unknowns)
    optimality = optimality_of(program, finite, outcome.multipliers, ~missing, outcome.unit)
    missed = _missed_eigenvalues(program, finite)
    optimality = replace(optimality, feasibility=np.maximum(optimality.feasibility, missed))
    multipliers = outcome.multipliers
    if outcome.unit is not None and program.degree is not None:
        multipliers = (multipliers[0] * outcome.unit[:, None] ** program.degree, multipliers[1])
    rows = _row_results(program, finite, multipliers, missing)
    matrices = _matrix_results(program, finite, multipliers[0], missing)
    worst = np.nan_to_num(optimality.worst, nan=np.inf) if is_graded else np.zeros(missing.size)
    status, shortfalls, proofs = _statuses(outcome, rows, matrices, optimality.feasibility, worst)
    solved: BoolArray = np.array([s.is_solved for s in status])
    parts = program.layout.split(outcome.unknowns * program.layout.scale)
    activation, control = (parts.pop((PROBLEM, name)) for name in ("activation", "control"))
    force = _blanked(program.tendon_force.values(finite, program.arrays), missing)
    return Solution(
        problem=program.problem,
        frame_status=status,
        activation=activation,
        control=control,
        tendon_force=force,
        actuator_force=control * motion.actuators.optimal_force,
        variables={f"{owner}.{name}": values for (owner, name), values in parts.items()},
        quantities={
            name: _blanked(piece.values(finite, program.arrays), missing)
            for name, piece in program.quantities.items()
        },
        rows=rows,
        matrices=matrices,
        stability=_stability(program, rows, matrices, solved),
        moment_balance=_moment_balance(program, force, control, solved),
        optimality=optimality,
        objective_terms=_objective_terms(program, finite, solved),
        violation=_violations(program, finite, rows, matrices, solved),
        shortfalls=shortfalls,
        infeasibility=proofs,
        report=report,
    )


def unknowns_of(program: FrameProgram, solution: Solution | None) -> FloatArray:
    """Scaled unknowns (n_frames, n_unknowns) of a solution; what it lacks is from the terms' own guesses."""
    guess = program.layout.rows("guess", program.time.size)
    if solution is None:
        return guess / program.layout.scale
    parts = {(PROBLEM, "activation"): solution.activation, (PROBLEM, "control"): solution.control}
    parts |= {tuple(name.rsplit(".", 1)): values for name, values in solution.variables.items()}  # type: ignore[misc]
    given = program.layout.join(parts, guess)
    return np.where(np.isfinite(given), given, guess) / program.layout.scale


@checked
def observe(solution: Solution, *constraints: StabilityConstraint) -> Solution:
    """Evaluate further stability constraints at a solution.

    Parameters
    ----------
    solution : Solution
    *constraints : StabilityConstraint
        Those of the solution's own stability constraints that bear the same name give way.

    Returns
    -------
    Solution
        The same, with the constraints' rows, matrices, quantities and margins besides.

    Raises
    ------
    NameMismatchError
        A constraint that has the name of one that the solution kept.

    Examples
    --------
    >>> softer = scso.JointStability(axes=["z"], q=0.0, label="without muscle stiffness")
    >>> scso.observe(solution, softer).stability.rows
    ('elbow_z', 'elbow_z')
    """
    kept = {term.name for term in solution.problem.constraints}
    twice = [term.name for term in constraints if term.name in kept]
    if twice:
        raise NameMismatchError(
            f"{', '.join(twice)} is a constraint that the solution kept; give the other one a label"
        )
    names = {term.name for term in constraints}
    others = tuple(term for term in solution.problem.observed if term.name not in names)
    problem = replace(solution.problem, observed=(*others, *constraints))
    program = describe(problem)
    missing = np.asarray(np.isnan(np.hstack([solution.activation, solution.control])).any(axis=1))
    unknowns = unknowns_of(program, solution)
    rows = {**solution.rows, **_observed_rows(program, unknowns, missing)}
    matrices = {**solution.matrices, **_observed_matrices(program, unknowns, missing)}
    quantities = {
        name: _blanked(piece.values(unknowns, program.arrays), missing)
        for name, piece in program.quantities.items()
    }
    return replace(
        solution,
        problem=problem,
        rows=rows,
        matrices=matrices,
        quantities={**solution.quantities, **quantities},
        stability=_stability(program, rows, matrices, solution.is_solved),
    )


def _blanked(values: FloatArray, missing: BoolArray) -> FloatArray:
    values = np.array(values)
    values[missing] = np.nan
    return values


# ------------------------------------------------------------------------------------------------ rows


def _row_results(
    program: FrameProgram,
    unknowns: FloatArray,
    multipliers: tuple[FloatArray, FloatArray],
    missing: BoolArray,
) -> dict[str, RowResult]:
    """Evaluate all rows by term, unscaled; a term's blocks are joined, chosen turns are left out."""
    results: dict[str, RowResult] = {}
    for is_pair, table in enumerate((program.rows, program.pair_rows)):
        for block, where in table:
            if block.piece is None:
                continue
            raw = multipliers[is_pair][:, where] / block.scale
            # An active lower bound has a negative multiplier in the solver's sign convention.
            multiplier = np.where(block.lower == block.upper, -raw, np.abs(raw))
            new = _row_result(program, block, unknowns, multiplier, missing)
            results[block.term] = _joined(results[block.term], new) if block.term in results else new
    return results | _observed_rows(program, unknowns, missing)


def _row_result(
    program: FrameProgram,
    block: RowBlock,
    unknowns: FloatArray,
    multiplier: FloatArray,
    missing: BoolArray,
) -> RowResult:
    assert block.piece is not None
    value = block.piece.values(unknowns, program.arrays)
    if block.is_pair:
        gap = np.full((1, len(block.names)), np.nan)
        value, multiplier = np.vstack([gap, value]), np.vstack([gap, multiplier])
    missed = np.zeros(value.shape)
    if block.missed is not None:
        missed = unknowns[:, block.missed : block.missed + len(block.names)] * block.scale
    return RowResult(
        names=block.names,
        unit=block.unit,
        value=_blanked(value - missed, missing),
        lower=block.lower,
        upper=block.upper,
        missed=_blanked(missed, missing),
        multiplier=multiplier,
    )


def _joined(first: RowResult, second: RowResult) -> RowResult:
    return RowResult(
        names=first.names + second.names,
        unit=first.unit + second.unit,
        value=np.hstack([first.value, second.value]),
        lower=np.concatenate([first.lower, second.lower]),
        upper=np.concatenate([first.upper, second.upper]),
        missed=np.hstack([first.missed, second.missed]),
        multiplier=np.hstack([first.multiplier, second.multiplier]),
    )


def _observed_rows(program: FrameProgram, unknowns: FloatArray, missing: BoolArray) -> dict[str, RowResult]:
    results = {}
    for block in program.observed:
        if isinstance(block, RowBlock):
            nothing = np.full((len(unknowns), len(block.names)), np.nan)
            result = _row_result(program, block, unknowns, nothing, missing)
            results[block.term] = replace(result, is_observed=True)
    return results


def _matrix_results(
    program: FrameProgram, unknowns: FloatArray, multipliers: FloatArray, missing: BoolArray
) -> dict[str, MatrixResult]:
    chosen = {block.term: (block.turns, where) for block, where in program.rows if block.turns is not None}
    results = {}
    for block in program.matrices:
        turns, where = chosen[block.term]
        weight = np.abs(multipliers[:, where]) / block.scale
        multiplier = np.einsum("kr,kri,krj->kij", weight, turns, turns, optimize=True)
        results[block.term] = replace(
            _matrix_result(program, block, unknowns, missing), multiplier=multiplier
        )
    return results | _observed_matrices(program, unknowns, missing)


def _missed_eigenvalues(program: FrameProgram, unknowns: FloatArray) -> FloatArray:
    """Largest violation of a matrix over what its entries add up to, shape (n_frames,)."""
    worst = np.zeros(len(unknowns))
    for model in matrix_models(program):
        with one_thread():
            least = np.linalg.eigvalsh(model.value(unknowns, program.arrays))[:, 0]
        below = np.flatnonzero(least < 0)
        sizes = matrix_sizes(program, model, unknowns[below], below)
        worst[below] = np.maximum(worst[below], -least[below] / np.where(sizes > 0, sizes, 1.0))
    return worst


def _observed_matrices(
    program: FrameProgram, unknowns: FloatArray, missing: BoolArray
) -> dict[str, MatrixResult]:
    return {
        block.term: replace(_matrix_result(program, block, unknowns, missing), is_observed=True)
        for block in program.observed
        if isinstance(block, MatrixBlock)
    }


def _matrix_result(
    program: FrameProgram, block: MatrixBlock, unknowns: FloatArray, missing: BoolArray
) -> MatrixResult:
    value = block.value(unknowns, program.arrays)
    missed = np.zeros(len(unknowns))
    if block.missed is not None:
        missed = block.scale * unknowns[:, block.missed]
    with one_thread():
        smallest, mode = smallest_eigenvalues(value - np.diag(block.lower))
    return MatrixResult(
        names=block.names,
        unit=block.unit,
        value=_blanked(value, missing),
        lower=block.lower,
        missed=_blanked(missed, missing),
        smallest_eigenvalue=_blanked(smallest, missing),
        mode=_blanked(mode, missing),
        multiplier=np.full(value.shape, np.nan),
    )


# -------------------------------------------------------------------------------------------- statuses


def _statuses(
    outcome: Outcome,
    rows: dict[str, RowResult],
    matrices: dict[str, MatrixResult],
    feasibility: FloatArray,
    worst: FloatArray,
) -> tuple[tuple[Status, ...], tuple[Shortfall, ...], tuple[InfeasibilityProof, ...]]:
    """Hold what the solver said of each frame against its rows and the conditions of an optimum.

    A frame is infeasible if it is proven so, whatever the solver said. Worst shortfalls of failed frames
    come first.
    """
    program, status = outcome.program, list(outcome.status)
    violation = _scaled_violation(program, rows, matrices)
    violation[np.nan_to_num(feasibility, nan=np.inf) <= ROUNDING] = 0.0
    missed = _scaled_miss(program, rows, matrices)
    for k, found in enumerate(status):
        if found.is_solved and violation[k] > LOOSE_VIOLATION:
            status[k] = Status.NUMERICAL_ERROR
        elif found.is_solved and worst[k] > LOOSE_OPTIMALITY:
            status[k] = Status.NOT_OPTIMAL
        elif found is Status.SOLVED and (
            violation[k] > FEASIBILITY_TOLERANCE or worst[k] > OPTIMALITY_TOLERANCE
        ):
            status[k] = Status.ACCEPTABLE
        elif found is Status.SOLVED and missed[k] > LOOSE_VIOLATION:
            status[k] = Status.STABILITY_MISSED
    failed: BoolArray = np.array([not found.is_solved for found in status])
    impossible = {entry.proof.frame: entry for entry in outcome.impossible if entry.proof.holds}
    # What looks acceptable may be the best compromise between rows that contradict each other.
    loose = (violation > FEASIBILITY_TOLERANCE) | (np.nan_to_num(feasibility) > OPTIMALITY_TOLERANCE)
    for frame in np.flatnonzero(failed | loose).tolist():
        if frame not in impossible and (alone := contradiction(program, np.array([frame]))) is not None:
            impossible[frame] = alone
    coupled = program.is_coupled
    if failed.any() and coupled and not impossible:
        whole = contradiction(program, np.arange(len(status)))
        impossible = {} if whole is None else {whole.proof.frame: whole}
    shortfalls = [shortfall for entry in impossible.values() for shortfall in entry.shortfalls]
    # Rows of one frame that are all affine can be kept if they do not contradict each other.
    otherwise = Status.LOCALLY_INFEASIBLE
    if not (program.split.nonlinear or coupled):
        otherwise = Status.NUMERICAL_ERROR
    undefined = program.undefined(_somewhere(program, outcome.unknowns)) if failed.any() else {}
    for k in range(len(status)):
        if k in impossible or (coupled and impossible and failed[k]):
            status[k] = Status.INFEASIBLE
        elif status[k] is Status.INFEASIBLE:
            status[k] = otherwise
        if not failed[k] or k in impossible:
            continue
        if status[k] is Status.NUMERICAL_ERROR and k in undefined:
            shortfalls.append(
                Shortfall.of_objective(frame=k, time=float(program.time[k]), objective=undefined[k])
            )
        elif np.isfinite(outcome.unknowns[k]).all():
            shortfalls += worst_rows(program, rows, matrices, k)
    scales = _scales(program)
    return (
        tuple(status),
        tuple(sorted(shortfalls, key=lambda s: -s.amount / scales.get(s.constraint, 1.0))),
        tuple(impossible[k].proof for k in sorted(impossible)),
    )


def _somewhere(program: FrameProgram, unknowns: FloatArray) -> FloatArray:
    """Last iterates (n_frames, size), and the terms' guesses where there is none."""
    guess = program.layout.rows("guess", len(unknowns)) / program.layout.scale
    return np.where(np.isfinite(unknowns), unknowns, guess)


def _scales(program: FrameProgram) -> dict[str, float]:
    blocks = (*program.rows.blocks, *program.pair_rows.blocks)
    return {block.term: block.scale for block in blocks}


def _scaled_violation(
    program: FrameProgram, rows: dict[str, RowResult], matrices: dict[str, MatrixResult]
) -> FloatArray:
    """Largest violation of each frame over the scale of its row, shape (n_frames,)."""
    scales = _scales(program)
    worst = np.zeros(program.time.size)
    for name, row in rows.items():
        if not row.is_observed:
            missing = np.nan_to_num(row.violation) / scales.get(name, 1.0)
            worst = np.maximum(worst, missing.max(axis=1, initial=0.0))
    for name, matrix in matrices.items():
        if not matrix.is_observed:
            worst = np.maximum(worst, np.nan_to_num(matrix.violation) / scales.get(name, 1.0))
    return worst


def _scaled_miss(
    program: FrameProgram, rows: dict[str, RowResult], matrices: dict[str, MatrixResult]
) -> FloatArray:
    """Largest miss of a soft row of each frame over the scale of its row, shape (n_frames,)."""
    scales = _scales(program)
    worst = np.zeros(program.time.size)
    results: list[tuple[str, RowResult | MatrixResult]] = [*rows.items(), *matrices.items()]
    for name, found in results:
        if not found.is_observed:
            missed = np.nan_to_num(found.missed).reshape(worst.size, -1) / scales.get(name, 1.0)
            worst = np.maximum(worst, missed.max(axis=1, initial=0.0))
    return worst


def _violations(
    program: FrameProgram,
    unknowns: FloatArray,
    rows: dict[str, RowResult],
    matrices: dict[str, MatrixResult],
    solved: BoolArray,
) -> dict[str, float]:
    """Largest violation over the solved frames, by constraint name, in the row's own unit."""
    kept = {name: result.violation for name, result in rows.items() if not result.is_observed}
    kept |= {name: result.violation for name, result in matrices.items() if not result.is_observed}
    lower, upper = (program.layout.rows(what, len(unknowns)) for what in ("lower", "upper"))
    physical = unknowns * program.layout.scale
    kept["bounds"] = np.maximum(np.maximum(lower - physical, physical - upper), 0.0)
    if not solved.any():
        return {name: float("nan") for name in kept}
    return {name: float(np.nanmax(values[solved], initial=0.0)) for name, values in kept.items()}


# ----------------------------------------------------------------------------------- margins and balances


def _stability(
    program: FrameProgram,
    rows: dict[str, RowResult],
    matrices: dict[str, MatrixResult],
    solved: BoolArray,
) -> StabilityMargin | None:
    """Collect rows and matrices of all stability constraints; NaN in frames that are not solved."""
    names = [term.name for term in program.problem.stability_terms]
    parts = [_margin_of_matrix(matrices[n]) if n in matrices else _margin_of_rows(rows[n]) for n in names]
    if not parts:
        return None
    modes = [part for part in parts if part.mode_coordinates]
    failed = ~solved
    return StabilityMargin(
        rows=tuple(name for part in parts for name in part.rows),
        stability=_blanked(np.hstack([part.stability for part in parts]), failed),
        level=np.concatenate([part.level for part in parts]),
        multiplier=_blanked(np.hstack([part.multiplier for part in parts]), failed),
        mode_coordinates=modes[0].mode_coordinates if modes else (),
        mode=_blanked(modes[0].mode, failed) if modes else np.zeros((failed.size, 0)),
    )


def _margin_of_rows(rows: RowResult) -> StabilityMargin:
    return StabilityMargin(
        rows=rows.names, stability=rows.value, level=rows.lower, multiplier=rows.multiplier
    )


def _margin_of_matrix(matrix: MatrixResult) -> StabilityMargin:
    diagonal = np.einsum("kii->ki", matrix.value)
    stability = np.column_stack([diagonal, matrix.smallest_eigenvalue])
    return StabilityMargin(
        rows=(*matrix.names, SMALLEST_EIGENVALUE),
        stability=stability,
        level=np.append(matrix.lower, 0.0),
        multiplier=np.full(stability.shape, np.nan),
        mode_coordinates=matrix.names,
        mode=matrix.mode,
    )


def _moment_balance(
    program: FrameProgram, tendon_force: FloatArray, control: FloatArray, solved: BoolArray
) -> MomentBalance:
    r"""Split the moment of each coordinate into what muscles and what actuators produce, M = R F + A c."""
    trajectory = program.problem.motion.trajectory
    muscles = np.einsum("kcm,km->kc", trajectory.moment_arms, tendon_force)
    actuators = np.einsum("kca,ka->kc", trajectory.actuator_generalized_forces, control)
    return MomentBalance(
        coordinates=trajectory.coordinates,
        unit=tuple("N·m" if angle else "N" for angle in trajectory.is_rotational),
        required=trajectory.generalized_forces,
        muscles=_blanked(muscles, ~solved),
        actuators=_blanked(actuators, ~solved),
    )


def _objective_terms(program: FrameProgram, unknowns: FloatArray, solved: BoolArray) -> dict[str, float]:
    """Weighted value of each objective over the solved frames (both frames of a pair)."""
    result = {}
    for name, piece in program.objectives:
        values = piece.values(unknowns, program.arrays)[:, 0]
        keep = solved[:-1] & solved[1:] if piece.is_pair else solved
        result[name] = float(values[keep].sum())
    return result
