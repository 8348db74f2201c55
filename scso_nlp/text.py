"""Numbers as files and options hold them, and values as messages show them."""

from __future__ import annotations

import math
import re
import reprlib
from typing import Any

_NUMBER = re.compile(
    r"[-+]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:e[-+]?\d+)?|nan|inf(?:inity)?)", re.ASCII | re.IGNORECASE
)
#: What NumPy's arrays may hold, by the letter of their kind.
_ENTRIES = {"U": "text", "S": "text", "O": "objects", "M": "dates", "m": "durations", "c": "complex numbers"}


class _Short(reprlib.Repr):
    """Values as Python writes them, cut to a length; arrays by what they hold."""

    def repr_int(self, value: int, level: int) -> str:
        try:
            return super().repr_int(value, level)
        except ValueError:  # Python writes no number of more than 4300 digits
            return "a number of thousands of digits"

    def repr_ndarray(self, array: Any, _: int) -> str:
        return f"an array of {_ENTRIES.get(array.dtype.kind, 'numbers')} of shape {array.shape}"

    def repr_MaskedArray(self, array: Any, level: int) -> str:
        return f"{self.repr_ndarray(array, level)} with masked entries"


def number(text: str) -> float:
    """Read a number as OpenSim, C and tables write it, blanks around it allowed.

    Python's own ``float`` takes more, such as ``1_0`` for ten, which no other program does.

    Parameters
    ----------
    text : str

    Returns
    -------
    float
        The nearest double; infinite where that is written out.

    Raises
    ------
    ValueError
        Not a number, or one beyond the doubles.
    """
    if not _NUMBER.fullmatch(text.strip()):
        raise ValueError(f"{shown(text)} is not a number")
    value = float(text)
    if math.isinf(value) and any(sign.isdigit() for sign in text):
        raise ValueError(f"{shown(text)} is not a number below 1.8e308")
    return value


def printable(text: str) -> str:
    """Write out control characters, e.g. of names in a file, that would move a terminal's cursor.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
        Ends of lines stay.
    """
    return "".join(sign if sign.isprintable() or sign == "\n" else repr(sign)[1:-1] for sign in text)


def shown(value: object, longest: int = 60) -> str:
    """Write a value for a message, as Python does, but not at any length.

    Parameters
    ----------
    value : object
        Text, a number, a list, a table or an array.
    longest : int
        Characters of text and digits of numbers.

    Returns
    -------
    str
        Long text, digits and lists are cut in the middle; of an array what it holds and its shape.
    """
    short = _Short()
    short.maxstring = short.maxlong = short.maxother = longest
    text = short.repr(value)
    return text if len(text) <= 2 * longest else f"{text[:longest]}...{text[-longest:]}"
