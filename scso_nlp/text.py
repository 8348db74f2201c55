"""Numbers as files and options hold them, and values as messages show them."""

from __future__ import annotations

import re
import reprlib

_NUMBER = re.compile(
    r"[-+]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:e[-+]?\d+)?|nan|inf(?:inity)?)", re.ASCII | re.IGNORECASE
)
_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 60


def number(text: str) -> float:
    """Read a number as OpenSim, C and tables write it, blanks around it allowed.

    Python's own ``float`` takes more, such as ``1_0`` for ten, which no other program does.

    Parameters
    ----------
    text : str

    Returns
    -------
    float
        The nearest double; infinite beyond the doubles.

    Raises
    ------
    ValueError
        Not a number.
    """
    if not _NUMBER.fullmatch(text.strip()):
        raise ValueError(f"{shown(text)} is not a number")
    return float(text)


def shown(value: object) -> str:
    """Write a value for a message, as Python does, but not at any length.

    Parameters
    ----------
    value : object
        Text, a number, a list or a table, as a file may hold it.

    Returns
    -------
    str
        Long text and digits are cut in the middle, long lists after their first entries.
    """
    try:
        return " ".join(_SHORT.repr(value).split("\n"))
    except ValueError:  # Python writes no number of more than 4300 digits
        return "a number of thousands of digits"
