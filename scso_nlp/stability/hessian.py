r"""The Hessian of the potential energy over chosen coordinates, and what can be read from it.

.. math:: H = \sum_m \left(F_m C_m + k_m r_m r_m^T\right) + K_{passive} - \partial\tau_{ext}/\partial q
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scso_nlp.exceptions import ProblemError
from scso_nlp.stability.rows import StabilityRows
from scso_nlp.trajectory import CoordinateCurvature, MotionTrajectory
from scso_nlp.validation import FloatArray, IntArray, positions

#: Coordinates whose share of a turn is below this are not named [-].
_LEAST_SHARE = 0.15


@dataclass(frozen=True, kw_only=True)
class HessianTerms:
    """What the Hessian is made of, for coordinates chosen by name.

    Attributes
    ----------
    coordinates : tuple of str
    curvature : ndarray, shape (n_frames, n, n, n_muscles) [m]
    moment_arms : ndarray, shape (n_frames, n, n_muscles) [m]
    constant : ndarray, shape (n_frames, n, n) [N·m/rad]
        Loads, the model's own passive elements if asked for, and passive stiffness given.
    loads : ndarray, shape (n_frames, n, n) [N·m/rad]
        The loads' part of it, as it stands there: negative where they take away.
    path_length : ndarray, shape (n_frames, n_muscles) [m]
    """

    coordinates: tuple[str, ...]
    curvature: FloatArray
    moment_arms: FloatArray
    constant: FloatArray
    loads: FloatArray
    path_length: FloatArray

    def rows_of_coordinates(self, muscles: tuple[str, ...]) -> StabilityRows:
        """Make a stability row of each coordinate; what is constant stands as (negative) external work.

        Parameters
        ----------
        muscles : tuple of str

        Returns
        -------
        StabilityRows
        """
        each = np.arange(len(self.coordinates))
        return StabilityRows(
            rows=self.coordinates,
            muscles=muscles,
            curvature=self.curvature[:, each, each],
            moment_arms=self.moment_arms,
            path_length=self.path_length,
            external_work=-self.constant[:, each, each],
        )

    def triangles(self) -> tuple[FloatArray, FloatArray]:
        """Give the Hessian as a weighted sum of matrices, lower triangles column by column.

        Returns
        -------
        matrices : ndarray, shape (n_frames, n (n + 1) / 2, 2 n_muscles)
            What each newton of tendon force [m], then each N/m of stiffness [m²] adds.
        constant : ndarray, shape (n_frames, n (n + 1) / 2) [N·m/rad]
        """
        column, row = np.triu_indices(len(self.coordinates))
        n_frames, _, n_muscles = self.moment_arms.shape
        matrices = np.empty((n_frames, row.size, 2 * n_muscles))
        for entry, (i, j) in enumerate(zip(row, column, strict=True)):
            matrices[:, entry, :n_muscles] = self.curvature[:, i, j]
            matrices[:, entry, n_muscles:] = self.moment_arms[:, i] * self.moment_arms[:, j]
        return matrices, self.constant[:, row, column]

    def hessian(self, tendon_force: FloatArray, stiffness: FloatArray) -> FloatArray:
        """Put the Hessian together.

        Parameters
        ----------
        tendon_force : ndarray, shape (n_frames, n_muscles) [N]
        stiffness : ndarray, shape (n_frames, n_muscles) [N/m]

        Returns
        -------
        ndarray, shape (n_frames, n, n) [N·m/rad]
        """
        geometric = np.einsum("kijm,km->kij", self.curvature, tendon_force, optimize=True)
        arms = self.moment_arms
        return geometric + (arms * stiffness[:, None, :]) @ arms.transpose(0, 2, 1) + self.constant


def hessian_terms(
    trajectory: MotionTrajectory,
    coordinates: tuple[str, ...] | None = None,
    *,
    model_passive: float = 1.0,
    passive_stiffness: FloatArray | None = None,
) -> HessianTerms:
    """Collect what the Hessian is made of.

    Parameters
    ----------
    trajectory : MotionTrajectory
        With `curvature` extracted.
    coordinates : tuple of str or None
        None: all those of the extracted curvature.
    model_passive : float [-]
        How much of the model's own springs, bushings, limit forces and ligaments counts.
    passive_stiffness : ndarray, shape (n, n) or (n_frames, n, n), optional [N·m/rad]
        Further passive stiffness.

    Returns
    -------
    HessianTerms

    Raises
    ------
    ProblemError
        The trajectory has no curvature.
    NameMismatchError
        A coordinate without curvature.
    """
    curvature = require_curvature(trajectory)
    names = curvature.coordinates if coordinates is None else tuple(coordinates)
    chosen = positions("coordinate with curvature", names, curvature.coordinates)
    both: tuple[slice | IntArray, ...] = np.ix_(np.arange(trajectory.n_frames), chosen, chosen)
    if names == curvature.coordinates:
        both = (slice(None),)  # no copy
    constant = loads = curvature.load_stiffness[both]
    if model_passive:
        constant = constant + model_passive * curvature.passive_stiffness[both]
    if passive_stiffness is not None:
        constant = constant + passive_stiffness
    return HessianTerms(
        coordinates=names,
        curvature=curvature.path_curvature[both],
        moment_arms=trajectory.moment_arms[:, positions("coordinate", names, trajectory.coordinates)],
        constant=constant,
        loads=loads,
        path_length=trajectory.muscle_tendon_length,
    )


def require_curvature(trajectory: MotionTrajectory) -> CoordinateCurvature:
    """Return the trajectory's curvature, or raise :class:`ProblemError` with the remedy."""
    if trajectory.curvature is None:
        raise ProblemError(
            f"the motion {trajectory.name!r} was loaded without path curvature, which stability over "
            "coordinates needs; load it with the constraint in prepare_for"
        )
    return trajectory.curvature


