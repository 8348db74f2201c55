"""Stiffness laws: hand calculations, OpenSim's definition at equilibrium, and the published equivalence."""

import casadi as ca
import numpy as np
import pytest
from muscle_models import opensim_tables as tables
from muscle_models.classes import ELASTIC, AtDefaults, name_of, rigid_tendon_muscle, slope
from muscle_models.opensim_formulas import force_length_stiffness

from scso_nlp.muscle_models import stiffness as laws
from scso_nlp.muscle_models.curves import on_arrays
from scso_nlp.muscle_models.equilibrium import solve_equilibrium
from scso_nlp.muscle_models.hill_muscle import HillMuscle, repeat_over_frames


def test_springs_in_series():
    assert float(laws.in_series(1000.0, 1000.0)) == 500.0
    assert float(laws.in_series(0.0, 1000.0)) == 0.0
    assert float(laws.in_series(0.0, 0.0)) == 0.0


def test_stiffness_along_the_tendon_is_the_derivative_of_the_projected_force():
    """Force k (l - l0) of a fiber of constant width, projected, differentiated by the projected length."""
    k, rest, width = 3000.0, 0.07, 0.04
    q = ca.SX.sym("q")
    length = ca.sqrt(q**2 + width**2)
    derivative = ca.Function("d", [q], [ca.gradient(k * (length - rest) * q / length, q)])
    for value in (0.07, 0.09, 0.12):
        fiber = np.hypot(value, width)
        along = laws.stiffness_along_tendon(k, k * (fiber - rest), fiber, value / fiber)
        assert along == pytest.approx(float(derivative(value)), rel=1e-13)


def test_short_range_fiber_stiffness_has_the_published_constant():
    """Cui et al. (2008): 23.4 times force over optimal fiber length; the tendon of this class is rigid."""
    muscle = HillMuscle(curves=rigid_tendon_muscle, optimal_fiber_length=0.117)
    assert laws.short_range_stiffness(muscle, 100.0, 0.1, 1.0) == pytest.approx(20000.0)


@pytest.mark.parametrize("module", ELASTIC, ids=name_of)
def test_short_range_stiffness_without_pennation_is_two_springs(module):
    muscle = HillMuscle(curves=module)
    force = np.array([1.0, 50.0, 200.0, 600.0, 1000.0])
    fiber = 23.4 * force / 0.1
    curves = AtDefaults(module)
    length = on_arrays(curves.inverse_tendon_force_length, force / 1000.0)
    tendon = 1000.0 / 0.2 * on_arrays(slope(curves.tendon_force_length), length)
    found = on_arrays(lambda f: laws.short_range_stiffness(muscle, f, 0.09, 1.0), force)
    np.testing.assert_allclose(found, fiber * tendon / (fiber + tendon), rtol=1e-11)
    assert (found < fiber).all()
    assert (found < tendon).all()


@pytest.mark.parametrize("module", ELASTIC, ids=name_of)
def test_short_range_stiffness_is_zero_and_differentiable_at_zero_force(module):
    muscle = HillMuscle(curves=module)
    f = ca.SX.sym("f")
    k = laws.short_range_stiffness(muscle, f, 0.1, 0.95)
    hessian, gradient = ca.hessian(k, f)
    value, slope, curvature = (float(v) for v in ca.Function("k", [f], [k, gradient, hessian])(0.0))
    assert value == 0.0
    # a weak fiber is softer than its tendon: cosine squared for the fiber, sine squared for the geometry
    expected = (23.4 / 0.1 * 0.95**2 + (1 - 0.95**2) / 0.1) / 0.95
    assert slope == pytest.approx(expected, rel=1e-12)
    assert np.isfinite(curvature)


def test_a_rigid_tendon_leaves_the_stiffness_of_the_fiber():
    muscle = HillMuscle(curves=rigid_tendon_muscle)
    assert laws.short_range_stiffness(muscle, 100.0, 0.1, 1.0) == pytest.approx(23400.0)


@pytest.mark.parametrize("module", ELASTIC, ids=name_of)
def test_stiffness_at_equilibrium_is_the_slope_of_force_over_path_length(module):
    muscle = HillMuscle(curves=module, pennation_angle_at_optimal=0.3)
    h = 1e-6
    path = np.array([0.27, 0.29, 0.31, 0.33])
    activation = np.full(4, 0.4)
    state, plus, minus = (solve_equilibrium(muscle, activation, path + d) for d in (0.0, h, -h))
    expected = (plus.tendon_force - minus.tendon_force) / (2 * h)
    found = on_arrays(
        lambda q, fiber, length: force_length_stiffness(muscle, 0.4, fiber, q / fiber, length - q).muscle,
        state.fiber_length_along_tendon,
        state.fiber_length,
        path,
    )
    # truncation of the difference, and kinks of Thelen's curves are not met on this grid
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize(("model", "low", "high"), [("arm26", 28.0, 64.0), ("gait2392_thelen", 24.0, 105.0)])
def test_equivalent_bergmark_constant_of_real_models(shared_data, model, low, high):
    """Short-range stiffness with tendon equals k = q F / L with q of 30 to 45 for most muscles."""
    muscles, data = tables.model_muscles(shared_data, model)
    shape = data["lMT"].shape
    columns = repeat_over_frames(muscles, shape[0])
    state = solve_equilibrium(muscles, np.full(shape, 0.1), data["lMT"])
    k = on_arrays(
        lambda f, fiber, q: laws.short_range_stiffness(columns, f, fiber, q / fiber),
        state.tendon_force,
        state.fiber_length,
        state.fiber_length_along_tendon,
    )
    strong = state.tendon_force > 1e-3 * data["params"][:, 0]
    q = (k * data["lMT"] / np.where(strong, state.tendon_force, 1.0))[strong]
    assert np.percentile(q, 5) == pytest.approx(low, abs=1.0)
    assert 35.0 < np.median(q) < 48.0
    assert np.percentile(q, 95) == pytest.approx(high, rel=0.05)


def test_force_length_stiffness_is_negative_on_the_descending_limb():
    for module in ELASTIC:
        assert float(laws.fiber_stiffness(HillMuscle(curves=module), 1.0, 0.12, 1.0)) < 0.0
        assert float(laws.fiber_stiffness(HillMuscle(curves=module), 1.0, 0.08, 1.0)) > 0.0
