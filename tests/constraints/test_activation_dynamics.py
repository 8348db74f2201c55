"""Activation dynamics against a dense integration, and what coupling may and may not do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import evaluate_terms, motion, muscle_parameters
from muscle_models.mixed_muscles import MILLARD, RIGID, mixed_problem
from scipy.integrate import solve_ivp

import scso_nlp as scso
from scso_nlp.constraints.activation_dynamics import activation_rate

EXCITATION = "ActivationDynamics.excitation"
OPTIONS = scso.SolverOptions(tolerance=1e-10, max_iterations=2000)


def rate(excitation, activation, rise, fall, smoothness=10.0):
    """De Groote et al. (2016), written out in NumPy, with the smoothness that OpenSim 4.6 recommends."""
    f = 0.5 * np.tanh(smoothness * (excitation - activation))
    z = 0.5 + 1.5 * activation
    return (1 / (rise * z) * (f + 0.5) + z / fall * (0.5 - f)) * (excitation - activation)


def step(t):
    return np.where(t < 0.1, 0.05, np.where(t < 0.3, 0.9, 0.1))


def sine(t):
    return 0.5 + 0.4 * np.sin(2 * np.pi * 3 * t)


def dense(signal, times, rise=0.01, fall=0.04, start=0.05):
    """Activations that follow an excitation, to 1e-12; small steps are for the jumps of the step."""
    solution = solve_ivp(
        lambda t, a: rate(signal(t), a, rise, fall),
        (times[0], times[-1]),
        [start],
        t_eval=times,
        rtol=1e-11,
        atol=1e-12,
        max_step=1e-3,
        method="DOP853",
    )
    return solution.y[0]


def one_muscle(times, activation_target):
    """One muscle whose force the moments prescribe, without reserves: activations are known."""
    strength = 1000.0
    trajectory = dataclasses.replace(
        motion(np.full((len(times), 1, 1), 0.05), 0.05 * strength * activation_target[:, None]), time=times
    )
    return scso.MuscleForceProblem(
        motion=scso.Motion(trajectory=trajectory, muscles=muscle_parameters(trajectory.muscles, strength)),
        muscle_model=scso.NoPhysiology(),
        objectives=(scso.ActivationEffort(exponent=2.0),),
        constraints=(scso.MomentEquilibrium(), scso.ActivationDynamics()),
    )


def residual(problem, activation, excitation):
    rows = evaluate_terms(
        problem, activation, variables={("ActivationDynamics", "excitation"): np.asarray(excitation)}
    )[1]
    return rows["ActivationDynamics"]


def test_rows_are_the_trapezoidal_rule_of_the_models_time_constants(rng):
    problem = mixed_problem(rng, scso.NoPhysiology(), classes=(MILLARD,) * 5, shapes=({},) * 5)
    time = np.array([0.0, 0.01, 0.04, 0.05])
    problem = dataclasses.replace(
        problem,
        motion=dataclasses.replace(
            problem.motion, trajectory=dataclasses.replace(problem.motion.trajectory, time=time)
        ),
        constraints=(scso.ActivationDynamics(),),
    )
    a, e = rng.uniform(0.05, 0.9, (2, 4, 5))
    muscles = problem.motion.muscles
    rates = rate(e, a, muscles.activation_time_constant, muscles.deactivation_time_constant)
    expected = np.diff(a, axis=0) - 0.5 * np.diff(time)[:, None] * (rates[:-1] + rates[1:])
    np.testing.assert_allclose(residual(problem, a, e), expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("signal", [step, sine])
def test_the_trapezoidal_rule_is_of_second_order(signal):
    """March the rows with a given excitation: error against the dense solution, at halved steps.

    The step's jumps are put between two frames that share a time step of 1 ns, so that order is not lost.
    """
    errors = []
    for n in (100, 200, 400, 800):
        times = np.linspace(0.0, 0.5, n + 1)
        if signal is step:
            times = np.sort(np.concatenate([times, [0.1 - 1e-9, 0.3 - 1e-9]]))
        exact = dense(signal, times)
        found = np.empty_like(exact)
        found[0] = exact[0]
        e = signal(times + 1e-13)
        problem = one_muscle(times, np.full(len(times), 0.5))
        for k in range(len(times) - 1):
            found[k + 1] = _march(times[k : k + 2], found[k], e[k : k + 2])
        np.testing.assert_allclose(
            residual(problem, found[:, None], e[:, None]), 0.0, atol=1e-13, err_msg="not the package's rule"
        )
        errors.append(np.abs(found - exact).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.abs(orders[-2:] - 2.0).max() < 0.1, (errors, orders)


def _march(times, previous, excitations):
    """One implicit step by Newton's method."""
    dt, a = times[1] - times[0], previous
    known = rate(excitations[0], previous, 0.01, 0.04)

    def error(value):
        return value - previous - 0.5 * dt * (known + rate(excitations[1], value, 0.01, 0.04))

    for _ in range(50):
        slope = (error(a + 1e-7) - error(a - 1e-7)) / 2e-7
        change = error(a) / slope
        a -= change
        if abs(change) < 1e-15:
            break
    return a


