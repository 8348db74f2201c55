"""The embedded examples: complete, reproducible, and what OpenSim makes of them.

OpenSim's numbers come from `opensim_numbers.py`, in its own process; the optima from DAQP. Nothing of the
package's own stability rows or solvers is used here. The published facts were targets when the spine was
reconstructed, so these tests say that the files carry the reconstruction, not that it is right.
"""

import json
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import daqp
import numpy as np
import pytest

from scso_nlp.examples import example_folder, example_names
from scso_nlp.exceptions import NameMismatchError

PROJECT_ROOT = Path(__file__).resolve().parents[2]
SCRIPT = Path(__file__).with_name("opensim_numbers.py")
GRAVITY = 9.81
NAMES = ("elbow", "spine-load-height", "spine-postures")


@pytest.fixture(scope="module")
def opensim_says(tmp_path_factory):
    """Run OpenSim on an example once and keep its numbers."""
    known = {}

    def ask(name):
        if name not in known:
            folder = tmp_path_factory.mktemp(name)
            output = folder / f"{name}.npz"
            command = [sys.executable, str(SCRIPT), str(example_folder(name)), str(output)]
            run = subprocess.run(
                command, capture_output=True, text=True, timeout=300, cwd=folder, check=False
            )
            assert run.returncode == 0, run.stdout + run.stderr
            known[name] = SimpleNamespace(**np.load(output))
        return known[name]

    return ask


def optimum(found, frame, q=None):
    """Least sum of squared activations; q=None leaves the stability rows out. None if infeasible."""
    strength, arms = found.max_isometric_force, found.moment_arms[frame]
    n_muscles, moments = len(strength), found.moments[frame]
    rows, lower, upper = [arms * strength], [moments], [moments]
    equality = [5] * len(moments)
    if q is not None:
        gs = found.curvature[frame] + q * arms**2 / found.length[frame]
        rows.append(gs * strength)
        lower.append(found.external_work[frame])
        upper.append(np.full(len(moments), 1e30))
        equality += [0] * len(moments)
    activation, _, flag, _ = daqp.solve(
        2 * np.eye(n_muscles),
        np.zeros(n_muscles),
        np.ascontiguousarray(np.vstack(rows)),
        np.concatenate((np.ones(n_muscles), *upper)),
        np.concatenate((np.zeros(n_muscles), *lower)),
        np.array([0] * n_muscles + equality, dtype=np.int32),
        primal_tol=1e-9,
    )
    return activation if flag == 1 else None


def percent(found, activations, *groups):
    """Mean activation [%] of muscle groups such as RA or EO_R; one number per frame."""
    pick = [i for i, name in enumerate(found.muscles) if name.startswith(groups)]
    return 100 * np.array([np.nan if a is None else a[pick].mean() for a in activations])


def all_frames(found, q=None):
    return [optimum(found, frame, q) for frame in range(len(found.time))]


def critical_q(found, frame):
    """Smallest q for which the plain optimum meets every stability row."""
    force = optimum(found, frame) * found.max_isometric_force
    softness = found.external_work[frame] - found.curvature[frame] @ force
    return (softness / ((found.moment_arms[frame] ** 2 / found.length[frame]) @ force)).max()


# --- the files ---------------------------------------------------------------------------------------


def test_the_three_examples_are_there_with_all_that_their_setup_names():
    assert example_names() == NAMES
    for name in NAMES:
        folder = example_folder(name)
        assert (folder / "README.md").is_file()
        assert (folder / "motion.mot").is_file()


def test_a_misspelt_example_is_refused_with_a_suggestion():
    with pytest.raises(NameMismatchError, match="closest: spine-postures"):
        example_folder("spine-posture")


def test_the_files_are_what_the_generator_writes(tmp_path):
    generator = runpy.run_path(str(PROJECT_ROOT / "problems" / "make_examples.py"))
    home = example_folder("elbow").parent
    reconstruction = json.loads((home / "spine_reconstruction.json").read_text(encoding="utf-8"))
    generator["write_examples"](tmp_path, reconstruction)
    written = sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*") if p.is_file())
    assert len(written) == 14
    for path in written:
        assert (home / path).read_bytes() == (tmp_path / path).read_bytes(), path


# --- what OpenSim makes of them ----------------------------------------------------------------------


@pytest.mark.opensim
@pytest.mark.parametrize("name", NAMES)
def test_opensim_runs_the_setup_without_a_warning_and_finds_the_same_optimum(name, opensim_says):
    found = opensim_says(name)
    assert found.warnings.tolist() == []
    assert set(found.motion_types.tolist()) == {1}  # rotational: angles in degrees are converted
    assert not found.min_control.any()
    np.testing.assert_array_equal(found.tool_time, found.time)
    # At rest: the speeds that OpenSim differentiates to accelerations. The spline through a constant
    # 90 degrees leaves round-off; zeros of a file stay zeros.
    assert found.tool_speeds.shape == (len(found.time), len(found.names))
    np.testing.assert_allclose(found.tool_speeds, 0.0, atol=1e-14 if name == "elbow" else 0.0)
    # Its forces hold the static moments, so it saw no acceleration.
    force = found.static_optimization * found.max_isometric_force
    np.testing.assert_allclose(np.einsum("krm,km->kr", found.moment_arms, force), found.moments, atol=1e-8)
    # OpenSim's optimizer stops early, at up to 0.01 from the exact optimum.
    exact = np.array(all_frames(found))
    np.testing.assert_allclose(found.static_optimization, exact, atol=0.01)


