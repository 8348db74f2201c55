"""What the muscle curves claim about muscle, read back number by number."""

import numpy as np
import pytest
from muscle_models import classes
from muscle_models.classes import AtDefaults, slope
from muscle_models.opensim_formulas import inverse_force_velocity, optimal_force

from scso_nlp.muscle_models.curves import on_arrays
from scso_nlp.muscle_models.force import rigid_tendon_force, rigid_tendon_force_parts
from scso_nlp.muscle_models.hill_muscle import HillMuscle
from scso_nlp.muscle_models.thelen2003 import _tendon_toe

ALL = [AtDefaults(curves) for curves in classes.ALL]
thelen2003, millard2012, degroote2016, rigid_tendon_muscle = ALL
ELASTIC = ALL[:-1]


def name(module):
    return module.curves.OPENSIM_CLASS


@pytest.mark.parametrize(("module", "peak"), [(m, 1.0) for m in ELASTIC] + [(rigid_tendon_muscle, 0.998869)])
def test_active_force_is_one_at_optimal_length_and_less_elsewhere(module, peak):
    assert float(module.active_force_length(1.0)) == pytest.approx(peak, abs=1e-6)
    length = np.linspace(0.45, 1.75, 1301)
    # De Groote's fit peaks at 1.0011, a little off the optimal length
    assert on_arrays(module.active_force_length, length).max() <= 1.0011


def test_millard_has_no_active_force_outside_its_domain():
    """Gordon, Huxley and Julian (1966) by way of Millard (2013): 0.4441 to 1.8123 optimal lengths."""
    outside = np.array([0.0, 0.2, 0.44, 0.4441, 1.8123, 1.82, 2.5])
    assert np.abs(on_arrays(millard2012.active_force_length, outside)).max() < 1e-14
    assert on_arrays(millard2012.active_force_length, [0.46, 1.79]).min() > 1e-5


@pytest.mark.parametrize(
    ("module", "short", "long"),
    [(thelen2003, np.exp(-0.49 / 0.45), np.exp(-0.64 / 0.45)), (degroote2016, 0.0142, 0.0313)],
    ids=["thelen2003", "degroote2016"],
)
def test_gaussian_active_curves_only_fade(module, short, long):
    """At 0.3 and 1.8; Thelen's single Gaussian keeps a third of the force at 0.3."""
    assert float(module.active_force_length(0.3)) == pytest.approx(short, abs=5e-5)
    assert float(module.active_force_length(1.8)) == pytest.approx(long, abs=5e-5)


@pytest.mark.parametrize(
    ("module", "eccentric"),
    [(thelen2003, None), (millard2012, 1.4), (degroote2016, 1.794343), (rigid_tendon_muscle, 1.774455)],
)
def test_force_velocity_is_zero_at_minus_one_one_at_rest_and_more_when_lengthening(module, eccentric):
    assert float(module.force_velocity(-1.0)) == pytest.approx(0.0, abs=1e-12)
    assert float(module.force_velocity(0.0)) == pytest.approx(1.0, abs=1e-12)
    if eccentric is not None:
        assert float(module.force_velocity(1.0)) == pytest.approx(eccentric, abs=1e-6)
    speed = np.linspace(-0.999, 1.0, 2000)
    assert (np.diff(on_arrays(module.force_velocity, speed)) >= 0).all()


def test_thelen_lengthening_force_tends_to_flen_and_is_extrapolated_from_95_percent_of_it():
    assert float(thelen2003.force_velocity(0.18)) < 0.95 * 1.4 < float(thelen2003.force_velocity(0.19))
    low, high = (float(thelen2003.force_velocity(v)) for v in (0.2, 1.2))
    assert float(thelen2003.force_velocity(0.7)) == pytest.approx(0.5 * (low + high), rel=1e-14)


@pytest.mark.parametrize("module", ALL, ids=name)
def test_shortening_costs_more_force_than_lengthening_gives(module):
    """At a tenth of the maximum velocity, in either direction."""
    lost = 1.0 - float(module.force_velocity(-0.1))
    won = float(module.force_velocity(0.1)) - 1.0
    assert 0.25 < lost < 0.5
    assert 0.15 < won < 0.65


