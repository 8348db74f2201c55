"""Values of the wrong type, for every parameter of every public name: our own error, or an answer."""

from __future__ import annotations

import dataclasses
import inspect
import re
from fractions import Fraction
from pathlib import Path

import casadi as ca
import numpy as np
import numpy.typing as npt
import pytest
from helpers import elbow, random_problem, two_antagonists, with_joint_reactions, with_motion

import scso_nlp as scso
from scso_nlp.arguments import checked_as
from scso_nlp.opensim.description import ModelDescription

#: What may be given instead of anything else.
WRONG = {
    "None": None,
    "text": "x",
    "empty text": "",
    "zero byte": "a\0b",
    "negative": -1,
    "true": True,
    "nan": np.nan,
    "infinity": np.inf,
    "huge": 10**400,
    "digits": 10**5000,
    "complex": 1j,
    "fraction": Fraction(1, 3),
    "bytes": b"x",
    "empty list": [],
    "ragged list": [[1.0], [1.0, 2.0]],
    "list of text": ["x", "y"],
    "list of numbers": [1.0, -2.0],
    "list of huge": [10**400],
    "empty mapping": {},
    "mapping": {1: "x"},
    "set": {"x"},
    "object": object(),
    "type": int,
    "function": lambda *_: None,
    "wrong shape": np.zeros((2, 0, 3)),
    "of text": np.array(["x"]),
    "of objects": np.array([None, object()], dtype=object),
    "of complex": np.array([1j]),
    "of times": np.array(["2020-01-01"], dtype="datetime64[D]"),
    "no axis": np.array(3.0),
    "structured": np.zeros(2, dtype=[("a", float)]),
    "masked": np.ma.masked_array([1.0, 2.0], mask=[True, False]),
    "path": Path("nowhere/at/all"),
    "symbols": ca.SX.sym("x", 2),
    "exception": ValueError("x"),
}


