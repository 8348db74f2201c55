"""Input that cannot be used: one sentence with what, where, expected, found and remedy."""

from __future__ import annotations

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from coupled_terms import CappedEffort
from helpers import elbow, motion, muscle_parameters, random_problem, skeleton, two_antagonists

import scso_nlp as scso

both_solvers = pytest.mark.parametrize("solve", [scso.solve_trajectory, scso.solve_framewise])


def raises(kind, text):
    """Expect an exception of exactly this class whose message holds the text, signs included."""
    import re

    return pytest.raises(kind, match=re.escape(text))


@pytest.fixture
def trajectory():
    return motion(np.full((3, 2, 4), 0.05), np.ones((3, 2)))


# Arrays of a motion -------------------------------------------------------------------------------


def test_a_wrong_shape_is_told_with_the_expected_one_and_its_axes(trajectory):
    with raises(
        scso.DataError,
        "moment_arms has shape (3, 4, 2), expected (3, 2, 4) = (n_frames, n_coordinates, n_muscles)",
    ):
        dataclasses.replace(trajectory, moment_arms=np.zeros((3, 4, 2)))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_not_finite_is_told_with_its_place(trajectory, bad):
    moments = trajectory.generalized_forces.copy()
    moments[2, 1] = bad
    with raises(scso.DataError, f"generalized_forces is {bad} at index (2, 1) of (n_frames, n_coordinates)"):
        dataclasses.replace(trajectory, generalized_forces=moments)


def test_words_instead_of_numbers_are_refused(trajectory):
    with raises(scso.DataError, "muscle_tendon_length is [['long', 'long', 'long', 'long'], "):
        dataclasses.replace(trajectory, muscle_tendon_length=[["long"] * 4] * 3)


@pytest.mark.parametrize(("time", "frame"), [([0.0, 0.2, 0.1], 2), ([0.0, 0.0, 0.1], 1)])
def test_time_that_does_not_increase_is_told_with_the_frame(trajectory, time, frame):
    with raises(scso.DataError, f"time is not increasing at frame {frame}"):
        dataclasses.replace(trajectory, time=time)


def test_a_motion_without_frames_is_refused(trajectory):
    with raises(scso.DataError, "the motion 'tiny' has no frame, expected at least one"):
        trajectory.frames(0, 0)


@pytest.mark.parametrize("kind", ["muscles", "coordinates"])
def test_a_name_that_stands_twice_is_told(trajectory, kind):
    names = list(getattr(trajectory, kind))
    names[1] = names[0]
    with raises(scso.DataError, f"{kind} names must be unique, found twice: {names[0]}"):
        dataclasses.replace(trajectory, **{kind: tuple(names)})


def test_arrays_of_a_motion_cannot_be_written_to(trajectory):
    with pytest.raises(ValueError, match="read-only"):
        trajectory.moment_arms[0, 0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        trajectory.name = "other"


# Muscles and actuators ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("what", "value", "rule"),
    [
        ("max_isometric_force", 0.0, "must be positive"),
        ("optimal_fiber_length", -0.1, "must be positive"),
        ("max_contraction_velocity", -1.0, "must not be negative"),
        ("tendon_slack_length", -1.0, "must not be negative"),
        ("min_activation", 2.0, "must not exceed max_activation"),
    ],
)
def test_an_impossible_constant_is_told_with_its_muscle(what, value, rule):
    parameters = muscle_parameters(("vastus", "soleus"), 1000.0)
    numbers = getattr(parameters, what).copy()
    numbers[1] = value
    with raises(scso.DataError, f"{what} of 'soleus' is {value:g}, {rule}"):
        dataclasses.replace(parameters, **{what: numbers})


def test_controls_whose_bounds_cross_are_told_with_their_actuator():
    with raises(scso.DataError, "min_control of 'hip' is 1, must not exceed max_control"):
        scso.ActuatorParameters(
            actuators=("hip",), optimal_force=[1.0], min_control=[1.0], max_control=[-1.0]
        )


# The problem --------------------------------------------------------------------------------------