def test_excitations_that_made_a_motion_are_found_again():
    """Activations of a dense solution are prescribed; excitations follow but for their alternating part."""
    times = np.linspace(0.0, 0.5, 201)
    activation = dense(sine, times, start=0.4)
    problem = one_muscle(times, activation)
    solution = scso.solve_trajectory(problem, options=OPTIONS)
    np.testing.assert_allclose(solution.activation[:, 0], activation, atol=1e-6)
    e = solution.variables[EXCITATION][:, 0]
    smooth = 0.25 * (e[:-2] + 2 * e[1:-1] + e[2:])
    np.testing.assert_allclose(smooth[5:-5], sine(times[6:-6]), atol=5e-3)


def test_activation_rises_and_falls_no_faster_than_full_and_no_excitation_let_it():
    """Asked for a jump, the muscle follows the dense solution for excitation 1, a reserve does the rest."""
    times = np.linspace(0.0, 0.2, 81)
    wanted = np.where(times < 0.1, 0.0, 1.0)
    problem = one_muscle(times, wanted)
    trajectory = dataclasses.replace(
        problem.motion.trajectory,
        actuators=("reserve",),
        actuator_generalized_forces=np.full((81, 1, 1), 50.0),
    )
    problem = dataclasses.replace(
        problem,
        motion=dataclasses.replace(
            problem.motion,
            trajectory=trajectory,
            actuators=scso.ActuatorParameters(
                actuators=("reserve",), optimal_force=[50.0], min_control=[-np.inf], max_control=[np.inf]
            ),
        ),
        objectives=(lambda frame: frame.control[0] ** 2,),
    )
    solution = scso.solve_trajectory(problem, options=OPTIONS)
    a, e = solution.activation[:, 0], solution.variables[EXCITATION][:, 0]
    fastest = 1 / 0.01 / 0.5  # rate at rest under full excitation [1/s], less f(e - a)
    assert np.diff(a).max() / np.diff(times).min() < 1.05 * fastest
    bounds = np.maximum(e - 1, -e)
    rising = (a > 0.1) & (a < 0.9)
    assert rising.sum() > 5
    # Full excitation holds, on the mean of neighbours: single frames may alternate.
    assert 0.5 * (e[:-1] + e[1:])[rising[:-1] & rising[1:]].min() > 0.9
    assert bounds.max() < 1e-6


def test_coupling_never_costs_less_and_costs_more_where_it_binds(rng):
    problem = mixed_problem(rng, scso.NoPhysiology(), classes=(MILLARD,) * 6, shapes=({},) * 6, n_frames=8)
    free = scso.solve_trajectory(problem)
    dynamic = dataclasses.replace(problem, constraints=(*problem.constraints, scso.ActivationDynamics()))
    coupled = scso.solve_trajectory(dynamic)
    assert free.excitation is None
    np.testing.assert_array_equal(coupled.excitation, coupled.variables[EXCITATION])
    assert coupled.objective > free.objective * (1 + 1e-3)
    # With time constants near zero there is no coupling left: excitation and activation are one.
    quick = dataclasses.replace(
        problem.motion.muscles,
        activation_time_constant=np.full(6, 1e-6),
        deactivation_time_constant=np.full(6, 1e-6),
    )
    loose = scso.solve_trajectory(
        dataclasses.replace(dynamic, motion=dataclasses.replace(problem.motion, muscles=quick))
    )
    assert loose.objective >= free.objective * (1 - 1e-6)
    assert loose.objective == pytest.approx(free.objective, rel=1e-4)


def test_a_single_frame_is_not_coupled(rng):
    problem = mixed_problem(rng, scso.NoPhysiology(), classes=(MILLARD,) * 4, shapes=({},) * 4)
    coupled = dataclasses.replace(problem, constraints=(*problem.constraints, scso.ActivationDynamics()))
    one = scso.solve_trajectory(coupled.frames(1, 2))
    np.testing.assert_allclose(
        one.activation, scso.solve_trajectory(problem.frames(1, 2)).activation, atol=1e-5
    )


