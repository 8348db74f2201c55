"""Bands about a solution as a file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.io.storage import Storage, write_storage
from scso_nlp.sensitivities import Bands


@checked
def write_bands(bands: Bands, folder: str | os.PathLike[str]) -> tuple[Path, Path]:
    """Write bands of activations and of tendon forces, three columns for each muscle.

    Parameters
    ----------
    bands : Bands
    folder : str or path-like
        It must exist.

    Returns
    -------
    tuple of Path
        ``<name>_activation_bands.sto`` and ``<name>_force_bands.sto``: columns ``<muscle>``,
        ``<muscle>_low`` and ``<muscle>_high``; NaN in frames without derivatives.

    Raises
    ------
    DataError
        The folder cannot be written to.

    Examples
    --------
    >>> change = scso.sensitivity(solution, ["generalized_forces"])
    >>> paths = scso.write_bands(scso.bands(change, covariance=[4.0]), ".")
    >>> [path.name for path in paths]
    ['elbow_activation_bands.sto', 'elbow_force_bands.sto']
    """
    solution = bands.solution
    trajectory = solution.problem.motion.trajectory
    labels = [f"{name}{end}" for name in trajectory.muscles for end in ("", "_low", "_high")]
    paths = []
    for word, values, half in (
        ("activation", solution.activation, bands.activation),
        ("force", solution.tendon_force, bands.tendon_force),
    ):
        table = np.stack([values, values - half, values + half], axis=2).reshape(len(values), -1)
        storage = Storage(
            name=f"{trajectory.name} {word}: {bands.meaning} of {bands.spreads}",
            labels=tuple(labels),
            time=trajectory.time,
            values=table,
            in_degrees=False,
        )
        paths.append(Path(folder) / f"{trajectory.name}_{word}_bands.sto")
        write_storage(storage, paths[-1], allow_nonfinite=True)
    return paths[0], paths[1]
