"""Checks that turn caller's data into read-only arrays, or say in one sentence why not.

Arrays by their shape, names by what is there. Used by the frozen data classes; nothing here knows about
muscles or solvers.
"""

from __future__ import annotations

import copyreg
import difflib
import fnmatch
import numbers
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.text import shown

#: At most so many names stand in one message.
MOST_NAMES = 12

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.signedinteger[Any]]
BoolArray = NDArray[np.bool_]


def _frozen(mapping: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(mapping)


# Frozen mappings can be pickled and copied deeply, and so can all data that hold them.
copyreg.pickle(MappingProxyType, lambda mapping: (_frozen, (dict(mapping),)))


def read_only(
    name: str, values: object, shape: Sequence[int], axes: str, *, finite: bool = True
) -> FloatArray:
    """Turn `values` into a read-only float array of the given shape.

    Parameters
    ----------
    name : str
        How the array is called in error messages.
    values : array_like
        The caller's numbers.
    shape : sequence of int
        Expected shape; -1 accepts any length along that axis.
    axes : str
        The names of the axes, for the message, e.g. ``"n_frames, n_muscles"``.
    finite : bool
        Refuse NaN and infinity.

    Returns
    -------
    ndarray, shape `shape`
        A copy that cannot be written to; `values` itself if it is that already and owns its numbers.

    Raises
    ------
    DataError
        Not numeric, wrong shape, or not finite (the first bad index is named).
    """
    array = _own(_of_shape(name, _numbers(name, values), shape, axes), np.float64)
    if finite and not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise DataError(f"{name} is {array[where]} at index {where} of ({axes}), expected a finite number")
    return array


def read_only_integers(
    name: str, values: object, shape: Sequence[int], axes: str, *, least: int, below: int
) -> IntArray:
    """Turn `values` into a read-only array of whole numbers; those of fewer bytes stay as they are.

    Parameters
    ----------
    name, values, shape, axes
        As for :func:`read_only`.
    least, below : int
        The numbers lie between, `below` itself left out.

    Returns
    -------
    ndarray of int, shape `shape`

    Raises
    ------
    DataError
        Not whole, wrong shape, less than `least` or not less than `below`.
    """
    array = _of_shape(name, _numbers(name, values), shape, axes)
    is_whole = array.dtype.kind == "i"
    if not is_whole:
        array = read_only(name, array, shape, axes)
    wrong = np.argwhere((array < least) | (array >= below) | (not is_whole and array != np.round(array)))
    if len(wrong):
        where = tuple(int(i) for i in wrong[0])
        raise DataError(
            f"{name} is {array[where]:g} at index {where} of ({axes}), expected whole numbers from {least} "
            f"to {below - 1}"
        )
    return _own(array, array.dtype if is_whole else np.dtype(np.int64))


def read_only_flags(name: str, values: object, shape: Sequence[int], axes: str) -> BoolArray:
    """Copy `values` to a read-only array of true and false; 0 and 1 will do.

    Parameters
    ----------
    name, values, shape, axes
        As for :func:`read_only`.

    Returns
    -------
    ndarray of bool, shape `shape`

    Raises
    ------
    DataError
        Something else, or the wrong shape.
    """
    array = _of_shape(name, _numbers(name, values), shape, axes)
    if not ((array == 0) | (array == 1)).all():
        raise DataError(f"{name} has entries that are neither true nor false, expected only these")
    return _own(array, np.bool_)


def _own(array: np.ndarray, dtype: npt.DTypeLike) -> np.ndarray:
    """Copy an array to a read-only one, unless it is one that nobody else can write to."""
    is_own = array.flags.owndata and array.flags.c_contiguous and not array.flags.writeable
    own = array if is_own and array.dtype == dtype else array.astype(dtype, order="C")
    own.flags.writeable = False
    return own


def _numbers(name: str, values: object) -> np.ndarray:
    """Read real numbers of any kind; text, dates, complex numbers and gaps are none."""
    if np.ma.is_masked(values):
        raise DataError(f"{name} has masked entries, expected a number in each; fill them or leave them out")
    try:
        array = np.asarray(values)
    except ValueError:
        raise DataError(f"{name} cannot be read as numbers: its rows differ in length") from None
    if array.dtype.kind == "O" and all(isinstance(entry, numbers.Real) for entry in array.flat):
        try:
            array = array.astype(np.float64)
        except OverflowError:
            raise DataError(f"{name} cannot be read as numbers: one is beyond the doubles") from None
    if array.size and array.dtype.kind not in "biuf":
        raise DataError(f"{name} cannot be read as numbers: found {shown(array.flat[0])} in it")
    return array


def _of_shape(name: str, array: np.ndarray, shape: Sequence[int], axes: str) -> np.ndarray:
    expected = tuple(shape)
    if array.ndim != len(expected) or any(
        e not in (-1, n) for e, n in zip(expected, array.shape, strict=True)
    ):
        raise DataError(f"{name} has shape {array.shape}, expected {expected} = ({axes})")
    return array


def unique_names(kind: str, names: Iterable[str]) -> tuple[str, ...]:
    """Return `names` as a tuple, or raise :class:`DataError` if one stands twice."""
    result = tuple(str(name) for name in names)
    if len(set(result)) < len(result):
        twice = sorted(name for name, count in Counter(result).items() if count > 1)
        raise DataError(f"{kind} names must be unique, found twice: {shown_names(twice)}")
    return result


def chosen_names(kind: str, names: str | Iterable[str] | None) -> tuple[str, ...] | None:
    """Return the names a user chooses, one bare name too, as a tuple; None, for all, stays.

    Raises
    ------
    DataError
        None at all, or one twice.
    """
    if names is None:
        return None
    chosen = unique_names(kind, (names,) if isinstance(names, str) else names)
    if not chosen:
        raise DataError(
            f"the list of {kind} names is empty, expected at least one, or no list for all of them"
        )
    return chosen


def shown_names(names: Sequence[str]) -> str:
    """List names for a message, the first dozen of many."""
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(names[:MOST_NAMES]) + more


def positions(kind: str, wanted: Iterable[str], available: Sequence[str]) -> IntArray:
    """Find `wanted` names among `available` ones.

    Returns
    -------
    ndarray of int, shape (n_wanted,)
        The position of each wanted name.

    Raises
    ------
    NameMismatchError
        A name is not there; the closest ones are suggested.
    """
    table = {name: i for i, name in enumerate(available)}
    wanted = tuple(wanted)
    missing = [name for name in wanted if name not in table]
    if missing:
        names = shown_names([shown(name) for name in missing])
        raise NameMismatchError(f"unknown {kind} {names} ({nearest(missing[0], available)})")
    return np.array([table[name] for name in wanted], dtype=np.int64)


def same_names(kind: str, expected: tuple[str, ...], found: tuple[str, ...]) -> None:
    """Raise :class:`NameMismatchError` if the parameters' names are not the trajectory's, in its order."""
    if expected == found:
        return
    missing = [name for name in expected if name not in found]
    extra = [name for name in found if name not in expected]
    if missing or extra:
        raise NameMismatchError(
            f"{kind} of the trajectory and of the parameters differ: "
            f"missing {missing or 'none'}, extra {extra or 'none'}"
        )
    raise NameMismatchError(f"{kind} of the trajectory and of the parameters are in different order")


def nearest(name: str, available: Iterable[str]) -> str:
    """Hint at what may have been meant by a name that is not there.

    Parameters
    ----------
    name : str
        As it was written, maybe a pattern.
    available : iterable of str

    Returns
    -------
    str
        ``"closest: ..."`` with up to three names, or ``"available: ..."`` with the first dozen where none is
        like it.
    """
    names = list(available)
    close = difflib.get_close_matches(name.strip("*?"), names, n=3, cutoff=0.5)
    return f"closest: {', '.join(close)}" if close else f"available: {', '.join(names[:MOST_NAMES])}"


def matches(kind: str, pattern: str, available: Sequence[str]) -> IntArray:
    """Find the names that a name or a pattern stands for.

    Parameters
    ----------
    kind : str
        What the names are of, for the message.
    pattern : str
        One of the names, or a pattern with ``*``, ``?`` or ``[...]``, upper and lower case told apart.
    available : sequence of str

    Returns
    -------
    ndarray of int, shape (n_matches,)
        Their positions, at least one.

    Raises
    ------
    NameMismatchError
        It fits none; the closest ones are suggested.
    """
    if pattern in available or not any(sign in pattern for sign in "*?["):
        return positions(kind, (pattern,), available)
    found = [i for i, name in enumerate(available) if fnmatch.fnmatchcase(name, pattern)]
    if not found:
        raise NameMismatchError(f"pattern {pattern!r} fits no {kind} ({nearest(pattern, available)})")
    return np.array(found, dtype=np.int64)


def by_name(
    kind: str, values: Mapping[str, float], available: Sequence[str], *, default: float = np.nan
) -> FloatArray:
    """Spread values that are given by name or pattern over all names; later entries win.

    Parameters
    ----------
    kind : str
        What the names are of, for the message.
    values : mapping of str to float [any]
        Keys as for :func:`matches`.
    available : sequence of str
    default : float [any]
        For names that no key fits.

    Returns
    -------
    ndarray, shape (n_available,) [any]

    Raises
    ------
    NameMismatchError
        A key fits none; the closest names are suggested.
    """
    spread = np.full(len(available), float(default))
    for pattern, value in values.items():
        spread[matches(kind, pattern, available)] = value
    return spread
