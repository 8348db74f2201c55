"""Derivatives of the muscle curves: against OpenSim, extended precision, complex steps and differences."""

import itertools

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from muscle_models import opensim_tables as tables
from muscle_models.classes import (
    ELASTIC,
    AtDefaults,
    degroote2016,
    millard2012,
    name_of,
    rigid_tendon_muscle,
    thelen2003,
)

from scso_nlp.exceptions import DataError
from scso_nlp.muscle_models import bezier
from scso_nlp.muscle_models.bezier import bezier_curve, swapped
from scso_nlp.muscle_models.degroote2016 import ACTIVE_BUMPS
from scso_nlp.muscle_models.equilibrium import equilibrium_residual
from scso_nlp.muscle_models.force import rigid_tendon_force
from scso_nlp.muscle_models.hill_muscle import HillMuscle, n_constants, pack, unpack
from scso_nlp.muscle_models.millard2012 import (
    MIN_FORCE_OF_TENDON_SLOPE,
    active_force_length_corners,
    force_velocity_corners,
    passive_force_length_corners,
    tendon_force_length_corners,
)
from scso_nlp.muscle_models.stiffness import fiber_stiffness

BUILDERS = {
    "afl": (tables.ACTIVE_NAMES, active_force_length_corners),
    "fv": (tables.VELOCITY_NAMES, force_velocity_corners),
    "ffl": (tables.PASSIVE_NAMES, passive_force_length_corners),
    "tfl": (tables.TENDON_NAMES, tendon_force_length_corners),
}
TABLE_CURVES = (
    [f"afl{i}" for i in range(4)]
    + [f"fv{i}" for i in range(3)]
    + [f"fvi{i}" for i in range(2)]
    + [f"ffl{i}" for i in range(5)]
    + [f"tfl{i}" for i in range(5)]
)


def corners_of(curve, values):
    kind = curve.rstrip("0123456789")
    names, build = BUILDERS[kind.removesuffix("i") if kind == "fvi" else kind]
    parameters = millard2012.DEFAULT_CURVE_PARAMETERS | dict(zip(names, map(float, values), strict=True))
    corners = build(parameters)
    return swapped(corners) if kind == "fvi" else corners


def derivatives(curve, x, order=2):
    """Value and derivatives of a scalar curve by automatic differentiation, one row per order."""
    symbol = ca.SX.sym("x")
    outputs = [curve(symbol)]
    for _ in range(order):
        outputs.append(ca.gradient(outputs[-1], symbol))
    function = ca.Function("curve", [symbol], [ca.densify(o) for o in outputs])
    values = function.map(len(x)).call([ca.DM(x).T])
    return np.stack([v.full().ravel() for v in values])


def exactly(corners, x):
    """The curve in extended precision: de Casteljau's scheme and bisection, nothing of the tested code."""
    number = np.longdouble

    def evaluate(points, u, order=0):
        points, factor = list(points), number(1)
        for k in range(order):
            points = [b - a for a, b in itertools.pairwise(points)]
            factor *= 5 - k
        while len(points) > 1:
            points = [a + (b - a) * u for a, b in itertools.pairwise(points)]
        return factor * points[0]

    segments = []
    for c in corners:
        v = [number(float(value)) for value in c]
        segments.append(
            [
                [p, p + a, p + a, p + a + b, p + a + b, p + a + b + d]
                for p, a, b, d in ((v[0], v[1], v[2], v[3]), (v[4], v[5], v[6], v[7]))
            ]
        )
    rows = []
    for value in map(number, x):
        xs, ys = next((s for s in reversed(segments) if value >= s[0][0]), segments[0])
        low, high = number(0), number(1)
        for _ in range(70):
            middle = (low + high) / 2
            low, high = (middle, high) if evaluate(xs, middle) < value else (low, middle)
        u = (low + high) / 2
        xu, yu = evaluate(xs, u, 1), evaluate(ys, u, 1)
        outside = value < segments[0][0][0] or value > segments[-1][0][5]
        curvature = (evaluate(ys, u, 2) - yu / xu * evaluate(xs, u, 2)) / xu**2
        end = evaluate(ys, u) + yu / xu * (value - evaluate(xs, u)) if outside else evaluate(ys, u)
        rows.append((end, yu / xu, 0 if outside else curvature))
    return np.array(rows, dtype=float).T