def chosen_coordinates(trajectory: MotionTrajectory, chosen: Sequence[str] | None) -> tuple[str, ...]:
    """Name the coordinates chosen, all those with curvature for None; see :func:`require_curvature`."""
    return require_curvature(trajectory).coordinates if chosen is None else tuple(chosen)


def curvature_notes(trajectory: MotionTrajectory) -> tuple[str, ...]:
    """Say over which coordinates curvature is known, and in how many frames it is doubtful, by muscle."""
    curvature = require_curvature(trajectory)
    notes = [f"stability over the coordinates {', '.join(curvature.coordinates)}"]
    frames = curvature.is_uncertain.any(axis=1)
    if frames.any():
        muscles = np.flatnonzero(curvature.is_uncertain.any(axis=0))
        names = ", ".join(trajectory.muscles[m] for m in muscles)
        notes.append(f"path curvature is uncertain in {frames.sum()} frames, where paths change: {names}")
    return tuple(notes)


def smallest_eigenvalues(hessian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the smallest eigenvalue of every frame and its mode.

    Parameters
    ----------
    hessian : ndarray, shape (n_frames, n, n) [N·m/rad]

    Returns
    -------
    value : ndarray, shape (n_frames,) [N·m/rad]
        Negative: some small combined turn is not pushed back.
    mode : ndarray, shape (n_frames, n) [-]
        That turn, of unit length, its largest entry positive.
    """
    values, vectors = np.linalg.eigh(hessian)
    mode = vectors[:, :, 0]
    largest = np.take_along_axis(mode, np.abs(mode).argmax(axis=1)[:, None], axis=1)
    return values[:, 0], mode * np.sign(largest)


def describe_turn(coordinates: tuple[str, ...], mode: FloatArray) -> str:
    """Say a turn in words: its larger shares by coordinate, largest first.

    Parameters
    ----------
    coordinates : tuple of str
    mode : ndarray, shape (n_coordinates,) [-]
        Of unit length.

    Returns
    -------
    str
        E.g. ``"0.92 lumbar_flexion - 0.38 lumbar_twist"``.
    """
    text = ""
    for i in np.argsort(-np.abs(mode)):
        if abs(mode[i]) < _LEAST_SHARE:
            break
        sign = " - " if mode[i] < 0 else " + "
        text += f"{sign if text else sign.strip().replace('+', '')}{abs(mode[i]):.2f} {coordinates[i]}"
    return text
