"""Tables of a solution's quantities over time, and pandas' form of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from scso_nlp.exceptions import ScsoError
from scso_nlp.solution.rows import SMALLEST_EIGENVALUE, MatrixResult, MomentBalance, RowResult
from scso_nlp.validation import FloatArray

if TYPE_CHECKING:
    import pandas as pd


class Table(NamedTuple):
    """A quantity over time.

    Attributes
    ----------
    values : ndarray, shape (n_frames, n_columns)
    columns : tuple of str, or of tuple of str
        Names, of two levels where a name is a pair.
    units : tuple of str, one per column
    levels : tuple of str
        What the columns are, one word per level.
    """

    values: FloatArray
    columns: tuple[str, ...] | tuple[tuple[str, str], ...]
    units: tuple[str, ...]
    levels: tuple[str, ...]


def rows_table(rows: Mapping[str, RowResult], matrices: Mapping[str, MatrixResult]) -> Table | None:
    """Put the values of all rows side by side, and of matrices the smallest eigenvalues.

    Parameters
    ----------
    rows : mapping of str to RowResult
        By constraint.
    matrices : mapping of str to MatrixResult
        Likewise.

    Returns
    -------
    Table or None
        None where there are no rows at all.
    """
    columns = [(name, row) for name, result in rows.items() for row in result.names]
    units = [unit for result in rows.values() for unit in result.unit]
    values = [result.value for result in rows.values()]
    columns += [(name, SMALLEST_EIGENVALUE) for name in matrices]
    units += [matrix.unit for matrix in matrices.values()]
    values += [matrix.smallest_eigenvalue[:, None] for matrix in matrices.values()]
    if not values:
        return None
    return Table(np.hstack(values), tuple(columns), tuple(units), ("constraint", "row"))


def moments_table(balance: MomentBalance) -> Table:
    """Put required moments and those of muscles and actuators side by side, coordinate by coordinate.

    Parameters
    ----------
    balance : MomentBalance

    Returns
    -------
    Table
    """
    kinds = ("required", "muscles", "actuators")
    values = np.stack([getattr(balance, kind) for kind in kinds], axis=2)
    columns = tuple((coordinate, kind) for coordinate in balance.coordinates for kind in kinds)
    units = tuple(unit for unit in balance.unit for _ in kinds)
    return Table(values.reshape(len(values), -1), columns, units, ("coordinate", "moment"))


def pandas() -> Any:
    """Import pandas, or raise ScsoError with what to do."""
    try:
        import pandas as pd
    except ImportError:
        raise ScsoError(
            "tables need pandas, which is not installed: pip install 'scso_nlp[pandas]'; all arrays are "
            "attributes of the solution too"
        ) from None
    return pd


def data_frame(time: FloatArray, table: Table) -> pd.DataFrame:
    """Make a data frame of pandas, which is imported here.

    Parameters
    ----------
    time : ndarray, shape (n_frames,) [s]
        The index.
    table : Table

    Returns
    -------
    pandas.DataFrame
        Units by column in ``attrs["units"]``.

    Raises
    ------
    ScsoError
        pandas is not installed.
    """
    pd = pandas()
    if len(table.levels) > 1:
        columns = pd.MultiIndex.from_tuples(table.columns, names=table.levels)
    else:
        columns = pd.Index(table.columns, name=table.levels[0])
    frame = pd.DataFrame(table.values, index=pd.Index(time, name="time"), columns=columns)
    frame.attrs["units"] = dict(zip(table.columns, table.units, strict=True))
    return frame
