"""Force-length-velocity on: OpenSim's own static optimization and an active-set solver beside ours.

Every muscle of arm26 is read as each of the four classes in turn; the gait models stay as they are.
"""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers import solve_qp_frame, unknowns
from muscle_models.opensim_formulas import optimal_force
from tiny_model import ask_opensim

import scso_nlp as scso
from scso_nlp.io.storage import read_storage
from scso_nlp.muscle_models.curves import on_arrays
from scso_nlp.muscle_models.hill_muscle import repeat_over_frames
from scso_nlp.muscle_models.muscle_classes import muscle_groups

pytestmark = pytest.mark.opensim

CLASSES = (
    "Thelen2003Muscle",
    "Millard2012EquilibriumMuscle",
    "DeGrooteFregly2016Muscle",
    "RigidTendonMuscle",
)
SETUPS = {
    "arm26": "arm26_millard_Setup_StaticOptimization.xml",
    "gait10dof18musc": "setup_static_optimization.xml",
    "walking3d": "setup_static_optimization.xml",
}
MODELS = {
    "arm26": "arm26_millard.osim",
    "gait10dof18musc": "gait10dof18musc_simbody.osim",
    "walking3d": "subject_walk_scaled.osim",
}

#: Of maximum isometric force. OpenSim finds Thelen's force-velocity multiplier by an iteration that stops at
#: 1e-6 of velocity and converges quadratically: 2.4e-10 was the most on these motions.
CAPACITY_TOLERANCE = dict.fromkeys(CLASSES, 1e-12) | {"Thelen2003Muscle": 3e-10}
#: Normalized velocity below which that iteration stops before it begins, with the multiplier at rest. The
#: steepest slope there is 2 (1 + 1/Af) of at most 10.
THELEN_AT_REST = 1e-6
#: OpenSim's answers differ from the exact optimum of the same problem by about 1e-3, at most 1e-2 [-].
OPENSIM_TOLERANCE = 1e-2
#: Activation and control [-]: what the package promises against an independent solver.
QP_TOLERANCE = 1e-4


def as_class(text: str, opensim_class: str) -> str:
    """Read every muscle of a model as another class, with that class's default curves."""
    text = re.sub(r"(</?)(?:Millard2012Equilibrium|Thelen2003)Muscle\b", rf"\g<1>{opensim_class}", text)
    text = re.sub("<optimal_force>.*?</optimal_force>", "", text)  # some classes refuse it
    if opensim_class != "Millard2012EquilibriumMuscle":
        for name in ("ActiveForceLength", "ForceVelocity", "FiberForceLength", "TendonForceLength"):
            text = re.sub(rf"<{name}Curve\b.*?</{name}Curve>", "", text, flags=re.DOTALL)
    for name in ("minimum_activation", "min_control"):
        text = re.sub(rf"<{name}>.*?</{name}>", f"<{name}>0.01</{name}>", text)
    return text


def copied(source: Path, folder: Path, case: str, opensim_class: str | None) -> Path:
    """Copy a data set and read its muscles as a class; return the setup file."""
    shutil.copytree(source / case, folder / case)
    if opensim_class is not None:
        model = folder / case / MODELS[case]
        model.write_text(as_class(model.read_text(), opensim_class))
    if case == "walking3d":
        # OpenSim assembles every row of a motion before it starts: keep the first 80.
        motion = folder / case / "coordinates.sto"
        lines = motion.read_text().splitlines()
        start = lines.index("endheader") + 2
        lines = ["nRows=80" if line.startswith("nRows") else line for line in lines[: start + 80]]
        motion.write_text("\n".join(lines) + "\n")
        setup = folder / case / SETUPS[case]
        text = setup.read_text()
        for name, value in (("initial_time", "0.47"), ("final_time", "0.51"), ("step_interval", "10")):
            text = re.sub(f"<{name}>.*?</{name}>", f"<{name}>{value}</{name}>", text)
        setup.write_text(text)
    return folder / case / SETUPS[case]


@pytest.mark.parametrize(
    ("case", "opensim_class"),
    [*(("arm26", name) for name in CLASSES), ("gait10dof18musc", None), ("walking3d", None)],
)
def test_opensims_convention_gives_the_activations_of_opensim_and_of_a_quadratic_program(
    case, opensim_class, shared_data, tmp_path
):
    setup = copied(shared_data, tmp_path, case, opensim_class)
    motion = scso.load_motion(setup, keep_coupled_speeds=True)
    problem = scso.static_optimization(motion)
    solution = scso.solve_trajectory(problem)
    results = tmp_path / "results"
    ask_opensim(tmp_path, kind="static optimization", setup=setup, results=results)
    theirs = read_storage(next(results.glob("*_activation.sto")))
    np.testing.assert_allclose(
        solution.activation, theirs.columns(problem.motion.trajectory.muscles), rtol=0, atol=OPENSIM_TOLERANCE
    )
    framewise = scso.solve_framewise(problem)
    for k in range(0, problem.motion.trajectory.n_frames, 5):
        expected = solve_qp_frame(problem, k)
        for found in (solution, framewise):
            np.testing.assert_allclose(unknowns(found, k), expected, rtol=0, atol=QP_TOLERANCE)