@pytest.mark.parametrize("curve", TABLE_CURVES)
def test_millard_curves_and_two_derivatives_equal_opensim(shared_data, curve):
    """6000 points each: inside, at the joints and one bit beside them, 60 % outside."""
    with np.load(shared_data / "muscle_curves" / "reference_curves_millard.npz") as data:
        corners = corners_of(curve, data[f"{curve}_par"])
        x, expected = data[f"{curve}_x"], [data[f"{curve}_{suffix}"] for suffix in ("y", "dy", "d2y")]
    values = derivatives(lambda s: bezier_curve(s, corners), x)
    slope = derivatives(lambda s: bezier_curve(s, corners, derivative=1), x, order=0)[0]
    assert np.abs(values[0] - expected[0]).max() < 2e-12
    # OpenSim stops at x(u) - x = 2.2e-14: its slope is off by that times the curvature, at most 1e4
    limit = 2e-12 + 2.2e-14 * np.abs(expected[2]).max()
    assert np.abs(values[1] - expected[1]).max() < limit
    assert np.abs(slope - expected[1]).max() < limit
    assert np.abs(values[2] - expected[2]).max() < 5e-11 * np.abs(expected[2]).max()


@pytest.mark.parametrize("curve", ["afl0", "fv0", "fvi0", "ffl2", "tfl2", "tfl4"])
def test_millard_curves_equal_extended_precision(shared_data, curve):
    with np.load(shared_data / "muscle_curves" / "reference_curves_millard.npz") as data:
        corners, x = corners_of(curve, data[f"{curve}_par"]), data[f"{curve}_x"][::20]
    values = derivatives(lambda s: bezier_curve(s, corners), x)
    expected = exactly(corners, x)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    error = np.abs(values - expected) / scale
    # rounding only: of the abscissa (one bit of x times slope), and of 1/x'^2 for the second derivative
    assert error.max(axis=1)[0] < 1e-14
    assert error.max(axis=1)[1] < 1e-13
    assert error.max(axis=1)[2] < 1e-12


def test_halley_steps_leave_only_rounding(shared_data):
    """The root before the Taylor step, at the number of steps in use."""
    with np.load(shared_data / "muscle_curves" / "reference_curves_millard.npz") as data:
        curves = {name: corners_of(name, data[f"{name}_par"]) for name in TABLE_CURVES}
    part = ca.DM(np.linspace(0.0, 1.0, 1001))
    for name, corners in curves.items():
        for c in corners:
            c = bezier.Corner(*(ca.DM(value) for value in c))
            length = c.x_d0 + c.x_dm + c.x_d1
            powers = bezier._powers(c[1:4])
            u = bezier._cubic_guess(c, part)
            for _ in range(bezier.HALLEY_STEPS):
                u = bezier._halley_step(u, part * length, powers)
            left = bezier._dot(bezier._weights(u)[0], c[1:4]) - part * length
            assert np.abs(left.full()).max() < 5e-14, name


@pytest.mark.parametrize(
    ("build", "low", "high"),
    [
        (active_force_length_corners, 0.3, 2.0),
        (force_velocity_corners, -1.1, 1.1),
        (passive_force_length_corners, 0.9, 1.8),
        (tendon_force_length_corners, 0.99, 1.06),
    ],
)
def test_order_three_gives_the_third_derivative(build, low, high):
    """Fourth-order differences of the second derivative, away from joints, where the third one jumps."""
    h = 1e-4 * (high - low)
    corners = build(millard2012.DEFAULT_CURVE_PARAMETERS)
    joints = [float(c.x) for c in corners]
    joints.append(joints[-1] + sum(float(d) for d in corners[-1][1:4]))
    x = np.linspace(low, high, 203)
    x = x[np.abs(x[:, None] - joints).min(axis=1) > 20 * h]
    third = derivatives(lambda s: bezier_curve(s, corners, order=3), x, order=3)[3]

    def second(shift):
        return derivatives(lambda s: bezier_curve(s, corners), x + shift)[2]

    difference = (8.0 * (second(h) - second(-h)) - (second(2 * h) - second(-2 * h))) / (12.0 * h)
    assert np.abs(third - difference).max() < 1e-5 * np.abs(third).max()


@pytest.mark.parametrize(
    ("slope", "build", "low", "high"),
    [
        (AtDefaults(millard2012).active_force_length_slope, active_force_length_corners, 0.3, 2.0),
        (AtDefaults(millard2012).passive_force_length_slope, passive_force_length_corners, 0.9, 1.8),
        (None, tendon_force_length_corners, 0.99, 1.06),
    ],
)
def test_slopes_are_twice_differentiable(slope, build, low, high):
    """Of the tendon, whose slope the class gives as a function of force, the slope of its corners."""
    x = np.linspace(low, high, 203)
    corners = build(millard2012.DEFAULT_CURVE_PARAMETERS)
    value, first, second = derivatives(slope or (lambda s: bezier_curve(s, corners, derivative=1)), x)
    expected = derivatives(lambda s: bezier_curve(s, corners, order=3), x, order=3)
    for ours, theirs in zip((value, first, second), expected[1:], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-11 * (1.0 + np.abs(theirs).max()))