def test_muscles_that_differ_from_the_motion_are_listed_both_ways(trajectory):
    with raises(scso.NameMismatchError, "muscles of the trajectory and of the parameters differ"):
        problem(trajectory, muscles=("m1", "m2", "m3", "m5"))
    with raises(scso.NameMismatchError, "missing ['m4'], extra ['m5']"):
        problem(trajectory, muscles=("m1", "m2", "m3", "m5"))
    with raises(scso.NameMismatchError, "are in different order"):
        problem(trajectory, muscles=("m2", "m1", "m3", "m4"))


def test_actuators_that_the_motion_does_not_have_are_listed(trajectory):
    extra = scso.ActuatorParameters(actuators=("hip",), optimal_force=[1], min_control=[-1], max_control=[1])
    with raises(scso.NameMismatchError, "actuators of the trajectory and of the parameters differ"):
        problem(trajectory, actuators=extra)


def test_two_terms_of_one_name_are_refused(trajectory):
    with raises(scso.ProblemError, "two terms are called ActivationEffort; give one of them a label"):
        problem(trajectory, objectives=(scso.ActivationEffort(), scso.ActivationEffort(exponent=3)))
    with raises(scso.ProblemError, "two terms are called MomentEquilibrium"):
        problem(trajectory, constraints=(scso.MomentEquilibrium(),) * 2)


def test_two_functions_under_their_own_labels_are_welcome(trajectory):
    terms = [scso.FunctionObjective(function=lambda f: f.activation[0] ** 2, label=name) for name in "ab"]
    assert [term.name for term in problem(trajectory, objectives=tuple(terms)).objectives] == ["a", "b"]


def test_a_problem_needs_an_objective_that_is_one(trajectory):
    with raises(scso.ProblemError, "the problem has no objective, expected at least one"):
        problem(trajectory, objectives=())
    with raises(scso.ProblemError, "3.0 is no objective, expected a FrameObjective or a function of a frame"):
        problem(trajectory, objectives=(3.0,))
    with raises(
        scso.ProblemError, "a sequence of objects of FrameConstraint or objects of FramePairConstraint"
    ):
        problem(trajectory, constraints=(scso.ActivationEffort(),))


def problem(trajectory, *, muscles=None, actuators=None, **changes):
    options = {"muscle_model": scso.NoPhysiology(), "objectives": (scso.ActivationEffort(),)} | changes
    motion = scso.Motion(
        trajectory=trajectory,
        muscles=muscle_parameters(muscles or trajectory.muscles, 1000.0),
        actuators=actuators or scso.ActuatorParameters(),
    )
    return scso.MuscleForceProblem(motion=motion, **options)


# Terms --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("exponent", [0.99, 0.0, -2.0, math.nan, -math.inf])
def test_an_exponent_below_one_is_refused(exponent):
    with raises(scso.ProblemError, f"exponent is {exponent:g}, expected a number of at least 1"):
        scso.ActivationEffort(exponent=exponent)


@pytest.mark.parametrize("weight", [-1.0, math.nan, math.inf])
def test_a_weight_that_is_no_weight_is_refused(weight):
    with raises(scso.ProblemError, f"weight is {weight:g}, expected a finite number of at least 0"):
        scso.ActivationEffort(weight=weight)
    with raises(scso.ProblemError, f"weight of 'm1' is {weight:g}, expected a finite number of at least 0"):
        scso.ActivationEffort(weights={"m1": weight})


@pytest.mark.parametrize("weight", [math.nan, math.inf])
def test_a_weight_of_a_function_must_be_finite(weight):
    term = scso.FunctionObjective(function=lambda f: f.activation[0], label="mine", weight=weight)
    with raises(scso.ProblemError, f"weight of mine is {weight:g}, expected a finite number"):
        scso.solve_framewise(with_objectives(elbow([60.0]), term))


def test_weights_of_unknown_muscles_are_refused_with_the_closest_names():
    for weights, text in (
        ({"m9": 1.0}, "unknown muscle or actuator 'm9' (closest: m"),
        ({"vas*": 1.0}, "pattern 'vas*' fits no muscle or actuator (available: m"),
    ):
        with raises(scso.NameMismatchError, text):
            scso.solve_framewise(with_objectives(elbow([60.0]), scso.ActivationEffort(weights=weights)))
    with raises(scso.ProblemError, "weights is 'mass', expected 'volume', 'pcsa' or a mapping"):
        scso.ActivationEffort(weights="mass")


