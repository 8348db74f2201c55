r"""What weights and external loads take away from the stability of a joint.

A force f of constant direction at a point C (from the joint center) of the side that turns has the
potential :math:`V = -f \cdot C`. Turning by θ about the unit axis u moves C so that
:math:`C'' = u \times (u \times C) = u (u \cdot C) - C`, hence

.. math:: EW_u = -\frac{\partial^2 V}{\partial\theta^2} = -\left(f \cdot C - (f \cdot u)(C \cdot u)\right).

A free torque T of constant direction does the work :math:`T \cdot u\, d\theta`. The axis u stays where
it is in a turn about u itself, so this generalized force does not change and T has no share in EW.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from scso_nlp.stability.rows import select_rows
from scso_nlp.trajectory import Skeleton
from scso_nlp.validation import FloatArray


def external_work(
    skeleton: Skeleton, joints: Iterable[str] | None = None, axes: Iterable[str] | None = None
) -> FloatArray:
    r"""External work about joint axes, from all weights and loads distal of each joint.

    .. math:: EW_u = -\sum_i \left(f_i \cdot C_i - (f_i \cdot u)(C_i \cdot u)\right)

    Parameters
    ----------
    skeleton : Skeleton
    joints, axes : iterable of str, or None
        As for :func:`scso_nlp.stability.select_rows`.

    Returns
    -------
    ndarray, shape (n_frames, n_rows) [N·m/rad]
        Rows as in :func:`scso_nlp.stability.select_rows`. A weight m g at height h above the joint
        gives m g h about each horizontal axis and nothing about the vertical.

    Raises
    ------
    NameMismatchError
        A joint or an axis is not there.

    Notes
    -----
    Distal is the side that does not hold ground. A load is taken as a force of constant direction
    that moves with its body; free torques contribute nothing (module docstring).

    References
    ----------
    Akhavanfar et al. (2019), J Biomech, doi 10.1016/j.jbiomech.2019.05.007, equation (4), where the
    axes are aligned with the vertical; here any unit axis and any force.
    """
    rows, joint_of_row, axis_of_row = select_rows(skeleton, joints, axes)
    n_frames = skeleton.joint_centers.shape[0]
    weights = np.broadcast_to(
        skeleton.body_masses[:, None] * skeleton.gravity, (n_frames, len(skeleton.bodies), 3)
    )
    forces = np.concatenate((weights, skeleton.load_forces), axis=1)
    points = np.concatenate((skeleton.body_mass_centers, skeleton.load_points), axis=1)
    bodies = np.concatenate((np.arange(len(skeleton.bodies)), skeleton.load_bodies))
    result = np.zeros((n_frames, len(rows)))
    for row, (joint, axis) in enumerate(zip(joint_of_row, axis_of_row, strict=True)):
        turns = skeleton.distal_bodies(joint)[bodies]
        u = skeleton.joint_axes[:, joint, axis]
        arms = points[:, turns] - skeleton.joint_centers[:, None, joint]
        f = forces[:, turns]
        along = np.einsum("kpi,ki->kp", f, u) * np.einsum("kpi,ki->kp", arms, u)
        result[:, row] = -(np.einsum("kpi,kpi->k", f, arms) - along.sum(axis=1))
    return result