@pytest.mark.parametrize("module", [thelen2003, degroote2016, rigid_tendon_muscle], ids=name_of)
def test_slope_functions_are_the_derivatives_of_their_curves(module):
    length, curves = np.linspace(0.3, 1.8, 304), AtDefaults(module)
    pairs = [(curves.active_force_length, curves.active_force_length_slope, length)]
    pairs += [(curves.passive_force_length, curves.passive_force_length_slope, length)]
    if module.HAS_ELASTIC_TENDON:
        # a slack tendon has the slope of the stretched side at zero force
        stretch = np.linspace(0.98, 1.07, 304)
        stretch = stretch[stretch > 1.0] if module is thelen2003 else stretch
        pairs += [
            (
                curves.tendon_force_length,
                lambda x: curves.tendon_slope_at_force(curves.tendon_force_length(x)),
                stretch,
            )
        ]
    for curve, slope, x in pairs:
        first = derivatives(curve, x, order=1)[1]
        np.testing.assert_allclose(derivatives(slope, x, order=0)[0], first, rtol=1e-13, atol=1e-13)


# The same formulas once more, in complex NumPy: f(x + ih) has the derivative in its imaginary part without
# any difference of nearby numbers.
def thelen_numpy(a, length, velocity):
    """Thelen2003Muscle, default parameters, rigid tendon, eccentric below the extrapolation or concentric."""
    lm = np.sqrt((length - 0.2) ** 2 + (0.1 * np.sin(0.2)) ** 2)
    cos = (length - 0.2) / lm
    w = velocity * cos / (0.1 * 10.0) / (0.25 + 0.75 * a)
    b = (2 + 2 / 0.25) / 0.4
    fv = np.where(w.real <= 0, (1 + w) / (1 - w / 0.25), (1 + w * b * 1.4) / (1 + w * b))
    n = lm / 0.1
    fp = np.where(n.real > 1, (np.exp(5 * (n - 1) / 0.6) - 1) / (np.exp(5) - 1), 0)
    return 1000 * (a * np.exp(-((n - 1) ** 2) / 0.45) * fv + fp) * cos


def degroote_numpy(a, length, velocity):
    """DeGrooteFregly2016Muscle, default parameters and damping 0.01, rigid tendon."""
    lm = np.sqrt((length - 0.2) ** 2 + (0.1 * np.sin(0.2)) ** 2)
    cos = (length - 0.2) / lm
    n, v = lm / 0.1, velocity * cos / (0.1 * 10.0)
    b = np.array(ACTIVE_BUMPS)
    fl = sum(b1 * np.exp(-0.5 * (n - b2) ** 2 / (b3 + b4 * n) ** 2) for b1, b2, b3, b4 in b)
    t = -8.149 * v - 0.374
    fv = -0.3211346127989808 * np.log(t + np.sqrt(t**2 + 1)) + 0.8825327733249912
    o = np.exp(4 * -0.8 / 0.6)
    return 1000 * (a * fl * fv + (np.exp(4 * (n - 1) / 0.6) - o) / (np.exp(4) - o) + 0.01 * v) * cos


@pytest.mark.parametrize(
    ("module", "formula", "shape"),
    [(thelen2003, thelen_numpy, {}), (degroote2016, degroote_numpy, {"fiber_damping": 0.01})],
    ids=["thelen2003", "degroote2016"],
)
def test_force_hessian_equals_complex_steps(module, formula, shape, rng):
    """Gradient by complex step, Hessian by fourth-order differences of it."""
    muscle = HillMuscle(
        curves=module,
        pennation_angle_at_optimal=0.2,
        curve_parameters=module.check_curve_parameters("m", shape),
    )
    x = ca.SX.sym("x", 3)
    hessian, gradient = ca.hessian(rigid_tendon_force(muscle, *ca.vertsplit(x)), x)
    function = ca.Function("f", [x], [gradient, hessian])

    def complex_gradient(point):
        columns = [point + 1e-30j * np.eye(3)[i] for i in range(3)]
        return np.array([np.imag(formula(*c)) / 1e-30 for c in columns])

    h = 1e-3
    for _ in range(40):
        # away from the kinks at optimal length, zero velocity and the start of the extrapolation
        speed = rng.uniform(0.02, 0.08) * rng.choice([-1.0, 1.0])
        path = 0.3 + rng.choice([-1.0, 1.0]) * rng.uniform(0.01, 0.04)
        point = np.array([rng.uniform(0.4, 1.0), path, speed])
        ours_gradient, ours_hessian = (v.full() for v in function(point))
        expected = complex_gradient(point)
        assert np.abs(ours_gradient[:, 0] - expected).max() < 1e-12 * np.abs(expected).max()
        rows = []
        for i in range(3):
            e = h * np.array([1.0, 0.1, 1.0])[i] * np.eye(3)[i]
            rows.append(
                (
                    8 * (complex_gradient(point + e) - complex_gradient(point - e))
                    - complex_gradient(point + 2 * e)
                    + complex_gradient(point - 2 * e)
                )
                / (12 * e[i])
            )
        np.testing.assert_allclose(ours_hessian, np.array(rows), rtol=0, atol=3e-6 * np.abs(rows).max())


