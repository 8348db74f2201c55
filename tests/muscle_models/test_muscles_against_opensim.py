"""Forces, equilibria and stiffnesses against OpenSim 4.6's own values.

Tolerances are those at which the two programs can agree (OpenSim iterates: Millard roots to 2.2e-14 in the
abscissa, the Thelen force-velocity curve to 1e-6 in velocity, its equilibria to 1e-8 of the maximum force).
"""

import casadi as ca
import numpy as np
import pytest
from muscle_models import opensim_formulas
from muscle_models import opensim_tables as tables
from muscle_models.opensim_tables import CASES, ELASTIC_CASES

from scso_nlp.muscle_models import stiffness
from scso_nlp.muscle_models.curves import on_arrays
from scso_nlp.muscle_models.equilibrium import solve_equilibrium
from scso_nlp.muscle_models.force import rigid_tendon_force, rigid_tendon_force_parts, tendon_force
from scso_nlp.muscle_models.hill_muscle import repeat_over_frames

CURVE_TOLERANCE = 2e-12
#: Of maximum isometric force; the closed Thelen curve is exact, OpenSim's iteration is not.
FORCE_TOLERANCE = {"thelen2003": 1e-10, "millard2012": 1e-12, "degroote2016": 1e-12, "rigidtendon": 1e-12}


def is_clamped(case, rows):
    """Fibers that OpenSim holds at their lower bound: it reports no force and no stiffness for them."""
    return (
        (rows["kT"] == 0) & (rows["kM"] == 0) if case[0] in ("thelen2003", "millard2012") else rows["kT"] < 0
    )


@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_opensim_capacity_equals_calc_inextensible_tendon_active_fiber_force(shared_data, case):
    rows, muscle = tables.table(shared_data, case, "rigid"), tables.muscle(shared_data, case, rigid=True)
    force = on_arrays(
        lambda a, length, velocity: opensim_formulas.optimal_force(muscle, length, velocity, a),
        rows["a"],
        rows["lMT"],
        rows["vMT"],
    )
    error = np.abs(force - rows["F_SO"]) / muscle.max_isometric_force
    assert len(error) > 6000
    assert error.max() < FORCE_TOLERANCE[case[0]]


@pytest.mark.parametrize("name", ["arm26", "gait2392_thelen", "gait2392_millard"])
def test_opensim_capacity_of_whole_models(shared_data, name):
    muscles, data = tables.model_muscles(shared_data, name)
    columns = repeat_over_frames(muscles, len(data["lMT"]))
    force = on_arrays(
        lambda length, velocity: opensim_formulas.optimal_force(columns, length, velocity),
        data["lMT"],
        data["vMT"],
    )
    error = np.abs(force - data["F_SO"]) / data["params"][:, 0]
    assert error.max() < (1e-12 if "millard" in name else 1e-10)


@pytest.mark.parametrize("case", [c for c in CASES if c[0] != "thelen2003"], ids="-".join)
def test_physical_rigid_tendon_force_equals_opensim_without_tendon_compliance(shared_data, case):
    """OpenSim has no rigid Thelen2003Muscle. Its Millard cuts negative forces and short fibers off."""
    rows, muscle = tables.table(shared_data, case, "rigid"), tables.muscle(shared_data, case, rigid=True)
    # RigidTendonMuscle takes the velocity of the path for that of the fiber
    velocity = rows["vMT"] / (rows["cosalpha"] if case[0] == "rigidtendon" else 1.0)
    force = on_arrays(
        lambda a, length, v: rigid_tendon_force(muscle, a, length, v), rows["a"], rows["lMT"], velocity
    )
    shortest = float(muscle.curves.min_fiber_length(muscle)) / muscle.optimal_fiber_length
    regular = rows["lN"] > shortest + 1e-9
    if case[0] == "millard2012":
        force = np.maximum(force, 0.0)
    error = np.abs(force - rows["Ft"])[regular] / muscle.max_isometric_force
    assert regular.sum() > 5500
    assert error.max() < 1e-12
    parts = [
        on_arrays(
            lambda length, v, i=i: rigid_tendon_force_parts(muscle, length, v)[i], rows["lMT"], velocity
        )
        for i in range(2)
    ]
    np.testing.assert_allclose(
        rows["a"] * parts[0], np.where(regular, rows["Fact_AT"], rows["a"] * parts[0]), rtol=0,
        atol=1e-12 * muscle.max_isometric_force,
    )  # fmt: skip


