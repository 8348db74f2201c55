"""Stability rows against second differences of OpenSim's own path lengths, weights and loads."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from scso_nlp.stability import geometric_stability, potvin_brown
from scso_nlp.trajectory import Skeleton

SCRIPT = Path(__file__).with_name("opensim_random_model.py")


@pytest.mark.opensim
@pytest.mark.parametrize("seed", [1, 2])
def test_random_opensim_models_agree_with_second_differences_of_opensim(seed, tmp_path, turning):
    output = tmp_path / "random.npz"
    command = [sys.executable, str(SCRIPT), str(seed), str(output)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=tmp_path, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    found = np.load(output)
    n_frames, n_muscles, n_points, _ = found["points"].shape
    repeat = (n_frames, *(1,) * 2)
    skeleton = Skeleton(
        bodies=("ground", *(f"body{i}" for i in range(1, 6))),
        body_parents=found["parents"],
        body_masses=found["masses"],
        body_mass_centers=found["mass_centers"],
        gravity=found["gravity"],
        joints=tuple(f"joint{i}" for i in range(1, 6)),
        joint_children=np.arange(1, 6),
        joint_centers=found["centers"],
        joint_axes=found["axes"],
        load_names=("load0", "load1", "load2"),
        load_bodies=found["load_bodies"],
        load_forces=np.tile(found["load_forces"], repeat),
        load_points=found["load_points"],
        load_torques=np.tile(found["load_torques"], repeat),
        path_points=found["points"],
        path_point_bodies=np.tile(found["path_bodies"], repeat),
        path_point_moves=np.zeros((n_frames, n_muscles, n_points), dtype=bool),
    )
    trajectory = turning.trajectory_of(skeleton)
    np.testing.assert_allclose(trajectory.muscle_tendon_length, found["length"], rtol=1e-12)
    rows = potvin_brown(trajectory)
    pick = [rows.rows.index(row) for row in found["rows"]]
    arms, curvature = rows.moment_arms[:, pick], rows.curvature[:, pick]

    # The same definition as OpenSim's computeMomentArm, so round-off only.
    np.testing.assert_allclose(arms, found["moment_arms"], atol=1e-12)
    # Second differences of lengths near 1 m are good to 1e-16 / (2e-3)² and their truncation to 1e-9.
    np.testing.assert_allclose(arms, -found["length_slope"], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(curvature, found["curvature"], rtol=1e-5, atol=1e-8)
    expected = found["curvature"] + 5.0 * found["length_slope"] ** 2 / found["length"][:, None]
    np.testing.assert_allclose(geometric_stability(rows, 5.0)[:, pick], expected, rtol=1e-5, atol=1e-8)

    # V'' = -EW for weights and loads; the free torques are no part of that energy.
    work = rows.external_work[:, pick]
    np.testing.assert_allclose(work, -found["energy_curvature"], rtol=1e-5, atol=1e-6)
    # Holding moments of OpenSim's inverse dynamics at rest, free torques included: dM_i/dq_i = -EW_i.
    np.testing.assert_allclose(work, -found["moment_slope"], rtol=1e-5, atol=1e-7)
    # A comparison of zeros would prove nothing.
    assert np.abs(found["moment_slope"]).max() > 10.0
    assert np.median(np.abs(curvature[curvature != 0])) > 0.05