@pytest.mark.parametrize("curves", ELASTIC, ids=name_of)
def test_gradient_and_hessian_by_every_constant_of_the_muscle(curves):
    """Differences of residual and gradient by optimal length, slack length, shape: calibration needs them."""
    q, a, length = 0.088, 0.6, 0.295
    packed = np.asarray(pack(HillMuscle(curves=curves, pennation_angle_at_optimal=0.25)).full())[:, 0]
    symbols = ca.SX.sym("p", n_constants(curves))
    value = equilibrium_residual(unpack(curves, symbols), q, a, length, 0.03)
    hessian, gradient = ca.hessian(value, symbols)
    function = ca.Function("f", [symbols], [value, gradient, hessian])
    value, gradient, hessian = (v.full() for v in function(packed))
    assert np.isfinite(gradient).all()
    assert np.isfinite(hessian).all()
    steps = 1e-6 * np.where(packed == 0, 1.0, np.abs(packed))
    for i, h in enumerate(steps):
        e = h * np.eye(len(packed))[i]
        plus, minus = function(packed + e), function(packed - e)
        slope = (float(plus[0]) - float(minus[0])) / (2 * h)
        # the residual has errors of 1e-15, divided by the step
        assert abs(gradient[i, 0] - slope) < 1e-7 * abs(slope) + 1e-13 / h, i
        column = (plus[1].full() - minus[1].full())[:, 0] / (2 * h)
        scale = np.abs(hessian).max(axis=1)
        rounding = 1e-14 * (1 + np.abs(gradient).max()) / h
        assert (np.abs(hessian[:, i] - column) < 1e-5 * scale + rounding).all(), i


@pytest.mark.parametrize("curves", ELASTIC, ids=name_of)
def test_hessian_of_a_force_length_stiffness(curves):
    muscle = HillMuscle(curves=curves)
    x = ca.SX.sym("x", 2)
    value = fiber_stiffness(muscle, x[0], 0.1 * x[1], 1.0)
    hessian, gradient = ca.hessian(value, x)
    function = ca.Function("f", [x], [gradient, hessian])
    h = 1e-5
    for length in (0.6, 0.83, 1.16, 1.31):
        ours = function([0.5, length])[1].full()
        e = np.array([0.0, h])
        p = np.array([0.5, length])
        column = (function(p + e)[0].full() - function(p - e)[0].full())[:, 0] / (2 * h)
        np.testing.assert_allclose(ours[:, 1], column, rtol=0, atol=1e-5 * np.abs(column).max())


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5),
    st.floats(0.0, 1.0),
)
def test_any_allowed_tendon_curve_is_monotone_exact_and_invertible(choice, where):
    strain = 0.01 + 0.14 * choice[0]
    stiffness = (1.1 + 0.8 * choice[1]) / strain
    parameters = millard2012.DEFAULT_CURVE_PARAMETERS | dict(
        zip(tables.TENDON_NAMES, (strain, stiffness, 0.2 + 0.6 * choice[2], choice[3]), strict=True)
    )
    try:
        millard2012.check_curve_parameters("m", parameters)
    except DataError:
        return
    corners = tendon_force_length_corners(parameters)
    stretch = 1.0 + strain * (0.01 + 1.3 * where)
    force, slope, _ = derivatives(lambda s: bezier_curve(s, corners), np.array([stretch]))[:, 0]
    expected = exactly(corners, [stretch])[:, 0]
    assert abs(force - expected[0]) < 1e-13
    assert slope > 0
    inverse = float(millard2012.inverse_tendon_force_length(force, parameters))
    assert inverse == pytest.approx(stretch, abs=1e-13)
    if force > MIN_FORCE_OF_TENDON_SLOPE:
        assert float(millard2012.tendon_slope_at_force(force, parameters)) == pytest.approx(slope, rel=1e-8)