@pytest.fixture(scope="module")
def examples(tmp_path_factory):
    """Good arguments for every public name that takes any."""
    folder = tmp_path_factory.mktemp("examples")
    rng = np.random.default_rng(5)
    stable = random_problem(rng, n_frames=2, n_muscles=4, n_coordinates=2, reserve=50.0)
    solution = scso.solve_framewise(stable, on_failure="return")
    hessian = _with_curvature(stable, rng)
    full = dataclasses.replace(
        hessian, constraints=(scso.MomentEquilibrium(), scso.HessianStability(level=-1e6))
    )
    whole = scso.solve_framewise(full, on_failure="return")
    loaded = scso.solve_framewise(with_joint_reactions(stable, rng), on_failure="return")
    reactions = loaded.problem.motion.trajectory.joint_reactions
    scso.save_bundle(folder / "motion.npz", stable.motion)
    motion = stable.motion
    curvature = hessian.motion.trajectory.curvature
    frame = {
        name: ca.SX.sym(name, 2)
        for name in (
            "activation", "control", "moment_arms", "actuator_generalized_forces", "generalized_forces",
            "muscle_tendon_length", "muscle_tendon_velocity",
        )
    }  # fmt: skip
    state = scso.MuscleState(tendon_force=ca.SX(1), passive_force=ca.SX(0))
    failed = scso.solve_framewise(elbow([600.0]), on_failure="return")
    light = scso.solve_framewise(elbow([40.0, 50.0]))
    activity = scso.MuscleActivity(groups=("a",), muscles=(("m*",),), time=[-1.0, 9.0], values=[[0.1]] * 2)
    change = scso.sensitivity(light, ["max_isometric_force"])
    spread = scso.bands(change, ranges=np.ones(len(change.parameters)))
    stiff = scso.MeasuredStiffness(stiffness=100.0, arms={"elbow_z": 1.0})
    trial = scso.MeasuredTrial(problem=two_antagonists(20.0, external_work=0.0), measured=stiff)
    known = {"trials": {"hold": trial}, "parameters": ["q"], "same_data": True}
    raised = scso.at_effort(light.problem, 2.0 * light.objective, _floor, tolerance=0.5)
    data = [
        motion, motion.trajectory, motion.trajectory.skeleton, motion.muscles, motion.actuators, curvature,
        stable, solution, solution[motion.muscles.muscles[0]], solution.report, solution.optimality,
        solution.stability, solution.moment_balance,
        solution.kept["MomentEquilibrium"], next(iter(whole.matrices.values())), failed.shortfalls[0],
        scso.row_contributions(solution), scso.reachable_stability(two_antagonists(5.0))[0],
        scso.build_program(stable), failed.infeasibility[0], scso.SolverOptions(),
        scso.LumbarJoint(levels=1, rows={"a": "axial"}),
        activity, scso.EmgTracking(activity=activity), scso.EmgBounds(activity=activity), raised, change,
        spread, scso.ranges(light), scso.Parameter(quantity="q"), stiff, trial, scso.calibrate(**known),
        scso.MeasuredEmg(activity=activity),
        scso.adjoint_sensitivity(light, ["max_isometric_force"]),
        scso.ActivationEffort(), scso.FunctionObjective(function=lambda f: f.activation[0]), state,
        scso.MomentEquilibrium(), scso.JointStability(), scso.CoordinateStability(), scso.HessianStability(),
        scso.ActivationRate(), scso.ActivationDynamics(), scso.NoPhysiology(), scso.RigidTendon(),
        scso.CompliantTendon(), scso.ProportionalStiffness(), scso.ShortRangeStiffness(),
        scso.FiberStiffness(), scso.Rows(value=ca.SX(1), lower=0.0, upper=1.0, names=("a",)),
        scso.MatrixRows(
            weights=ca.SX(1), matrices=np.ones((1, 1, 1)), constant=np.zeros((1, 1)), lower=0.0, names=("a",)
        ), scso.Frame(**frame, muscle=state),
        scso.VariableSpec(name="a", labels=("a",)), reactions, loaded.joint_reactions(), _nothing_held(),
    ]  # fmt: skip
    found = {
        type(each).__name__: {f.name: getattr(each, f.name) for f in dataclasses.fields(each)}
        for each in data
    }
    solve = {"problem": stable, "options": scso.SolverOptions(max_iterations=3), "on_failure": "return"}
    plot = {"solution": solution}
    return found | {
        "SolveFailed": {"solution": failed},
        "load_motion": {"setup": folder / "none.xml"},
        "solve": {"setup": motion, "options": solve["options"], "on_failure": "return"},
        "load_bundle": {"path": folder / "motion.npz"},
        "save_bundle": {"path": folder / "other.npz", "motion": motion},
        "write_solution": {"solution": solution, "folder": folder / "results", "figures": False},
        "static_optimization": {"motion": motion},
        "stability_constrained_static_optimization": {"motion": motion},
        "solve_framewise": solve,
        "solve_trajectory": solve,
        "build_program": {"problem": stable},
        "observe": {"solution": solution, "constraints": (scso.JointStability(label="again"),)},
        "critical_q": {"problem": two_antagonists(5.0)},
        "feasible_q": {"problem": two_antagonists(5.0)},
        "reachable_stability": {"problem": two_antagonists(5.0)},
        "equivalent_q": {"solution": solution},
        "sensitivity": {"solution": light, "parameters": ["max_isometric_force"]},
        "adjoint_sensitivity": {"solution": light, "parameters": ["max_isometric_force"]},
        "bands": {"change": change, "ranges": np.ones(len(change.parameters))},
        "write_bands": {"bands": spread, "folder": folder / "bands"},
        "plot_uncertainty": {"bands": spread},
        "ranges": {"solution": light},
        "at_effort": {"problem": light.problem, "effort": 2.0 * light.objective, "alternative": _floor},
        "calibrate": known,
        "random_patterns": {"solution": light, "frame": 0, "number": 2},
        "row_contributions": {"solution": solution},
        "mode_contributions": {"solution": whole},
        "lumbar_passive_stiffness": {"joints": (scso.LumbarJoint(levels=1, rows={"a": "axial"}),)},
        "plot_activations": plot,
        "plot_moments": plot,
        "plot_stability": plot,
        "plot_joint_reactions": {"solution": loaded},
        "plot_contributions": {"contributions": scso.row_contributions(solution)},
        "plot_tendon_forces": {"solutions": {"one": solution}},
        "tendon_force_difference": {"solution": solution, "reference": solution},
    }


def _floor(strength):
    return scso.ActivationFloor(floor=strength)