@pytest.mark.parametrize(("module", "ratio"), [(thelen2003, 2.0), (millard2012, None), (degroote2016, None)])
def test_slope_of_force_velocity_at_rest(module, ratio):
    """Thelen's slope doubles at zero velocity (5 to 10 with Af = 0.25); Millard's is 5."""
    h = 1e-6
    below = (1.0 - float(module.force_velocity(-h))) / h
    above = (float(module.force_velocity(h)) - 1.0) / h
    if ratio is not None:
        assert below == pytest.approx(5.0, rel=1e-4)
        assert above / below == pytest.approx(ratio, rel=1e-4)
    else:
        assert above == pytest.approx(below, rel=1e-3)
    if module is millard2012:
        assert below == pytest.approx(5.0, rel=1e-4)


@pytest.mark.parametrize("activation", [0.1, 0.5, 1.0])
def test_thelen_muscle_is_slower_when_less_active(activation):
    slowest = -(0.25 + 0.75 * activation)
    assert float(thelen2003.force_velocity(slowest, activation=activation)) == 0.0
    assert float(thelen2003.force_velocity(0.99 * slowest, activation=activation)) > 0.0


@pytest.mark.parametrize(
    ("module", "strain"),
    [(thelen2003, 0.6), (millard2012, 0.7), (degroote2016, 0.6)],
    ids=lambda m: str(m)[:30],
)
def test_passive_force_is_one_at_the_published_strain(module, strain):
    assert float(module.passive_force_length(1.0 + strain)) == pytest.approx(1.0, abs=1e-12)


def test_passive_force_only_when_stretched():
    short = np.linspace(0.3, 1.0, 71)
    for module in (thelen2003, millard2012, rigid_tendon_muscle):
        assert np.abs(on_arrays(module.passive_force_length, short)).max() == 0.0
        assert float(module.passive_force_length(1.2)) > 0.0
    # De Groote's curve never vanishes: 0.018 at optimal length, zero at 0.2
    assert float(degroote2016.passive_force_length(1.0)) == pytest.approx(0.018229, abs=1e-6)
    assert float(degroote2016.passive_force_length(0.2)) == pytest.approx(0.0, abs=1e-15)


def test_the_passive_spline_of_the_rigid_class_levels_off_and_swings_a_little():
    length = np.linspace(1.0, 6.0, 50001)
    value = on_arrays(rigid_tendon_muscle.passive_force_length, length)
    assert value.max() == pytest.approx(2.0105, abs=5e-5)
    slopes = on_arrays(rigid_tendon_muscle.passive_force_length_slope, length)
    assert -0.033 < slopes.min() < -0.032
    falls = length[slopes < -1e-3]
    assert (((falls > 1.6) & (falls < 1.602)) | (falls > 3.3)).all()


def test_thelen_kinks_where_its_documentation_says():
    assert float(thelen2003.passive_force_length_slope(1.0)) == 0.0
    assert float(thelen2003.passive_force_length_slope(1.0 + 1e-12)) == pytest.approx(0.0565, abs=5e-5)
    assert float(slope(thelen2003.tendon_force_length)(1.0)) == 0.0
    assert float(slope(thelen2003.tendon_force_length)(1.0 + 1e-12)) == pytest.approx(2.13, abs=5e-3)


@pytest.mark.parametrize(
    ("module", "strain"),
    [(thelen2003, 0.04), (millard2012, 0.049), (degroote2016, 0.049)],
    ids=["t", "m", "d"],
)
def test_tendon_carries_unit_force_at_the_published_strain(module, strain):
    """4 % (Thelen 2003), 4.9 % (Maganaris and Paul 2002, in Millard 2013 and OpenSim's De Groote)."""
    assert float(module.tendon_force_length(1.0 + strain)) == pytest.approx(1.0, abs=1e-12)
    assert float(module.tendon_force_length(1.0)) == pytest.approx(0.0, abs=1e-15)
    assert float(module.inverse_tendon_force_length(1.0)) == pytest.approx(1.0 + strain, abs=1e-13)


def test_slack_tendons_pull_nothing_except_de_grootes_which_pushes_a_little():
    slack = np.linspace(0.8, 1.0, 21)
    for module in (thelen2003, millard2012):
        assert np.abs(on_arrays(module.tendon_force_length, slack)).max() == 0.0
    pushed = on_arrays(degroote2016.tendon_force_length, slack)
    assert (pushed > -0.2).all()
    assert float(degroote2016.tendon_force_length(0.99)) < 0.0


def test_tendon_toes_and_linear_slopes():
    """Thelen: 0.33 at 0.609 of the strain, then 1.712 over it. Millard: 1.375 over the strain."""
    toe, linear = _tendon_toe(thelen2003.curves.DEFAULT_CURVE_PARAMETERS)
    assert toe / 0.04 == pytest.approx(0.609, abs=5e-4)
    assert linear * 0.04 == pytest.approx(1.712, abs=5e-4)
    assert float(thelen2003.tendon_force_length(1.0 + toe)) == pytest.approx(0.33, abs=1e-12)
    assert float(slope(millard2012.tendon_force_length)(1.049)) == pytest.approx(1.375 / 0.049, rel=1e-12)
    assert float(degroote2016.tendon_slope_at_force(0.0)) == pytest.approx(7.31, abs=5e-3)