@pytest.mark.parametrize("exponent", [1.0, 1.5, math.inf])
def test_negative_activations_are_refused_where_the_power_needs_positive_ones(exponent):
    base = elbow([60.0], exponent=exponent)
    muscles = dataclasses.replace(base.motion.muscles, min_activation=[0.0, -0.5, 0.0])
    motion = dataclasses.replace(base.motion, muscles=muscles)
    with raises(scso.ProblemError, "but min_activation of 'm2' is -0.5; raise the bound"):
        scso.solve_framewise(dataclasses.replace(base, motion=motion))


@pytest.mark.parametrize("q", [-1.0, math.nan, math.inf, [5.0, -2.0], {"*": 5.0, "m1": -3.0}])
def test_a_stiffness_gain_that_is_no_gain_is_refused(q):
    with raises(scso.ProblemError, "expected a finite number of at least 0"):
        scso.JointStability(q=q)


@pytest.mark.parametrize(
    "law", [scso.ShortRangeStiffness(), scso.FiberStiffness(), scso.ProportionalStiffness()]
)
@pytest.mark.parametrize("constraint", [scso.JointStability, scso.CoordinateStability, scso.HessianStability])
def test_a_gain_beside_a_stiffness_law_of_ones_own_is_refused(constraint, law):
    with raises(scso.ProblemError, f"q has no effect where stiffness is {type(law).__name__}"):
        constraint(q=5.0, stiffness=law)
    assert constraint(stiffness=law).stiffness_law is law
    assert constraint().stiffness_law == scso.ProportionalStiffness(q=5.0)
    assert constraint(q=3.0).stiffness_law == scso.ProportionalStiffness(q=3.0)


@pytest.mark.parametrize("level", [math.nan, math.inf, {"elbow_z": math.nan}])
def test_a_level_that_is_not_finite_is_refused(level):
    with raises(scso.ProblemError, "expected a finite number"):
        scso.JointStability(level=level)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"joints": ("elbw",)}, "unknown joint 'elbw' (closest: elbow)"),
        ({"axes": ("w",)}, "unknown axis 'w' (available: x, y, z)"),
        ({"level": {"elbow_q": 1.0}}, "unknown stability row 'elbow_q' (closest: elbow_z)"),
        ({"q": {"m1": 5.0}}, "q has no entry for m2; add them, or a first entry '*' for"),
        ({"q": {"*": 5.0, "m7": 3.0}}, "unknown muscle 'm7' (closest: m"),
        ({"q": {"vas*": 5.0}}, "pattern 'vas*' fits no muscle (available: m"),
    ],
)
def test_unknown_names_in_stability_rows_are_refused_with_the_closest_ones(changes, text):
    base = two_antagonists(5.0)
    with raises(scso.NameMismatchError, text):
        rows = dataclasses.replace(base.constraints[1], **changes)
        scso.solve_framewise(dataclasses.replace(base, constraints=(base.constraints[0], rows)))


def test_one_gain_per_muscle_must_be_as_many_as_muscles():
    base = two_antagonists(5.0)
    rows = dataclasses.replace(base.constraints[1], q=[5.0, 5.0, 5.0])
    with raises(scso.ProblemError, "q has shape (3,), expected a number or (2,) = (n_muscles,)"):
        scso.solve_framewise(dataclasses.replace(base, constraints=(base.constraints[0], rows)))


def test_stability_without_a_skeleton_is_refused():
    base = elbow([60.0])
    rows = scso.JointStability(joints=("elbow",))
    with raises(scso.DataError, "has no skeleton, which stability rows are computed from"):
        scso.solve_framewise(dataclasses.replace(base, constraints=(*base.constraints, rows)))


def test_a_skeleton_of_other_frames_is_refused(trajectory):
    geometry = skeleton(np.zeros((4, 2, 3)), np.zeros((4, 2), dtype=int), n_frames=2)
    with raises(scso.DataError, "skeleton has (2, 4) (n_frames, n_muscles), the trajectory has (3, 4)"):
        dataclasses.replace(trajectory, skeleton=geometry)


def test_an_unknown_convention_of_the_rigid_tendon_is_refused():
    with raises(scso.ProblemError, "'hill', expected 'opensim'"):
        scso.RigidTendon(convention="hill")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Answering(scso.FrameConstraint):
    """A user's constraint with a mistake in it."""

    changes: dict

    def rows(self, frame, motion):
        good = {"value": frame.activation[0], "lower": 0.0, "upper": 1.0, "names": ("first",)}
        return scso.Rows(**good | self.changes)