@pytest.mark.opensim
def test_the_elbow_has_the_arms_and_moments_its_readme_states(opensim_says):
    found = opensim_says("elbow")
    np.testing.assert_allclose(found.moment_arms, np.tile([0.1, 0.05, 0.02], (7, 1, 1)), rtol=1e-14)
    np.testing.assert_allclose(found.moments[:, 0], [30, 60, 90, 120, 150, 180, 200], rtol=1e-14)
    np.testing.assert_allclose(optimum(found, 1), [0.347652, 0.143856, 0.047952], atol=5e-7)
    np.testing.assert_allclose(optimum(found, 6), [1.0, 0.825, 0.275], atol=1e-9)
    assert [a[0] == pytest.approx(1.0) for a in all_frames(found)] == [False] * 5 + [True] * 2


@pytest.mark.opensim
def test_opensim_reads_the_exact_load_of_every_frame(opensim_says):
    found = opensim_says("spine-load-height")
    weights = GRAVITY * np.repeat([4.5, 9.0], 5)
    heights = np.tile([0.0, 0.2, 0.4, 0.6, 0.8], 2)
    zero = np.zeros(10)
    expected = np.stack((zero, -weights, zero, np.full(10, 0.3), heights, zero), axis=1)
    np.testing.assert_allclose(found.loads, expected, atol=1e-12)


@pytest.mark.opensim
def test_moments_and_external_work_of_the_held_load_are_the_analytic_ones(opensim_says):
    found = opensim_says("spine-load-height")
    load = GRAVITY * np.repeat([4.5, 9.0], 5)
    heights = np.tile([0.0, 0.2, 0.4, 0.6, 0.8], 2)
    # Flexion counts forward, so what holds the load up is negative; the trunk stands over the joint.
    expected = np.zeros((10, 6))
    expected[:, [0, 3]] = (-load * 0.30)[:, None]
    np.testing.assert_allclose(found.moments, expected, atol=1e-11)
    lower = 52 * GRAVITY * 0.2 + load * heights
    upper = 52 * GRAVITY * 0.015 + load * (heights - 0.185)
    zero = np.zeros(10)
    work = np.stack((lower, lower, zero, upper, upper, zero), axis=1)
    # Second differences of 1e2 J at 2e-3 rad.
    np.testing.assert_allclose(found.external_work, work, atol=1e-6)


@pytest.mark.opensim
def test_moments_of_the_postures_are_the_analytic_ones(opensim_says):
    found = opensim_says("spine-postures")
    flexion = np.deg2rad(np.tile([0, 15, 30, 45], 2))
    twist = np.deg2rad(np.repeat([0, 10], 4))
    # The flexed thorax: its center of mass, 42 kg at (.017, .05), goes forward; all that turns with the lower
    # joint's twist, whose axis stays vertical, and moves the weights out of the sagittal plane.
    forward = 0.017 * np.cos(flexion) + 0.05 * np.sin(flexion)
    upper = -42 * GRAVITY * forward
    lower_arm = 42 * GRAVITY * forward + 10 * GRAVITY * 0.03
    zero = np.zeros(8)
    expected = np.stack(
        (-lower_arm * np.cos(twist), lower_arm * np.sin(twist), zero, upper, zero, zero), axis=1
    )
    np.testing.assert_allclose(found.moments, expected, atol=1e-11)


#: Published signs of moment arms: extension, and abduction to the right, counted positive.
SIGNS = {"ES1": (1, 1), "RA": (-1, -1), "EO": (-1, -1), "IO": (1, -1)}


@pytest.mark.opensim
@pytest.mark.parametrize("name", ["spine-load-height", "spine-postures"])
def test_moment_arms_have_the_published_signs_in_every_frame(name, opensim_says):
    found = opensim_says(name)
    rows = found.names.tolist()
    muscles = found.muscles.tolist()
    lower, upper = rows.index("lumbar_pelvis_flexion"), rows.index("thorax_lumbar_flexion")
    for group, (at_lower, at_upper) in SIGNS.items():
        for side in "RL":
            arms = found.moment_arms[:, :, muscles.index(f"{group}_{side}")]
            assert (np.sign(-arms[:, lower]) == at_lower).all(), (group, side)
            assert (np.sign(-arms[:, upper]) == at_upper).all(), (group, side)
    abduction = found.moment_arms[:, rows.index("lumbar_pelvis_abduction_right")]
    for index, muscle in enumerate(muscles):
        if not muscle.startswith("ES3"):  # from lumbar to thorax, it does not cross the lower joint
            assert (np.sign(abduction[:, index]) == (1 if muscle.endswith("R") else -1)).all(), muscle


