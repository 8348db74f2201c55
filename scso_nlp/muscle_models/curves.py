"""What every muscle curve needs: evaluation on arrays, selection, and the checks of its parameters.

The curves themselves stand in one file per OpenSim class (contract: :class:`hill_muscle.HillCurves`). They
accept float, DM, SX and MX, elementwise; a parameter may be a number or a column with one entry per muscle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np

from scso_nlp.exceptions import DataError
from scso_nlp.validation import FloatArray, nearest

#: A number or a CasADi matrix: float, DM, SX or MX. (CasADi has no type stubs.)
Expression = Any

#: Shape parameters of one class by OpenSim property name; the values are numbers or columns.
CurveParameters = Mapping[str, Expression]

#: Properties of a muscle that have no part in its curves; they may stand among the curve parameters.
OTHER_PROPERTIES = (
    "default_activation",
    "ignore_tendon_compliance",
    "maximum_pennation_angle",
    "minimum_activation",
    "minimum_fiber_length",
)


def on_arrays(curve: Callable[..., Expression], *arrays: Any) -> FloatArray:
    """Evaluate a CasADi-compatible function on broadcast NumPy arrays.

    Parameters
    ----------
    curve : callable
        Takes as many columns as there are arrays, returns one column, elementwise.
    *arrays : array_like, shapes that broadcast [mixed]
        The arguments.

    Returns
    -------
    ndarray, the broadcast shape [unit of the curve]
        The values, in the order of the arguments.

    Notes
    -----
    The arguments are unrolled with the last axis running fastest, so arrays of shape
    (n_frames, n_muscles) meet the columns of :func:`hill_muscle.repeat_over_frames`.
    """
    broadcast = np.broadcast_arrays(*(np.asarray(a, dtype=float) for a in arrays))
    values = curve(*(ca.DM(a.ravel()) for a in broadcast))
    column = ca.DM(values).full()
    if column.size == 1 and broadcast[0].size != 1:
        column = np.broadcast_to(column, (broadcast[0].size, 1))
    return column.reshape(broadcast[0].shape)


def select(condition: Expression, if_true: Expression, if_false: Expression) -> Expression:
    """Choose elementwise, with no trace of the branch that is not taken (not even a NaN).

    Parameters
    ----------
    condition : bool or DM or SX or MX, any shape [-]
        The test.
    if_true, if_false : float or DM or SX or MX, any shape [any]
        The values.

    Returns
    -------
    DM or SX or MX, the broadcast shape [any]
        `if_true` where the condition holds, `if_false` elsewhere.
    """
    return ca.if_else(condition, if_true, if_false)


def complete_parameters(
    muscle: str, opensim_class: str, given: Mapping[str, float], defaults: Mapping[str, float]
) -> dict[str, float]:
    """Fill in OpenSim's defaults for the curve parameters that are not given.

    Parameters
    ----------
    muscle : str
        Name, for messages.
    opensim_class : str
        OpenSim's class, for messages.
    given : mapping of str to float [mixed]
        What the model has, by OpenSim property name.
    defaults : mapping of str to float [mixed]
        OpenSim's default of every parameter of the class.

    Returns
    -------
    dict of str to float [mixed]
        All parameters, in the order of `defaults`.

    Raises
    ------
    DataError
        An unknown name (the closest one is suggested) or a value that is not a finite number.
    """
    for name, value in given.items():
        if name in OTHER_PROPERTIES and name not in defaults:
            continue
        if name not in defaults:
            hint = nearest(name, defaults)
            raise DataError(f"muscle {muscle!r}: {opensim_class} has no curve parameter {name!r} ({hint})")
        if not np.isfinite(value):
            raise DataError(f"muscle {muscle!r}: {name} is {value}, expected a finite number")
    return {name: float(given.get(name, default)) for name, default in defaults.items()}


def require(muscle: str, parameters: Mapping[str, float], rules: Mapping[str, tuple[float, float]]) -> None:
    """Refuse the first parameter outside its open interval.

    Parameters
    ----------
    muscle : str
        Name, for the message.
    parameters : mapping of str to float [mixed]
        Values by OpenSim property name.
    rules : mapping of str to (float, float) [mixed]
        The lower and the upper end of the interval; neither end is allowed.

    Raises
    ------
    DataError
        One sentence with muscle, parameter, value and interval.
    """
    for name, (low, high) in rules.items():
        value = parameters[name]
        if not low < value < high:
            rule = f"greater than {low:g}" if np.isinf(high) else f"between {low:g} and {high:g}"
            raise DataError(f"muscle {muscle!r}: {name} is {value:g}, must be {rule}")