@both_solvers
@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"names": ("a", "b")}, "Answering returned 1 rows, 2 names and 1 units"),
        ({"lower": 2.0}, "bounds of Answering[first] are 2 to 1, expected lower <= upper"),
        ({"upper": math.nan}, "bounds of Answering[first] are 0 to nan, expected lower <= upper"),
        ({"lower": [0.0, 0.0]}, "lower of Answering has shape (2,), expected () or (1,) = (n_rows,)"),
        ({"scale": 0.0}, "scale of Answering is 0, expected a positive number"),
        ({"scale": -1.0}, "scale of Answering is -1, expected a positive number"),
        ({"value": ca.SX(math.nan)}, "the rows Answering[first] are not finite at frame 0 (t = 0 s)"),
    ],
)
def test_mistakes_in_a_users_constraint_are_told_by_its_name(solve, changes, text):
    base = elbow([60.0])
    with raises((scso.ProblemError, scso.DataError), text):
        solve(dataclasses.replace(base, constraints=(*base.constraints, Answering(changes=changes))))


@both_solvers
@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (lambda f: f.activation, "returned shape (3, 1), expected one number per frame"),
        (lambda f: "cheap", "returned str, expected a CasADi expression"),
        (lambda f: None, "returned NoneType, expected a CasADi expression"),
    ],
)
def test_mistakes_in_a_users_function_are_told(solve, answer, text):
    with raises(scso.ProblemError, f"objective <lambda> {text}"):
        solve(with_objectives(elbow([60.0]), answer))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Supplied(scso.FrameConstraint):
    """A user's constraint with unknowns and data of its own."""

    values: object = None
    spec: object = None

    def data(self, problem):
        return {} if self.values is None else {"values": self.values}

    def variables(self, problem):
        return () if self.spec is None else (scso.VariableSpec(name="slack", labels=("s",), **self.spec),)

    def rows(self, frame, motion):
        return scso.Rows(value=frame.activation[0], lower=-9.0, upper=9.0, names=("first",))


@pytest.mark.parametrize(
    ("values", "text"),
    [
        (np.zeros(5), "data 'values' of Supplied has shape (5,), expected 2 frames first"),
        (3.0, "data 'values' of Supplied has shape (), expected 2 frames first"),
        ([0.0, math.nan], "data 'values' of Supplied is not finite at frame 1 (t = 0.01 s)"),
        (np.zeros((2, 1, 1, 1)), "per-frame data of shape (1, 1, 1) has more than two axes"),
    ],
)
def test_mistakes_in_a_terms_data_are_told_by_its_name(values, text):
    base = elbow([60.0, 60.0])
    with raises(scso.DataError, text):
        scso.solve_framewise(dataclasses.replace(base, constraints=(Supplied(values=values),)))


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        ({"lower": [0.0, 1.0]}, "lower of the unknowns 'slack' of Supplied has shape (2,)"),
        ({"lower": 2.0, "upper": 1.0}, "lower of the unknowns 'slack' of Supplied is 2.0, expected"),
        (
            {"guess": math.nan},
            "guess of the unknowns 'slack' of Supplied is nan, expected numbers that are finite",
        ),
        (
            {"scale": 0.0},
            "scale of the unknowns 'slack' of Supplied is 0.0, expected numbers that are positive",
        ),
    ],
)
def test_mistakes_in_a_terms_unknowns_are_told_by_its_name(spec, text):
    base = elbow([60.0, 60.0])
    with raises(scso.ProblemError, text):
        scso.solve_framewise(dataclasses.replace(base, constraints=(Supplied(spec=spec),)))


def with_objectives(problem, *objectives):
    return dataclasses.replace(problem, objectives=objectives)


# The verbs ----------------------------------------------------------------------------------------


@both_solvers
def test_an_initial_guess_of_another_motion_is_refused(solve):
    guess = solve(elbow([60.0, 60.0]))
    with raises(
        scso.ProblemError,
        "initial_guess has activations of shape (2, 3), expected (3, 3) = (n_frames, n_muscles)",
    ):
        solve(elbow([60.0, 60.0, 60.0]), initial_guess=guess)


