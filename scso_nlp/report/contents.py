"""What each result file holds, and the list of them.

To add one: a function here, its entry in :data:`RESULT_FILES`, a test of what it holds in
``tests/report/test_contents.py``; then ``python tests/test_readme.py`` writes README's table again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np

from scso_nlp.exceptions import NameMismatchError
from scso_nlp.io.storage import Storage
from scso_nlp.solution import MatrixResult, RowResult, Solution, Status
from scso_nlp.validation import FloatArray

#: Numbers that stand for a frame's status in the status file.
STATUS_CODES = {
    Status.SOLVED: 0,
    Status.ACCEPTABLE: 1,
    Status.INFEASIBLE: 2,
    Status.ITERATION_LIMIT: 3,
    Status.NUMERICAL_ERROR: 4,
    Status.NOT_OPTIMAL: 5,
    Status.STABILITY_MISSED: 6,
    Status.LOCALLY_INFEASIBLE: 7,
}
#: Violation of a frame that has no iterate, in the status file: OpenSim's Storage stops reading at NaN.
NO_ITERATE = -1.0

_ACTIVATION_DESCRIPTION = "This file contains static optimization results.\n\n"
_FORCE_DESCRIPTION = (
    "\nThis file contains the forces exerted on a model during a simulation.\n\n"
    "A force is a generalized force, meaning that it can be either a force (N) or a torque (Nm).\n\n"
    "Units are S.I. units (second, meters, Newtons, ...)\n"
    "If the header above contains a line with 'inDegrees', this indicates whether rotational values are in "
    "degrees (yes) or radians (no).\n\n"
)
_STABILITY_DESCRIPTION = (
    "Per row (joint axis or coordinate): stability S, level and margin S - level in N.m/rad; and, where\n"
    "the solver gives one, the multiplier: the cost in the objective per N.m/rad of extra stability; and\n"
    "of levels that may be missed at a price, what is missed in N.m/rad. For a whole Hessian: its smallest\n"
    "eigenvalue, levels taken off, and mode: the turn that belongs to it.\n"
)
_MOMENT_DESCRIPTION = (
    "Generalized force of every coordinate that the motion asks for, as inverse dynamics calls it: _moment\n"
    "in N.m, _force in N; and what muscles and reserves give of it.\n"
)
#: Endings of the columns of moments: what the motion asks for, what muscles and what actuators give.
MOMENT_PARTS = {"required": "", "muscles": "_muscles", "reserves": "_reserves"}
_REACTION_DESCRIPTION = (
    "\nThis file contains the reaction forces and moments\n"
    "applied to the specified body of a joint pair and expressed  in the specified reference frame.\n\n"
    "Units are S.I. units (seconds, meters, Newtons, ...)\n"
)
_CONTROL_HEAD = """\t\t\t<ControlLinear name={name}>
\t\t\t\t<is_model_control>true</is_model_control>
\t\t\t\t<extrapolate>true</extrapolate>
\t\t\t\t<default_min>0.02</default_min>
\t\t\t\t<default_max>1</default_max>
\t\t\t\t<filter_on>false</filter_on>
\t\t\t\t<use_steps>false</use_steps>
\t\t\t\t<x_nodes>
"""
_CONTROL_NODE = """\t\t\t\t\t<ControlLinearNode>
\t\t\t\t\t\t<t>{time}</t>
\t\t\t\t\t\t<value>{value}</value>
\t\t\t\t\t</ControlLinearNode>
"""
_CONTROL_TAIL = """\t\t\t\t</x_nodes>
\t\t\t\t<min_nodes />
\t\t\t\t<max_nodes />
\t\t\t\t<kp>100</kp>
\t\t\t\t<kv>20</kv>
\t\t\t</ControlLinear>
"""


@dataclass(frozen=True, kw_only=True)
class ResultFile:
    """One of the files that a solution is written to.

    Attributes
    ----------
    name : str
        With ``{name}`` for the motion's name and ``{analysis}`` for that of the analysis.
    holds : str
        What README's table says of it.
    content : callable
        Makes it of a solution; None where there is nothing to write.
    is_result : bool
        Not written of a run that leaves no results because frames failed.
    of_baseline : bool
        Made of the static optimization of a run with stability rows, where there is one.
    """

    name: str
    holds: str
    content: Callable[[Solution], Storage | Iterable[str] | None]
    is_result: bool = True
    of_baseline: bool = False


def _activation(solution: Solution) -> Storage:
    """Activations of muscles and controls of actuators."""
    labels, values = _controls(solution)
    return _storage(solution, "Static Optimization", labels, values, _ACTIVATION_DESCRIPTION)


def _controls_file(solution: Solution) -> Iterator[str]:
    """Text of a ControlSet with the same numbers, piece by piece."""
    return _controls_xml(*_controls(solution), solution.problem.motion.trajectory.time)


def _force(solution: Solution) -> Storage:
    """Give forces of muscles, actuators and all else that OpenSim records."""
    trajectory, columns = solution.problem.motion.trajectory, _force_columns(solution)
    others = dict(zip(trajectory.other_force_labels, trajectory.other_forces.T, strict=True))
    forces = {**others, **_by_name(solution, solution.tendon_force, solution.actuator_force)}
    missing = [name for name in columns if name not in forces]
    if missing:
        raise NameMismatchError(
            f"the force file needs {', '.join(missing)}, which are no muscle, actuator or other force"
        )
    values = _table(columns, forces, ~solution.is_solved)
    return _storage(solution, "ModelForces", columns, values, _FORCE_DESCRIPTION)


def _force_columns(solution: Solution) -> tuple[str, ...]:
    trajectory = solution.problem.motion.trajectory
    return trajectory.force_columns or (
        *trajectory.muscles,
        *trajectory.actuators,
        *trajectory.other_force_labels,
    )


def _controls(solution: Solution) -> tuple[tuple[str, ...], FloatArray]:
    """Names and values of activations and controls, in the order of the force file."""
    unknowns = _by_name(solution, solution.activation, solution.control)
    labels = tuple(name for name in _force_columns(solution) if name in unknowns)
    labels += tuple(name for name in unknowns if name not in labels)
    return labels, _table(labels, unknowns, ~solution.is_solved)


def _by_name(solution: Solution, of_muscles: FloatArray, of_actuators: FloatArray) -> dict[str, FloatArray]:
    trajectory = solution.problem.motion.trajectory
    columns = dict(zip(trajectory.muscles, of_muscles.T, strict=True))
    return columns | dict(zip(trajectory.actuators, of_actuators.T, strict=True))


def _table(labels: tuple[str, ...], columns: Mapping[str, FloatArray], failed: np.ndarray) -> FloatArray:
    table = np.empty((failed.size, len(labels)))
    for i, label in enumerate(labels):
        table[:, i] = columns[label]
    table[failed] = np.nan
    return table


def _storage(
    solution: Solution, title: str, labels: tuple[str, ...], values: FloatArray, description: str
) -> Storage:
    return Storage(
        name=title,
        labels=labels,
        time=solution.problem.motion.trajectory.time,
        values=values,
        in_degrees=False,
        description=description,
    )


def _controls_xml(labels: tuple[str, ...], values: FloatArray, time: FloatArray) -> Iterator[str]:
    """Text of a ControlSet with one linear control per actuator, as OpenSim 4.6 writes it."""
    yield (
        '<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40600">\n'
        '\t<ControlSet name="Control Set">\n\t\t<objects>\n'
    )
    times = [f"{t:.17g}" for t in time]
    for i, label in enumerate(labels):
        yield _CONTROL_HEAD.format(name=quoteattr(label))
        for t, value in zip(times, values[:, i].tolist(), strict=True):
            yield _CONTROL_NODE.format(time=t, value="NaN" if math.isnan(value) else f"{value:.17g}")
        yield _CONTROL_TAIL
    yield "\t\t</objects>\n\t\t<groups />\n\t</ControlSet>\n</OpenSimDocument>\n"


def _stability(solution: Solution) -> Storage | None:
    """Stability rows, if there are any."""
    margin = solution.stability
    if margin is None:
        return None
    n_frames = len(margin.stability)
    labels: list[str] = []
    columns: list[FloatArray] = []
    for r, row in enumerate(margin.rows):
        labels += [f"{row}_stability", f"{row}_level", f"{row}_margin"]
        columns += [margin.stability[:, r], np.full(n_frames, margin.level[r]), margin.margin[:, r]]
        solved = np.isfinite(margin.stability[:, r])
        if np.isfinite(margin.multiplier[solved, r]).all():
            labels.append(f"{row}_multiplier")
            columns.append(margin.multiplier[:, r])
    for term in solution.problem.stability_terms:
        if term.soft is not None and term.name in solution.kept:
            missed = solution.kept[term.name].missed_by_row
            labels += [f"{row}_missed" for row in missed]
            columns += list(missed.values())
    labels += [f"mode_{name}" for name in margin.mode_coordinates]
    columns += list(margin.mode.T)
    values = np.column_stack(columns)
    values[np.isnan(margin.stability).all(axis=1)] = np.nan
    return _storage(solution, "Joint Stability", tuple(labels), values, _STABILITY_DESCRIPTION)


def _moments(solution: Solution) -> Storage:
    """Moment balance of every coordinate."""
    balance = solution.moment_balance
    names = [
        f"{name}_{'moment' if unit == 'N·m' else 'force'}"
        for name, unit in zip(balance.coordinates, balance.unit, strict=True)
    ]
    labels = tuple(name + ending for ending in MOMENT_PARTS.values() for name in names)
    values = np.hstack([balance.required, balance.muscles, balance.actuators])
    values[~solution.is_solved] = np.nan
    return _storage(solution, "Moment Balance", labels, values, _MOMENT_DESCRIPTION)


def _joint_reactions(solution: Solution) -> Storage | None:
    """Give reactions on the children of joints, in ground, if the motion has them."""
    if solution.problem.motion.trajectory.joint_reactions is None:
        return None
    found = solution.joint_reactions()
    values = np.where(solution.is_solved[:, None], found.columns, np.nan)
    return _storage(solution, "Joint Reaction Loads", found.labels, values, _REACTION_DESCRIPTION)


def _status(solution: Solution) -> Storage:
    """Status of every frame, and what it misses."""
    codes = [f"{code} {status.name}: {status.value}\n" for status, code in STATUS_CODES.items()]
    description = (
        "One status per frame:\n" + "".join(codes) + "Violations in each constraint's own unit "
        f"(N.m, N or N.m/rad), {NO_ITERATE:g} where there is no iterate.\n"
    )
    columns = {"status": np.array([float(STATUS_CODES[status]) for status in solution.frame_status])}
    # labels of terms are any text, OpenSim splits those of columns at blanks
    columns |= {"_".join(f"violation {n}".split()): _violation(rows) for n, rows in solution.kept.items()}
    values = np.column_stack(list(columns.values()))
    return _storage(solution, "Solver Status", tuple(columns), values, description)


def _violation(rows: RowResult | MatrixResult) -> FloatArray:
    """Largest violation of each frame, shape (n_frames,) [the row's unit]."""
    excess = rows.violation.reshape(len(rows.violation), -1)
    return np.where(np.isfinite(excess), excess, NO_ITERATE).max(axis=1, initial=NO_ITERATE)


def _of_muscles(title: str, attribute: str, description: str) -> Callable[[Solution], Storage | None]:
    """Make the content of a file with a column per muscle; none where the solution lacks it."""

    def content(solution: Solution) -> Storage | None:
        values = getattr(solution, attribute)
        if values is None:
            return None
        muscles = solution.problem.motion.trajectory.muscles
        values = np.where(solution.is_solved[:, None], values, np.nan)
        return _storage(solution, title, muscles, values, f"{description}\n")

    return content


#: All of them, in the order of README's table.
RESULT_FILES = (
    ResultFile(
        name="{name}_{analysis}_activation.sto",
        holds="activations of muscles and controls of actuators; as OpenSim writes it: same title, same "
        "columns, same order",
        content=_activation,
    ),
    ResultFile(
        name="{name}_{analysis}_force.sto",
        holds="forces of muscles, actuators and all else that OpenSim records; as OpenSim writes it",
        content=_force,
    ),
    ResultFile(
        name="{name}_{analysis}_controls.xml",
        holds="the activations and controls as a ControlSet; as OpenSim writes it",
        content=_controls_file,
    ),
    ResultFile(
        name="{name}_excitation.sto",
        holds="with `--activation-dynamics`: excitations of muscles",
        content=_of_muscles("Excitations", "excitation", "Excitations by activation dynamics."),
    ),
    ResultFile(
        name="{name}_MuscleAnalysis_FiberLength.sto",
        holds="with `--muscle-model compliant`: fiber lengths, under the name of OpenSim's MuscleAnalysis",
        content=_of_muscles("FiberLength", "fiber_length", "Fiber lengths in m."),
    ),
    ResultFile(
        name="{name}_tendon_strain.sto",
        holds="likewise: strain of the tendons, (length - slack length) / slack length",
        content=_of_muscles(
            "Tendon Strain", "tendon_strain", "Tendon length less slack length, over slack length."
        ),
    ),
    ResultFile(
        name="{name}_JointReaction_ReactionLoads.sto",
        holds="with `--joint-reactions all` or names of joints: force, moment and point on the child of each "
        "joint, in ground; as OpenSim's JointReaction writes it",
        content=_joint_reactions,
    ),
    ResultFile(
        name="{name}_stability.sto",
        holds="if there are stability rows: stability, level, margin, multiplier of every row, and what soft "
        "ones miss; for `full` the smallest eigenvalue and its mode",
        content=_stability,
    ),
    ResultFile(
        name="{name}_moments.sto",
        holds="moment of every coordinate: required, of muscles, of reserves",
        content=_moments,
    ),
    ResultFile(
        name="{name}_without_stability.sto",
        holds="if there are stability rows: activations and controls of static optimization, for comparison",
        content=_activation,
        of_baseline=True,
    ),
    ResultFile(
        name="{name}_status.sto",
        holds="status of every frame, and what it misses",
        content=_status,
        is_result=False,
    ),
)