@pytest.mark.parametrize("module", ELASTIC, ids=name)
def test_inverses_invert(module):
    force = np.array([0.01, 0.2, 0.33, 0.6, 0.9, 1.3])
    length = on_arrays(module.inverse_tendon_force_length, force)
    np.testing.assert_allclose(on_arrays(module.tendon_force_length, length), force, rtol=0, atol=2e-14)
    expected = on_arrays(slope(module.tendon_force_length), length)
    # the slope of the toe changes by its curvature (up to 1e4) times a rounding of the length
    np.testing.assert_allclose(on_arrays(module.tendon_slope_at_force, force), expected, rtol=1e-11)
    shape = dict(module.curves.DEFAULT_CURVE_PARAMETERS)
    if module is millard2012:
        # OpenSim's inverse always has these end slopes, its force-velocity curve without damping
        shape["force_velocity_curve.concentric_slope_at_vmax"] = 0.125
        shape["force_velocity_curve.eccentric_slope_at_vmax"] = 0.075
    velocity = np.array([-0.85, -0.5, -0.1, 0.0, 0.03, 0.1, 0.15, 0.5])
    multiplier = on_arrays(lambda v: module.curves.force_velocity(v, shape), velocity)
    again = on_arrays(lambda f: inverse_force_velocity(module.curves, f, shape), multiplier)
    np.testing.assert_allclose(again, velocity, rtol=0, atol=1e-13)


@pytest.mark.parametrize("module", ALL, ids=name)
def test_rigid_tendon_force_is_affine_except_for_thelen(module):
    muscle = HillMuscle(curves=module.curves, pennation_angle_at_optimal=0.2)
    active, passive = rigid_tendon_force_parts(muscle, 0.305, -0.2)
    for activation in (0.1, 0.3, 1.0):
        exact = float(rigid_tendon_force(muscle, activation, 0.305, -0.2))
        affine = activation * float(active) + float(passive)
        if module is thelen2003 and activation < 1:
            assert exact < affine
        else:
            assert exact == pytest.approx(affine, rel=1e-14)


def test_thelen_affine_force_overestimates_a_weak_shortening_muscle():
    """The documented numbers: 0.25 at a = 0.1 and 0.49 at a = 0.3, for a velocity of -0.2."""
    muscle = HillMuscle(curves=thelen2003.curves)
    for activation, share in ((0.1, 0.25), (0.3, 0.49)):
        active = float(rigid_tendon_force_parts(muscle, 0.3, -0.2)[0])
        assert float(rigid_tendon_force(muscle, activation, 0.3, -0.2)) / (
            activation * active
        ) == pytest.approx(share, abs=5e-3)


def test_opensim_capacity_of_a_pennate_millard_muscle_is_larger_than_the_physical_one():
    """By 1/cos(alpha), because OpenSim takes the angle of the normalized length; the soleus: up to 1.35."""
    muscle = HillMuscle(
        curves=millard2012.curves,
        max_isometric_force=3549.0,
        optimal_fiber_length=0.05,
        tendon_slack_length=0.25,
        pennation_angle_at_optimal=0.43633231,
    )
    path = np.linspace(0.275, 0.32, 10)
    physical = on_arrays(lambda x: rigid_tendon_force_parts(muscle, x, 0.0)[0], path)
    opensim = on_arrays(lambda x: optimal_force(muscle, x, 0.0), path)
    assert (opensim > physical).all()
    assert 1.3 < (opensim / physical).max() < 1.4


@pytest.mark.parametrize("module", [thelen2003, millard2012], ids=name)
def test_opensim_capacity_vanishes_for_a_fiber_at_its_lower_bound(module):
    muscle = HillMuscle(curves=module.curves, pennation_angle_at_optimal=0.3)
    shortest = float(module.curves.min_fiber_length(muscle))
    width = 0.1 * np.sin(0.3)
    at_bound = 0.2 + np.sqrt(shortest**2 - width**2)
    assert float(optimal_force(muscle, at_bound - 1e-9, 0.0)) == 0.0
    assert float(optimal_force(muscle, 0.15, 0.0)) == 0.0
    assert float(optimal_force(muscle, at_bound + 1e-2, 0.0)) > 0.0