@pytest.mark.parametrize("case", [c for c in CASES if c[0] != "thelen2003"], ids="-".join)
def test_curves_on_the_rigid_grid(shared_data, case):
    rows, muscle = tables.table(shared_data, case, "rigid"), tables.muscle(shared_data, case, rigid=True)
    curves, shape = muscle.curves, muscle.curve_parameters
    for curve, x, expected in (
        (curves.active_force_length, "lN", "fl"),
        (curves.passive_force_length, "lN", "fpe"),
        (curves.force_velocity, "vN", "fv"),
    ):
        values = on_arrays(lambda v, curve=curve: curve(v, shape), rows[x])
        assert np.abs(values - rows[expected]).max() < CURVE_TOLERANCE, expected


@pytest.mark.parametrize("case", ELASTIC_CASES, ids="-".join)
def test_curves_forces_and_velocities_of_explicit_states(shared_data, case):
    rows, muscle = tables.table(shared_data, case, "state"), tables.muscle(shared_data, case)
    # fiber velocities of DeGrooteFregly2016Muscle overflow far from equilibrium
    good = np.isfinite(np.stack(list(rows.values()))).all(axis=0)
    assert good.sum() > 4000
    rows = {name: values[good] for name, values in rows.items()}
    curves, shape, strength = muscle.curves, muscle.curve_parameters, muscle.max_isometric_force
    length = rows["lM"] / muscle.optimal_fiber_length
    stretch = rows["lT"] / muscle.tendon_slack_length
    active = on_arrays(lambda x: curves.active_force_length(x, shape), length)
    passive = on_arrays(lambda x: curves.passive_force_length(x, shape), length)
    assert np.abs(active - rows["fl"]).max() < CURVE_TOLERANCE
    assert np.abs(passive - rows["fpe"]).max() < CURVE_TOLERANCE
    force = on_arrays(lambda x: curves.tendon_force_length(x, shape), stretch)
    assert np.abs(force - rows["Ft"] / strength).max() < 1e-12
    along_path = on_arrays(
        lambda q, path: tendon_force(muscle, q, path), rows["lM"] * rows["cosalpha"], rows["lMT"]
    )
    assert np.abs(along_path - rows["Ft"]).max() < 1e-12 * strength

    free = ~is_clamped(case, rows)
    a, velocity, multiplier = rows["a"][free], rows["vN"][free], rows["fv"][free]
    damping = float(curves.fiber_damping(shape))
    expected = strength * (a * active[free] * multiplier + passive[free] + damping * velocity)
    scale = strength * (1.0 + np.abs(expected / strength))
    assert (np.abs(expected - rows["FM"][free]) / scale).max() < 1e-12
    if case[0] == "millard2012" and damping > 0:
        values = on_arrays(lambda v: curves.force_velocity(v, shape), velocity)
        assert np.abs(values - multiplier).max() < CURVE_TOLERANCE
    else:
        # here OpenSim computes the velocity from the force by the inverse curve
        inverse = on_arrays(
            lambda f, x: opensim_formulas.inverse_force_velocity(curves, f, shape, x), multiplier, a
        )
        assert (np.abs(inverse - velocity) / (1.0 + np.abs(velocity))).max() < CURVE_TOLERANCE


@pytest.mark.parametrize("case", ELASTIC_CASES, ids="-".join)
def test_stiffness_of_explicit_states(shared_data, case):
    rows, muscle = tables.table(shared_data, case, "state"), tables.muscle(shared_data, case)
    good = np.isfinite(np.stack(list(rows.values()))).all(axis=0) & ~is_clamped(case, rows)
    rows = {name: values[good] for name, values in rows.items()}
    fiber = on_arrays(lambda *x: stiffness.fiber_stiffness(muscle, *x), rows["a"], rows["lM"], rows["fv"])
    along = on_arrays(stiffness.stiffness_along_tendon, rows["kM"], rows["FM"], rows["lM"], rows["cosalpha"])
    tendon = on_arrays(lambda x: opensim_formulas.tendon_stiffness_at_length(muscle, x), rows["lT"])
    whole = on_arrays(stiffness.in_series, rows["kM_AT"], rows["kT"])
    fiber_scale = muscle.max_isometric_force / muscle.optimal_fiber_length
    tendon_scale = 28.0 * muscle.max_isometric_force / muscle.tendon_slack_length
    for ours, name, scale in (
        (fiber, "kM", fiber_scale),
        (along, "kM_AT", fiber_scale),
        (tendon, "kT", tendon_scale),
        (whole, "kMT", fiber_scale),
    ):
        error = np.abs(ours - rows[name]) / np.maximum(np.abs(rows[name]), scale)
        # Millard slopes of OpenSim carry its root tolerance times the curvature, 12800 * 2e-14 in the toe
        assert error.max() < (5e-11 if case[0] == "millard2012" else 1e-12), name


