"""What spreads of a problem's numbers make of an optimum, to first order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.display import without_arrays
from scso_nlp.exceptions import DataError
from scso_nlp.sensitivities.sensitivity import Sensitivity
from scso_nlp.solution import Solution
from scso_nlp.validation import FloatArray

#: Eigenvalues of a covariance below minus this much of the largest are no rounding [-].
_ROUNDING = 1e-12
#: Most parameters that are named.
_MOST_SHOWN = 4


@dataclass(frozen=True, kw_only=True)
@checked
class Bands:
    """How far an optimum spreads about itself; NaN in frames without derivatives.

    Attributes
    ----------
    solution : Solution
    parameters : tuple of str
        What spreads.
    meaning : str
        What half a width is: a standard deviation, or the most within ranges.
    activation : ndarray, shape (n_frames, n_muscles) [-]
        Half widths, not cut at the bounds.
    tendon_force : ndarray, shape (n_frames, n_muscles) [N]
    control : ndarray, shape (n_frames, n_actuators) [-]
    row_value : mapping of str to ndarray, shape (n_frames, n_rows)
        By constraint name, in the unit of the rows.
    """

    solution: Solution
    parameters: tuple[str, ...]
    meaning: str
    activation: FloatArray
    tendon_force: FloatArray
    control: FloatArray
    row_value: Mapping[str, FloatArray]

    __repr__ = without_arrays

    @property
    def spreads(self) -> str:
        """What spreads, of many parameters the first ones."""
        more = len(self.parameters) - _MOST_SHOWN
        shown = ", ".join(self.parameters[:_MOST_SHOWN])
        return f"{shown} and {more} more" if more > 0 else shown


@checked
def bands(
    change: Sensitivity, *, covariance: FloatArray | None = None, ranges: FloatArray | None = None
) -> Bands:
    r"""Turn spreads of parameters into first-order bands about an optimum.

    .. math:: \sigma_y = \sqrt{s^T \Sigma\, s} \quad\text{or}\quad w_y = \sum_i |s_i|\, w_i

    with the derivatives s of y by the parameters, their covariance :math:`\Sigma` or their ranges w.

    Parameters
    ----------
    change : Sensitivity
        By the parameters that spread.
    covariance : ndarray, shape (n_parameters, n_parameters) or (n_parameters,)
        Covariance of the parameters, or variances of independent ones; in squares of their units.
    ranges : ndarray, shape (n_parameters,)
        By how much each may be off to either side: bands are the most that all together do.

    Returns
    -------
    Bands

    Raises
    ------
    DataError
        Both or neither given; another shape; a matrix that is no covariance; a negative range.

    Notes
    -----
    A first-order band holds as long as the same bounds and rows stay active over most of the spread. The
    optimum itself is the middle.

    Examples
    --------
    >>> change = scso.sensitivity(solution, ["generalized_forces", "q"])
    >>> spread = scso.bands(change, covariance=[2.0**2, 1.0])
    >>> spread.activation[1].round(3)
    array([0.012, 0.005, 0.002])
    """
    n = len(change.parameters)
    if (covariance is None) == (ranges is None):
        raise DataError("bands take a covariance or ranges, one of the two")
    if ranges is not None:
        width = np.asarray(ranges, dtype=float)
        if width.shape != (n,) or not (width >= 0).all() or not np.isfinite(width).all():
            raise DataError(f"ranges have shape {width.shape}, expected ({n},) numbers of at least 0")
        meaning, root = "most within the ranges of the parameters", np.diag(width)
    else:
        meaning, root = "one standard deviation", _root(np.asarray(covariance, dtype=float), n)

    def half(values: FloatArray) -> FloatArray:
        each = np.einsum("kpm,pi->kim", values, root)
        found = np.abs(each).sum(axis=1) if ranges is not None else np.sqrt((each**2).sum(axis=1))
        return np.asarray(found)

    return Bands(
        solution=change.solution,
        parameters=change.names,
        meaning=meaning,
        activation=half(change.activation),
        tendon_force=half(change.tendon_force),
        control=half(change.control),
        row_value={name: half(values) for name, values in change.row_value.items()},
    )


def _root(covariance: FloatArray, n: int) -> FloatArray:
    """Matrix R with R R' = covariance, shape (n, n)."""
    matrix = np.diag(covariance) if covariance.ndim == 1 else covariance
    if matrix.shape != (n, n) or not np.isfinite(matrix).all():
        raise DataError(
            f"covariance has shape {covariance.shape}, expected ({n}, {n}) or ({n},) finite numbers"
        )
    value, vector = np.linalg.eigh(0.5 * (matrix + matrix.T))
    largest = np.abs(value).max(initial=0.0)
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0) or (value < -_ROUNDING * largest).any():
        raise DataError("covariance must be symmetric and positive semi-definite")
    return np.asarray(vector * np.sqrt(np.maximum(value, 0.0)))
