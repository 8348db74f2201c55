"""Units that OpenSim believes: lengths and moments that are only plausible in millimetres."""

from __future__ import annotations

import numpy as np

from scso_nlp.opensim.setup_xml import MotionInput
from scso_nlp.trajectory import MotionTrajectory, Skeleton
from scso_nlp.validation import FloatArray

#: A base that shifts by more than so many sizes of the model is reported [-]: a kilometre on foot ...
FAR_AWAY = 1000.0
#: ... or by more than this, if it does not go anywhere: its whole way is less than half of that.
FAR_AND_STILL = 100.0
#: A load that acts more than so many sizes of the model away from its body is reported [-].
FAR_FROM_BODY = 10.0
#: Points of a load count where its force is more than this share of its peak [-].
ACTS = 0.01


def notes_on_units(motion: MotionInput, trajectory: MotionTrajectory, size: float) -> list[str]:
    """Say what looks as if its unit were wrong.

    Parameters
    ----------
    motion : MotionInput
        For the names of its files.
    trajectory : MotionTrajectory
    size : float [m]
        Of the model: the largest distance within it.

    Returns
    -------
    list of str
        One sentence each; with true units none.
    """
    if size <= 0:
        return []
    notes = _on_translations(motion, trajectory, size)
    if trajectory.skeleton is not None and motion.external_loads is not None:
        notes += _on_loads(motion, trajectory.skeleton, size)
    return notes


def _on_translations(motion: MotionInput, trajectory: MotionTrajectory, size: float) -> list[str]:
    values = trajectory.coordinate_values[:, ~trajectory.is_rotational]
    names = [
        n for n, angle in zip(trajectory.coordinates, trajectory.is_rotational, strict=True) if not angle
    ]
    far, way = np.abs(values).max(axis=0), np.ptp(values, axis=0)
    is_odd = (far > FAR_AWAY * size) | ((far > FAR_AND_STILL * size) & (way < far / 2))
    return [
        f"{motion.motion}: {name} is up to {reach:.4g} m, {reach / size:.3g} times the size of the model "
        f"({size:.3g} m): is it in millimetres? OpenSim reads metres; divide its column by 1000"
        for name, reach, odd in zip(names, far, is_odd, strict=True)
        if odd
    ]


def _on_loads(motion: MotionInput, skeleton: Skeleton, size: float) -> list[str]:
    notes = []
    weight = float(skeleton.body_masses.sum() * np.linalg.norm(skeleton.gravity))
    forces, torques = _lengths(skeleton.load_forces), _lengths(skeleton.load_torques)
    arms = _lengths(skeleton.load_points - skeleton.body_mass_centers[:, skeleton.load_bodies])
    for i, name in enumerate(skeleton.load_names):
        acts = forces[:, i] > ACTS * forces[:, i].max()
        arm = float(np.median(arms[acts, i])) if acts.any() else 0.0
        body = skeleton.bodies[skeleton.load_bodies[i]]
        if arm > FAR_FROM_BODY * size:
            notes.append(
                f"{motion.external_loads}: {name} acts {arm:.4g} m away from {body}, {arm / size:.3g} times "
                f"the size of the model ({size:.3g} m): are its points in millimetres, or in another frame? "
                "OpenSim reads metres; divide their columns by 1000"
            )
        torque, most = float(torques[:, i].max()), size * (weight + float(forces[:, i].max()))
        if torque > most:
            notes.append(
                f"{motion.external_loads}: the torque of {name} is up to {torque:.4g} N·m, more than its "
                f"force and the weight of the model have at an arm of the model's size ({most:.4g} N·m): is "
                "it in N·mm? OpenSim reads N·m; divide its columns by 1000"
            )
    return notes


def _lengths(vectors: FloatArray) -> FloatArray:
    """Lengths of vectors, shape (n_frames, n)."""
    lengths: FloatArray = np.linalg.norm(vectors, axis=2)
    return lengths