@pytest.mark.parametrize("case", ELASTIC_CASES, ids="-".join)
def test_equilibrium_against_equilibrate_muscles(shared_data, case):
    """Thelen2003Muscle shares the path's velocity by a heuristic of its own: compared at zero velocity."""
    rows, muscle = tables.table(shared_data, case, "equil"), tables.muscle(shared_data, case)
    taken = np.isfinite(rows["Ft"])
    if case[0] == "thelen2003":
        taken &= rows["vMT"] == 0
    rows = {name: values[taken] for name, values in rows.items()}
    velocity = rows["vMT"] if case[0] == "degroote2016" else 0.0
    state = solve_equilibrium(muscle, rows["a"], rows["lMT"], velocity)
    assert len(rows["a"]) >= 138
    assert not state.is_at_lower_bound.any()
    assert np.abs(state.residual).max() < 1e-13
    assert np.abs(state.tendon_force - rows["Ft"]).max() < 2e-8 * muscle.max_isometric_force


@pytest.mark.parametrize("case", ELASTIC_CASES, ids="-".join)
def test_equilibrium_against_polished_rows(shared_data, case):
    """OpenSim's own functions were driven to zero velocity in all of these rows but one."""
    rows, muscle = tables.table(shared_data, case, "equil_polished"), tables.muscle(shared_data, case)
    state = solve_equilibrium(muscle, rows["a"], rows["lMT"], rows["vMT"])
    left = rows["residual |vN| (Thelen,Millard) or |dF|/Fmax (DGF)"]
    polished = left < 1e-12
    assert (~polished).sum() <= 1
    force_error = np.abs(state.tendon_force - rows["Ft"]) / muscle.max_isometric_force
    length_error = np.abs(state.fiber_length - rows["lM"]) / muscle.optimal_fiber_length
    assert force_error[polished].max() < 1e-12
    assert length_error[polished].max() < 1e-12
    assert (force_error < 1e-12 + left).all()


@pytest.mark.parametrize("name", ["arm26", "gait2392_thelen", "gait2392_millard"])
def test_equilibrium_and_stiffness_of_whole_models(shared_data, name):
    muscles, data = tables.model_muscles(shared_data, name)
    shape = data["lMT"].shape
    columns = repeat_over_frames(muscles, shape[0])
    index = {str(c): i for i, c in enumerate(data["equil_columns"])}
    strength = data["params"][:, 0]
    for k, activation in enumerate(data["activations"]):
        rows = {c: data["equil"][:, k, :, i] for c, i in index.items()}
        state = solve_equilibrium(muscles, np.full(shape, activation), data["lMT"])
        assert (np.abs(state.tendon_force - rows["Ft"]) / strength).max() < 2e-8
        found = opensim_formulas.force_length_stiffness(
            columns,
            activation,
            ca.DM(rows["lM"].ravel()),
            ca.DM(rows["cosalpha"].ravel()),
            ca.DM(rows["lT"].ravel()),
        )
        free = ~state.is_at_lower_bound & (rows["kM"] != 0)
        scale = strength / data["params"][:, 1]
        for ours, column in zip(found, ("kM", "kM_AT", "kT", "kMT"), strict=True):
            error = np.abs(ours.full().reshape(shape) - rows[column]) / np.maximum(
                scale, np.abs(rows[column])
            )
            # OpenSim's fiber still moves by its equilibrium tolerance, which changes its multiplier
            assert error[free].max() < 1e-6, column