# --- the facts of the reconstruction -----------------------------------------------------------------


@pytest.mark.opensim
def test_plain_optimum_is_constant_over_load_height_with_silent_rectus_and_external_oblique(opensim_says):
    found = opensim_says("spine-load-height")
    plain = all_frames(found)
    np.testing.assert_allclose(percent(found, plain, "RA", "EO"), 0.0, atol=1e-9)
    np.testing.assert_allclose(percent(found, plain, "IO"), np.repeat([1.11, 2.22], 5), atol=0.005)
    np.testing.assert_allclose(plain[:5], np.tile(plain[0], (5, 1)), atol=1e-9)
    np.testing.assert_allclose(plain[5:], np.tile(plain[5], (5, 1)), atol=1e-9)


@pytest.mark.opensim
def test_activations_with_stability_rise_linearly_with_load_height(opensim_says):
    found = opensim_says("spine-load-height")
    stable = all_frames(found, q=5.0)
    abdominal, back = percent(found, stable, "RA", "EO", "IO"), percent(found, stable, "ES")
    np.testing.assert_allclose(abdominal[[0, 4, 5, 9]], [1.99, 3.88, 0.74, 2.72], atol=0.005)
    np.testing.assert_allclose(back[[0, 4, 5, 9]], [12.2, 15.9, 15.9, 21.4], atol=0.05)
    # Straight lines with 4.5 kg: the same rows bind at every height.
    for values in (abdominal[:5], back[:5]):
        steps = np.diff(values)
        assert (steps > 0.4).all()
        np.testing.assert_allclose(steps, steps.mean(), atol=0.002)
    assert (np.diff(abdominal[5:]) > 0.4).all()
    assert (np.diff(back[5:]) > 1.0).all()


@pytest.mark.opensim
def test_stability_costs_nothing_above_the_critical_q(opensim_says):
    found = opensim_says("spine-load-height")
    assert critical_q(found, 4) == pytest.approx(12.971, abs=5e-4)
    assert critical_q(found, 5) == pytest.approx(4.49, abs=5e-3)
    assert max(critical_q(found, frame) for frame in range(10)) == critical_q(found, 4)
    plain = all_frames(found)
    np.testing.assert_allclose(all_frames(found, q=13.0), plain, atol=1e-9)
    assert np.abs(optimum(found, 4, 12.9) - plain[4]).max() > 1e-5
    np.testing.assert_allclose(optimum(found, 5, 5.0), plain[5], atol=1e-9)


@pytest.mark.opensim
def test_symmetric_postures_co_contract_more_at_q_3_than_at_q_5(opensim_says):
    found = opensim_says("spine-postures")
    plain, stiff, soft = (all_frames(found, q)[:4] for q in (None, 5.0, 3.0))
    mean = {
        group: [percent(found, each, group).mean() for each in (plain, stiff, soft)]
        for group in ("RA", "EO", "ES")
    }
    np.testing.assert_allclose(mean["EO"], [0.0, 4.35, 9.81], atol=0.005)
    np.testing.assert_allclose(mean["RA"], [0.0, 0.51, 4.21], atol=0.005)
    np.testing.assert_allclose(np.diff(mean["ES"])[0], 3.7, atol=0.05)
    np.testing.assert_allclose(mean["ES"][2] - mean["ES"][0], 10.3, atol=0.05)


@pytest.mark.opensim
def test_twisted_postures_use_the_right_external_oblique_and_not_the_left(opensim_says):
    found = opensim_says("spine-postures")
    for q in (5.0, 3.0):
        stable = all_frames(found, q)[4:]
        np.testing.assert_allclose(percent(found, stable, "EO_L"), 0.0, atol=1e-9)
        assert (percent(found, stable, "EO_R") > 5.0).all()


@pytest.mark.opensim
def test_every_task_is_feasible_without_reserves_down_to_q_1_5_and_five_fail_at_q_1(opensim_says):
    both = [opensim_says(name) for name in ("spine-load-height", "spine-postures")]
    for q in (None, 5.0, 3.0, 1.5):
        assert all(answer is not None for found in both for answer in all_frames(found, q)), q
    assert sum(answer is None for found in both for answer in all_frames(found, 1.0)) == 5


@pytest.mark.opensim
@pytest.mark.parametrize("name", ["spine-load-height", "spine-postures"])
def test_the_full_hessian_has_a_negative_eigenvalue_in_every_frame(name, opensim_says):
    found = opensim_says(name)
    for q in (5.0, 3.0):
        for frame, activation in enumerate(all_frames(found, q)):
            force, arms = activation * found.max_isometric_force, found.moment_arms[frame]
            stiffness = q * force / found.length[frame]
            hessian = found.length_hessian[frame] @ force + (arms * stiffness) @ arms.T
            hessian += found.energy_hessian[frame]
            # Its diagonal is the rows (four-point differences are good to 1e-5), so the rule holds ...
            assert np.diag(hessian).min() > -0.01
            # ... and still the posture is unstable in some combined turn.
            assert np.linalg.eigvalsh(hessian)[0] < -1.0