@both_solvers
def test_a_guess_with_failed_frames_starts_them_afresh(solve):
    guess = solve(elbow([60.0, 300.0]), on_failure="return")
    assert np.isnan(guess.activation).any()
    assert solve(elbow([60.0, 60.0]), initial_guess=guess).status is scso.Status.SOLVED


@both_solvers
def test_an_unknown_way_to_fail_is_refused(solve):
    with raises(scso.ProblemError, "on_failure is 'ignore', expected 'raise' or 'return'"):
        solve(elbow([60.0]), on_failure="ignore")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"tolerance": 0.0}, "tolerance is 0, expected a number between 0 and 1"),
        ({"tolerance": -1.0}, "tolerance is -1, expected a number between 0 and 1"),
        ({"tolerance": math.nan}, "tolerance is nan, expected a number between 0 and 1"),
        ({"max_iterations": 0}, "max_iterations is 0, expected a whole number of at least 1"),
        ({"max_iterations": 2.5}, "max_iterations is 2.5, expected a whole number"),
    ],
)
def test_impossible_options_are_refused(options, text):
    with raises(scso.ProblemError, text):
        scso.SolverOptions(**options)


@both_solvers
@pytest.mark.parametrize("options", [{"no_such_option": 1}, {"mu_strategy": "bogus"}, {"tol": -1.0}])
def test_options_that_ipopt_refuses_are_told_with_their_names(solve, options):
    with raises(scso.ProblemError, f"IPOPT refused the program or its options {options}"):
        solve(elbow([60.0]), options=scso.SolverOptions(ipopt=options))


@both_solvers
def test_ipopt_options_by_their_own_names_are_used(solve):
    options = scso.SolverOptions(presolve=False, ipopt={"max_iter": 1})
    solution = solve(elbow([60.0], exponent=3.0), options=options, on_failure="return")
    assert solution.status is scso.Status.ITERATION_LIMIT


# What is small, but allowed -----------------------------------------------------------------------


@both_solvers
def test_a_problem_without_rows_has_no_reason_to_pull(solve):
    free = dataclasses.replace(elbow([60.0]), constraints=())
    np.testing.assert_allclose(solve(free).activation, 0.0, atol=1e-3)


@both_solvers
@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0, 3.0, math.inf])
def test_a_model_without_muscles_is_driven_by_its_actuators(solve, exponent):
    trajectory = motion(np.zeros((2, 1, 0)), [[6.0], [-4.0]], actuator_columns=[[2.0]])
    torque = scso.MuscleForceProblem(
        motion=scso.Motion(
            trajectory=trajectory,
            muscles=muscle_parameters((), np.zeros(0)),
            actuators=scso.ActuatorParameters(
                actuators=("reserve1",), optimal_force=[2.0], min_control=[-np.inf], max_control=[np.inf]
            ),
        ),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(exponent=exponent),),
    )
    np.testing.assert_allclose(solve(torque).control, [[3.0], [-2.0]], atol=1e-6)


@both_solvers
def test_a_cost_that_may_be_negative_stands_beside_a_steep_one(solve):
    def reward(frame):
        return -0.01 * frame.activation[2]

    both = with_objectives(elbow([60.0, 30.0], exponent=10.0), scso.ActivationEffort(exponent=10.0), reward)
    solution = solve(both)
    assert solution.objective_terms["reward"] < 0
    # d/da of a^10 is 0.01 at a = 0.001^(1/9), where the rewarded muscle stops paying.
    assert (solution.activation[:, 2] > 0.4).all()


def test_curved_rows_that_bind_nothing_change_nothing():
    base = random_problem(np.random.default_rng(3))
    curved = dataclasses.replace(base, constraints=(*base.constraints, CappedEffort(most=100.0)))
    np.testing.assert_allclose(
        scso.solve_trajectory(curved).activation, scso.solve_trajectory(base).activation, atol=1e-4
    )


def test_a_problem_prints_itself(rng):
    text = str(random_problem(rng, reserve=5.0))
    assert "tiny: 3 frames from 0 to 0.02 s, 10 muscles, 3 actuators, 3 free coordinates" in text
    assert "minimise    ActivationEffort()" in text
    assert "subject to  JointStability(" in text