def assert_capacity_is_opensims(trajectory, muscles):
    """Compare every muscle in every frame; returns the classes that were there."""
    found = []
    for where, muscle in muscle_groups(muscles):
        columns = repeat_over_frames(muscle, trajectory.n_frames)
        length, velocity = (
            trajectory.muscle_tendon_length[:, where],
            trajectory.muscle_tendon_velocity[:, where],
        )
        capacity = on_arrays(
            lambda x, v, columns=columns: optimal_force(columns, x, v),
            length,
            velocity,
        )
        error = np.abs(capacity - trajectory.active_force_capacity[:, where])
        error /= muscles.max_isometric_force[where]
        found.append(muscle.curves.OPENSIM_CLASS)
        limit = np.full(error.shape, CAPACITY_TOLERANCE[found[-1]])
        if found[-1] == "Thelen2003Muscle":
            fastest = muscles.optimal_fiber_length[where] * muscles.max_contraction_velocity[where]
            limit[np.abs(velocity) < THELEN_AT_REST * fastest] = 10 * THELEN_AT_REST
        assert (error < limit).all(), (found[-1], error.max())
    return found


@pytest.mark.parametrize("opensim_class", CLASSES)
@pytest.mark.parametrize("case", SETUPS)
def test_the_capacity_of_every_class_is_opensims_along_a_motion(case, opensim_class, shared_data, tmp_path):
    model = tmp_path / MODELS[case]
    model.write_text(as_class((shared_data / case / MODELS[case]).read_text(), opensim_class))
    motion = scso.load_motion(
        shared_data / case / SETUPS[case], model=model, step_interval=200 if case == "walking3d" else 5
    )
    assert assert_capacity_is_opensims(motion.trajectory, motion.muscles) == [opensim_class]


def test_the_capacity_of_a_model_of_two_classes_is_opensims(shared_data):
    """A lumbar spine with 146 Thelen and 20 Millard muscles."""
    folder = shared_data / "back_lifting"
    motion = scso.load_motion(
        model=folder / "lumbarModel_scaled.osim",
        coordinates=folder / "stoop15kg" / "ik.sto",
        step_interval=20,
    )
    classes = assert_capacity_is_opensims(motion.trajectory, motion.muscles)
    assert sorted(classes) == ["Millard2012EquilibriumMuscle", "Thelen2003Muscle"]


def test_curves_that_a_class_has_of_its_own_are_read_and_refused_where_they_are_not_modelled(
    shared_data, tmp_path
):
    """The gait model's Millard curves are functions that a RigidTendonMuscle takes for its own."""
    source = shared_data / "gait10dof18musc"
    text = (source / MODELS["gait10dof18musc"]).read_text()
    model = tmp_path / MODELS["gait10dof18musc"]
    setup = source / SETUPS["gait10dof18musc"]

    def muscles_of(opensim_class, text):
        model.write_text(text)
        motion = scso.load_motion(setup, model=model, step_interval=100)
        assert set(motion.muscles.muscle_class) == {opensim_class}
        return motion

    default = muscles_of("RigidTendonMuscle", as_class(text, "RigidTendonMuscle"))
    given = default.muscles.curve_parameters[0]
    assert (given["force_velocity_curve.x22"], given["force_velocity_curve.y22"]) == (0.05, 1.482014)
    muscle_groups(default.muscles)
    own = text.replace("Millard2012EquilibriumMuscle", "RigidTendonMuscle")
    motion = muscles_of("RigidTendonMuscle", own)
    problem = scso.static_optimization(motion, muscle_model=scso.RigidTendon(convention="physical"))
    with pytest.raises(
        scso.DataError, match=r"default splines only, and it has active_force_length_curve\.oth"
    ):
        scso.solve_trajectory(problem)
    # OpenSim's own capacity needs no curves of ours.
    assert scso.solve_trajectory(scso.static_optimization(motion)).is_solved.all()
    de_groote = as_class(text, "DeGrooteFregly2016Muscle").replace(
        "<max_isometric_force>",
        "<ignore_passive_fiber_force>true</ignore_passive_fiber_force><max_isometric_force>",
    )
    motion = muscles_of("DeGrooteFregly2016Muscle", de_groote)
    assert motion.muscles.curve_parameters[0]["ignore_passive_fiber_force"] == 1.0