def _nothing_held():
    """What is known of a model without anything in it."""
    nothing = {
        name: {} for name in ("body_parents", "body_masses", "constraints", "other_forces")
    } | dict.fromkeys(
        ("bodies", "joints", "coordinates", "muscles", "actuators", "switched_off", "outside"), ()
    )
    arrays = {"gravity": np.zeros(3), "moment_arms": np.zeros((0, 0)), "actuator_forces": np.zeros((0, 0))}
    empty = ModelDescription(name="empty", **nothing, **arrays)
    return scso.ModelInfo(source=Path("a.osim"), model=Path("a.osim"), description=empty)


def _with_curvature(problem, rng):
    trajectory = problem.motion.trajectory
    n_frames, n, n_muscles = trajectory.moment_arms.shape
    given = scso.CoordinateCurvature(
        coordinates=trajectory.coordinates,
        path_curvature=np.zeros((n_frames, n, n, n_muscles)),
        load_stiffness=np.zeros((n_frames, n, n)),
        passive_stiffness=np.zeros((n_frames, n, n)),
        asymmetry=np.zeros((n_frames, n_muscles)),
        is_uncertain=np.zeros((n_frames, n_muscles), dtype=bool),
    )
    trajectory = dataclasses.replace(trajectory, curvature=given)
    return with_motion(problem, trajectory=trajectory)


def is_called(name):
    """Exceptions take any words, abstract classes and modules nothing; Python itself looks up statuses."""
    thing = getattr(scso, name)
    if inspect.ismodule(thing):
        return False
    is_plain_error = isinstance(thing, type) and issubclass(thing, Exception) and name != "SolveFailed"
    return (
        not inspect.isabstract(thing) and not is_plain_error and thing not in (scso.Status, scso.Regularity)
    )


#: Parameters that take more than one argument.
KINDS = {inspect.Parameter.VAR_POSITIONAL: "several", inspect.Parameter.VAR_KEYWORD: "by_name"}
CALLED = [name for name in scso.__all__ if is_called(name)]


@pytest.mark.parametrize("name", CALLED)
def test_a_value_of_the_wrong_type_is_an_answer_or_the_packages_own_error(
    name, examples, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    thing = getattr(scso, name)
    signature = inspect.signature(thing)
    raw = []
    for parameter in signature.parameters.values():
        for what, value in WRONG.items():
            given = {"several": (value,), "by_name": {"model": value}}.get(KINDS.get(parameter.kind), value)
            call = inspect.BoundArguments(signature, {**examples.get(name, {}), parameter.name: given})
            try:
                thing(*call.args, **call.kwargs)
            except scso.ScsoError:
                continue
            except Exception as error:
                raw.append(f"{parameter.name} = {what}: {type(error).__name__}: {str(error)[:150]}")
    assert raw == []


def test_the_names_of_arguments_and_functions_stand_in_the_sentence():
    for call, text in (
        (lambda: scso.ActivationEffort(exponent="2"), "ActivationEffort: exponent is '2', expected a number"),
        (lambda: scso.solve_trajectory(5), "solve_trajectory: problem is 5, expected a MuscleForceProblem"),
        (
            lambda: scso.SolverOptions(max_iterations=2.5),
            "SolverOptions: max_iterations is 2.5, expected a whole",
        ),
        (
            lambda: scso.JointStability(level={"a": "b"}),
            "level is {'a': 'b'}, expected a number or a mapping of",
        ),
    ):
        with pytest.raises(scso.DataError, match=re.escape(text)):
            call()


def test_a_wrong_number_of_arguments_is_pythons_own_error():
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'problem'"):
        scso.solve_trajectory()
    with pytest.raises(TypeError, match="unexpected keyword argument 'exponents'"):
        scso.ActivationEffort(exponents=2)


@pytest.mark.parametrize("number", [2, 2.0, np.float64(2), np.float32(2), np.int64(2)])
def test_numbers_of_every_kind_are_numbers(number):
    assert scso.ActivationEffort(exponent=number).exponent == 2


def test_names_given_to_types_stand_for_them():
    """NumPy 2.5 makes ``NDArray`` such a name where Python has them, from 3.12 on."""

    class Named:
        __value__ = np.ndarray

    @checked_as(values=Named(), also=npt.NDArray[np.float64])
    def total(values, also):
        return np.sum(values) + np.sum(also)

    assert total([1.0, 2.0], [3.0]) == 6.0
    for call in ({"values": "words", "also": [1.0]}, {"values": [1.0], "also": "words"}):
        with pytest.raises(scso.ProblemError, match="is 'words', expected an array of numbers"):
            total(**call)