def test_excitations_keep_the_models_bounds_of_control(rng):
    problem = mixed_problem(
        rng,
        scso.NoPhysiology(),
        classes=(MILLARD,) * 4,
        shapes=({},) * 4,
        min_activation=np.full(4, 0.05),
        max_activation=np.full(4, 0.4),
    )
    problem = dataclasses.replace(problem, constraints=(*problem.constraints, scso.ActivationDynamics()))
    e = scso.solve_trajectory(problem).variables[EXCITATION]
    assert (e >= 0.05 - 1e-7).all()
    assert (e <= 0.4 + 1e-7).all()


def test_frame_by_frame_refuses_dynamics_by_name_and_they_can_be_dropped(rng):
    problem = mixed_problem(rng, scso.NoPhysiology(), classes=(MILLARD,) * 4, shapes=({},) * 4)
    coupled = dataclasses.replace(problem, constraints=(*problem.constraints, scso.ActivationDynamics()))
    assert coupled.coupled_terms == ("ActivationDynamics",)
    with pytest.raises(scso.CouplingError, match=r"ActivationDynamics couples frames.*without_coupling\(\)"):
        scso.solve_framewise(coupled)
    dropped = scso.solve_framewise(coupled.without_coupling())
    assert EXCITATION not in dropped.variables


@pytest.mark.parametrize("term", [scso.ActivationDynamics(), scso.ActivationRate()])
@pytest.mark.parametrize("what", ["activation_time_constant", "deactivation_time_constant"])
def test_a_muscle_without_a_time_constant_is_named(rng, term, what):
    """RigidTendonMuscle has no activation dynamics in OpenSim."""
    problem = mixed_problem(
        rng,
        scso.NoPhysiology(),
        classes=(MILLARD, RIGID),
        shapes=({}, {}),
        **{what: np.array([0.01, 0.0])},
    )
    problem = dataclasses.replace(problem, constraints=(*problem.constraints, term))
    said = rf"{what} of 'm2' \(RigidTendonMuscle\) is 0 s, {term.name} needs a positive time"
    with pytest.raises(scso.DataError, match=said):
        scso.solve_trajectory(problem)


def test_a_sharp_transition_gives_thelens_rates(rng):
    """Rise (e - a)/(tau z), fall (e - a) z/tau with z = 1/2 + 3a/2, where e and a are well apart."""
    a = rng.uniform(0.1, 0.9, 20)
    for e, expected in (
        (a + 0.1, 0.1 / (0.01 * (0.5 + 1.5 * a))),
        (a - 0.1, -0.1 * (0.5 + 1.5 * a) / 0.04),
    ):
        found = [float(activation_rate(x, y, 0.01, 0.04, 200.0)) for x, y in zip(e, a, strict=True)]
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        for b in (0.1, 10.0):
            soft = [float(activation_rate(x, y, 0.01, 0.04, b)) for x, y in zip(e, a, strict=True)]
            np.testing.assert_allclose(soft, rate(e, a, 0.01, 0.04, b), rtol=1e-13)


@pytest.mark.parametrize(("limit", "sign"), [(1.0, 1.0), (0.0, -1.0)])
def test_rates_between_excitations_are_not_a_convex_set(rng, limit, sign):
    """Halfway between two motions at full (or no) excitation, the mean rate asks for more (or less).

    The excitation behind a rate is a + v tau z on the rise and a + v tau/z on the fall: Thelen's rates.
    """
    a = rng.uniform(0.1, 0.9, (2, 20))
    v = np.array(
        [[float(activation_rate(limit, x, 0.01, 0.04, 200.0)) for x in activations] for activations in a]
    )
    middle, wanted = a.mean(axis=0), v.mean(axis=0)
    z = 0.5 + 1.5 * middle
    excitation = middle + wanted * (0.01 * z if sign > 0 else 0.04 / z)
    assert (sign * (excitation - limit) > 0).all()


@pytest.mark.parametrize("smoothness", [0.0, -1.0, np.nan, np.inf])
def test_a_smoothness_that_is_not_positive_is_refused(smoothness):
    with pytest.raises(scso.ProblemError, match=f"smoothness is {smoothness:g}, expected a positive number"):
        scso.ActivationDynamics(smoothness=smoothness)
