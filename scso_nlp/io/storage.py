"""OpenSim Storage files (``.sto``, ``.mot``): read every variant in use, write what OpenSim 4.6 writes.

The reader follows OpenSim's ``Storage`` where that is well defined (equal times, degrees of old ``.mot``
files) and stops with one sentence where OpenSim guesses (short rows, text among numbers, time that goes
back).
What a column means, e.g. a coordinate, a force or an EMG channel, is for the caller to know.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError, FileFormatError, NameMismatchError
from scso_nlp.files import read_bytes, write_whole
from scso_nlp.text import number, shown
from scso_nlp.validation import BoolArray, FloatArray, IntArray, nearest, read_only

logger = logging.getLogger("scso_nlp")

#: Free text that OpenSim's own tools put above ``endheader``; blank lines included.
UNITS_DESCRIPTION = (
    "\nUnits are S.I. units (second, meters, Newtons, ...)\n"
    "If the header above contains a line with 'inDegrees', this indicates whether rotational values are in "
    "degrees (yes) or radians (no).\n\n"
)
#: A header longer than this is not a Storage header [bytes].
MAX_HEADER_BYTES = 2**20
#: Times count as equal if they are apart by no more than this share of the typical step [-].
EQUAL_TIMES = 1e-6

_KEY_VALUE = re.compile(r"([A-Za-z_]\w*)\s*=\s*(.*)")
_SIMM_KEYS = (
    r"datacolumns|datarows|otherdata|range|wrap|event|enforce_loops|enforce_constraints|calc_derivatives"
)
_SIMM_KEY_VALUE = re.compile(rf"(name|{_SIMM_KEYS})\s+(.*)", re.IGNORECASE)
_END_OF_HEADER = re.compile(rb"^[ \t]*endheader[ \t]*$", re.IGNORECASE | re.MULTILINE)
_MICROSOFT_NAN = re.compile(rb"[-+]?(?:\d\.#(?:[QS]NAN|IND)\d*|nan\(\w*\))", re.IGNORECASE)
_MICROSOFT_INF = re.compile(rb"\d\.#INF\d*", re.IGNORECASE)
_STATE_PATH = re.compile(r"(?:.*/)?([^/]+)/value")


@dataclass(frozen=True, kw_only=True, eq=False)
@checked
class Storage:
    """Named columns over time, with the header of a Storage file.

    Attributes
    ----------
    name : str
        Title: the first line of the file.
    labels : tuple of str
        Column names without time. May be repeated or blank, as in files; such a column has no
        label to be found by.
    time : ndarray, shape (n_frames,) [s]
        Strictly increasing.
    values : ndarray, shape (n_frames, n_columns) [unit of each column]
        May hold NaN, see :meth:`require_finite`.
    in_degrees : bool or None
        Rotational columns are in degrees (True) or radians (False); None if the file does not say.
    description : str
        Free text between the keys and ``endheader``, verbatim.
    header : mapping of str to str
        The ``key=value`` lines as read (``version``, ``nRows``, ``range``, ...). Not used for writing.
    source : str
        The file it was read from, for messages; empty if made in memory.
    """

    name: str
    labels: tuple[str, ...]
    time: FloatArray
    values: FloatArray
    in_degrees: bool | None = None
    description: str = UNITS_DESCRIPTION
    header: Mapping[str, str] = field(default_factory=dict)
    source: str = ""

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        labels = tuple(str(label) for label in self.labels)
        time = read_only("time", self.time, (-1,), "n_frames")
        shape = (len(time), len(labels))
        set_field(self, "labels", labels)
        set_field(self, "time", time)
        set_field(
            self, "values", read_only("values", self.values, shape, "n_frames, n_columns", finite=False)
        )
        set_field(self, "header", MappingProxyType(dict(self.header)))
        set_field(self, "source", str(self.source))
        if len(time) == 0:
            raise DataError(f"{self._where} has no frames, expected at least one")
        back = np.flatnonzero(time[1:] <= time[:-1])
        if len(back):
            k = int(back[0]) + 1
            raise DataError(
                f"{self._where}: time must increase, found {_shown(time[k])} s at row {k} "
                f"after {_shown(time[k - 1])} s"
            )

    @property
    def n_frames(self) -> int:
        """Number of rows."""
        return len(self.time)

    @property
    def n_columns(self) -> int:
        """Number of columns without time."""
        return len(self.labels)

    @property
    def assumed_in_degrees(self) -> bool:
        """Unit of the rotational columns: `in_degrees`, or what OpenSim takes without it.

        OpenSim reads ``.mot`` files without a version line in degrees and everything else in radians,
        as what rtosim wrote is.
        """
        if self.in_degrees is not None:
            return self.in_degrees
        return self.is_old_mot and "rtosim" not in self.name.lower()

    @property
    def is_old_mot(self) -> bool:
        """True for ``.mot`` files without a version line, whose angles OpenSim takes for degrees."""
        version = re.match(r"\d+", self.header.get("version", ""))
        return self.source.lower().endswith(".mot") and (version is None or int(version.group()) < 1)

    def index(self, label: str, *, suffixes: Sequence[str] = ()) -> int:
        """Find one column.

        Parameters
        ----------
        label : str
            A label of the file; or a coordinate's name where the file has its state path
            (``/jointset/knee_r/knee_angle_r/value``); or the reverse.
        suffixes : sequence of str
            Tried after `label` in turn where the bare label is not there, e.g. ``("_moment", "_force")`` for
            inverse dynamics.

        Returns
        -------
        int
            Position in `labels`.

        Raises
        ------
        NameMismatchError
            Not there (the closest labels are named), or more than one column answers to it.
        """
        return int(self._find((label,), suffixes)[0])

    def column(self, label: str, *, suffixes: Sequence[str] = ()) -> FloatArray:
        """Take one column by its label, see :meth:`index`.

        Returns
        -------
        ndarray, shape (n_frames,) [unit of the column]
            Read-only.
        """
        return self.values[:, self.index(label, suffixes=suffixes)]

    def columns(self, labels: Iterable[str], *, suffixes: Sequence[str] = ()) -> FloatArray:
        """Take several columns by their labels, in the order asked for, see :meth:`index`.

        Returns
        -------
        ndarray, shape (n_frames, n_labels) [unit of each column]
            A copy.
        """
        return self.values[:, self._find(tuple(labels), suffixes)]

    def require_finite(self) -> Storage:
        """Return itself if every value is finite.

        Raises
        ------
        DataError
            Some value is NaN or infinite; file, column and time of the first one are named.
        """
        bad = np.argwhere(~np.isfinite(self.values))
        if len(bad):
            k, c = (int(i) for i in bad[0])
            raise DataError(
                f"{self._where}: column {self.labels[c]!r} is {self.values[k, c]} at "
                f"t = {_shown(self.time[k])} s, expected a finite number ({len(bad)} such value(s) in all)"
            )
        return self

    @property
    def _where(self) -> str:
        return self.source or f"Storage {self.name!r}"

    def _find(self, wanted: Sequence[str], suffixes: Sequence[str]) -> IntArray:
        table: dict[str, list[int]] = {}
        by_coordinate: dict[str, list[int]] = {}
        for position, label in enumerate(self.labels):
            table.setdefault(label, []).append(position)
            path = _STATE_PATH.fullmatch(label)
            if path:
                by_coordinate.setdefault(path.group(1), []).append(position)

        def candidates(label: str) -> list[int]:
            if not label:
                return []
            for name in (label, *(label + suffix for suffix in suffixes)):
                if name in table:
                    return table[name]
            if label in by_coordinate:
                return by_coordinate[label]
            path = _STATE_PATH.fullmatch(label)
            if path is None:
                return []
            # the coordinate's plain name, or the same path written with fewer leading folders
            shorter = [i for i in by_coordinate.get(path.group(1), []) if _is_tail(self.labels[i], label)]
            return table.get(path.group(1), shorter)

        found = [candidates(label) for label in wanted]
        missing = [label for label, positions in zip(wanted, found, strict=True) if not positions]
        if missing:
            available = [name for name in (*table, *by_coordinate) if name]
            names = ", ".join(repr(label) for label in missing)
            raise NameMismatchError(f"{self._where} has no column {names} ({nearest(missing[0], available)})")
        for label, positions in zip(wanted, found, strict=True):
            if len(positions) > 1:
                several = " or ".join(f"{i + 1} ({self.labels[i]})" for i in positions)
                raise NameMismatchError(
                    f"{self._where}: {label!r} is ambiguous, it may be column {several} after time, "
                    "expected one"
                )
        return np.array([positions[0] for positions in found], dtype=np.int64)


@checked
def read_storage(path: str | os.PathLike[str]) -> Storage:
    """Read a ``.sto`` or ``.mot`` file.

    Accepts Storage version 1, TimeSeriesTable version 3, files without a version line and SIMM motion
    headers; tabs, spaces or commas between cells; padded, blank or repeated labels; any line ends; UTF-8
    (with or without byte order mark) and Latin-1. Rows and labels count, not ``nRows`` and ``nColumns``: a
    difference is logged.

    Parameters
    ----------
    path : str or path-like
        The file.

    Returns
    -------
    Storage
        Numbers as the nearest doubles. NaN tokens are kept as NaN.

    Raises
    ------
    DataError
        No such file, not readable, or time that is not finite or goes back.
    FileFormatError
        Not a Storage file, a row with too few or too many numbers, a token that is not a number.

    Notes
    -----
    Rows with equal time: the last one is kept, as OpenSim's ``Storage`` does, and a warning is logged.
    OpenSim's ``Storage`` silently stops at a NaN, repeats the previous row's value in a short last row and
    drops blank labels so that later columns get wrong names; here the first is kept, the second raises, the
    third keeps every label with its column.
    """
    path = Path(path)
    content = _content(path)
    end = _END_OF_HEADER.search(content, 0, MAX_HEADER_BYTES)
    if end is None:
        raise FileFormatError(
            f"{path} has no 'endheader' line within its first {MAX_HEADER_BYTES} bytes, which every .sto and "
            ".mot file has above its column labels"
        )
    name, header, description = _parse_header(_decoded(content[: end.start()]))
    data_type = header.get("DataType", "double")
    if data_type.lower() != "double":
        raise FileFormatError(f"{path} holds elements of type {data_type}, expected double")
    in_degrees = _parse_in_degrees(path, header)

    label_line, label_line_number, body, body_line_number = _split_labels(path, content, end.end())
    table, line_numbers, labels = _parse_rows(path, label_line, label_line_number, body, body_line_number)
    _report_counts(path, header, table)
    table = _one_row_per_time(path, table, line_numbers)
    return Storage(
        name=name,
        labels=labels,
        time=table[:, 0],
        values=table[:, 1:],
        in_degrees=in_degrees,
        description=description,
        header=header,
        source=str(path),
    )


def with_distinct_times(storage: Storage) -> Storage:
    """Take rows whose times are equal but for rounding as one row.

    Some programs end a file with two rows for one instant, e.g. at 1.5989999999999 and 1.599 s. A spline
    through both has no meaning, and a filter that resamples to the smallest step never ends.

    Parameters
    ----------
    storage : Storage

    Returns
    -------
    Storage
        Of every such group the values of the last row, as of equal times, at the time of the first. The same
        storage if there is none.

    Notes
    -----
    Equal are times that differ by no more than a millionth of the median step, which is logged as equal times
    are.
    """
    if storage.n_frames < 3:
        return storage
    steps = np.diff(storage.time)
    is_distinct = steps > EQUAL_TIMES * np.median(steps)
    if is_distinct.all():
        return storage
    _report_equal_times(storage._where, storage.time, is_distinct)
    return replace(
        storage,
        time=storage.time[np.concatenate(([True], is_distinct))],
        values=storage.values[np.concatenate((is_distinct, [True]))],
    )


@checked
def write_storage(
    storage: Storage,
    path: str | os.PathLike[str],
    *,
    precision: int = 17,
    allow_nonfinite: bool = False,
) -> None:
    """Write a file that OpenSim's ``Storage`` and ``TimeSeriesTable`` read, whole or not at all.

    The header is that of OpenSim 4.6: title, ``version=1``, ``nRows``, ``nColumns``, ``inDegrees``, the
    description, ``endheader``. A unit that is not known is written as OpenSim would have taken it
    (:attr:`Storage.assumed_in_degrees`).

    Parameters
    ----------
    storage : Storage
        What to write.
    path : str or path-like
        Target; an existing file is replaced. The folder must exist.
    precision : int
        Significant digits of the values, 1 to 17; 17 gives identical doubles back. Time always keeps all
        digits, because epoch time stamps need them.
    allow_nonfinite : bool
        Write NaN and infinity too. OpenSim's ``Storage`` silently stops reading at them.

    Raises
    ------
    DataError
        A label or title that OpenSim would read differently, a value that is not finite, or a folder that
        cannot be written to.
    """
    path = Path(path)
    if not 1 <= precision <= 17:
        raise DataError(f"precision is {precision}, expected 1 to 17 significant digits")
    _check_names(storage, path)
    if not allow_nonfinite:
        storage.require_finite()
    written = repr if precision == 17 else f"{{:.{precision}g}}".format
    rows = ("\t".join(map(written, row.tolist())) for row in storage.values)
    description = storage.description
    if description and not description.endswith("\n"):
        description += "\n"
    head = (
        f"{storage.name}\nversion=1\nnRows={storage.n_frames}\nnColumns={storage.n_columns + 1}\n"
        f"inDegrees={'yes' if storage.assumed_in_degrees else 'no'}\n{description}endheader\n",
        "\t".join(("time", *storage.labels)) + "\n",
    )
    lines = (
        f"{time!r}\t{row}\n" if row else f"{time!r}\n"
        for time, row in zip(storage.time.tolist(), rows, strict=True)
    )
    # line by line: a long motion would be in memory several times
    with write_whole(path) as temporary, open(temporary, "x", encoding="utf-8", newline="") as file:
        file.writelines(head)
        file.writelines(lines)


def _content(path: Path) -> bytes:
    """Return the file's bytes with plain line ends and no byte order mark."""
    content = read_bytes(path)
    if not content.strip():
        raise FileFormatError(f"{path} is empty, expected a .sto or .mot file")
    if b"\0" in content:
        raise FileFormatError(f"{path} is not plain text (it holds zero bytes), expected a .sto or .mot file")
    content = content.removeprefix(b"\xef\xbb\xbf")
    return content.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in content else content


def _decoded(text: bytes) -> str:
    for encoding in ("utf-8", "cp1252"):  # the second is Latin-1 with a few more printable characters
        with contextlib.suppress(UnicodeDecodeError):
            return text.decode(encoding)
    return text.decode("latin-1")


def _parse_header(text: str) -> tuple[str, dict[str, str], str]:
    """Return title, keys with their values, and the free text below them."""
    title = ""
    header: dict[str, str] = {}
    free: list[str] = []
    for position, line in enumerate(text.split("\n")[:-1]):
        stripped = line.strip()
        if stripped.startswith("#"):
            continue
        key_value = _KEY_VALUE.fullmatch(stripped) or _SIMM_KEY_VALUE.fullmatch(stripped)
        if key_value:
            header[key_value.group(1)] = key_value.group(2).strip()
            if not "".join(free):
                free.clear()
        elif position == 0:
            title = stripped
        else:
            free.append(stripped)
    return header.get("name", title), header, "".join(f"{line}\n" for line in free)


def _parse_in_degrees(path: Path, header: Mapping[str, str]) -> bool | None:
    value = next((value for key, value in header.items() if key.lower() == "indegrees"), None)
    if value is None:
        return None
    known = {"yes": True, "y": True, "true": True, "no": False, "n": False, "false": False}
    if value.lower() not in known:
        raise FileFormatError(f"{path} has inDegrees={shown(value)}, expected yes or no")
    return known[value.lower()]


def _split_labels(path: Path, content: bytes, start: int) -> tuple[str, int, bytes, int]:
    """Return the line of labels and the rows below it, each with the number of its (first) line."""
    label_start = start
    while label_start < len(content) and content[label_start : label_start + 1].isspace():
        label_start += 1
    label_end = content.find(b"\n", label_start)
    if label_start == len(content) or label_end < 0 or not content[label_end:].strip():
        what = "column labels and rows" if label_start == len(content) else "rows below its column labels"
        last_line = content.rstrip().count(b"\n") + 1
        raise FileFormatError(f"{path} has no {what}: it ends after line {last_line}")
    # leading tabs belong to the line of labels
    line_start = content.rfind(b"\n", 0, label_start) + 1
    line_number = content.count(b"\n", 0, label_start) + 1
    return _decoded(content[line_start:label_end]), line_number, content[label_end + 1 :], line_number + 1


def _label_readings(line: str) -> list[tuple[str, ...]]:
    """List the ways to read a line of labels, the one that keeps blank labels first."""
    separator = "\t" if "\t" in line else "," if "," in line else None
    if separator is None:
        return [tuple(line.split())]
    cells = [cell.strip() for cell in line.split(separator)]
    trimmed = list(cells)
    while trimmed and not trimmed[-1]:
        trimmed.pop()
    filled = [cell for cell in cells if cell]
    return list(dict.fromkeys(tuple(cells) for cells in (trimmed, filled, cells, line.split())))


def _parse_rows(
    path: Path, label_line: str, label_line_number: int, body: bytes, first_line: int
) -> tuple[FloatArray, IntArray, tuple[str, ...]]:
    """Return all numbers, shape (n_rows, 1 + n_columns), the line number of each row, and the labels."""
    has_commas = b"," in body
    if has_commas:
        body = body.replace(b",", b" ")
    if b"#" in body or b"(" in body:
        body = _MICROSOFT_INF.sub(b"inf", _MICROSOFT_NAN.sub(b"nan", body))
    # count the cells of every line without a loop over cells
    characters = np.frombuffer(body, dtype=np.uint8)
    filled = characters > ord(" ")
    starts = np.flatnonzero(filled & ~np.concatenate(([False], filled[:-1])))
    line_ends = np.append(np.flatnonzero(characters == ord("\n")), len(characters))
    counts = np.diff(np.searchsorted(starts, line_ends), prepend=0)
    rows = np.flatnonzero(counts)
    line_numbers = rows + first_line

    readings = _label_readings(label_line)
    labels = next((reading for reading in readings if len(reading) in counts[rows]), None)
    hint = " (decimal commas? write decimal points)" if has_commas and "," not in label_line else ""
    if labels is None:
        raise FileFormatError(
            f"{path}, line {line_numbers[0]}: expected {len(readings[0])} numbers, one per label of line "
            f"{label_line_number}, found {counts[rows[0]]}{hint}"
        )
    if labels[0].lower() != "time":
        raise FileFormatError(
            f"{path}, line {label_line_number}: the first column is {shown(labels[0])}, expected 'time'"
        )
    wrong = rows[counts[rows] != len(labels)]
    if len(wrong):
        cut = (
            ", the file seems to be cut off"
            if wrong[0] == rows[-1] and counts[wrong[0]] < len(labels)
            else ""
        )
        raise FileFormatError(
            f"{path}, line {wrong[0] + first_line}: expected {len(labels)} numbers, "
            f"found {counts[wrong[0]]}{cut}{hint}"
        )
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # how NumPy says that it met something else
        try:
            numbers = np.fromstring(body, dtype=np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            numbers = np.empty(0)
    if numbers.size != len(starts):
        numbers = _parse_slowly(path, labels, body, first_line)
    return numbers.reshape(len(rows), len(labels)), line_numbers, labels[1:]


def _parse_slowly(path: Path, labels: tuple[str, ...], body: bytes, first_line: int) -> FloatArray:
    """Parse cell by cell, to name the first one that is not a number."""
    numbers: list[float] = []
    for line_number, line in enumerate(body.split(b"\n"), start=first_line):
        for label, token in zip(labels, line.split(), strict=False):
            try:
                numbers.append(number(_decoded(token)))
            except ValueError:
                raise FileFormatError(
                    f"{path}, line {line_number}: expected a number in column {shown(label)}, "
                    f"found {shown(_decoded(token))}"
                ) from None
    return np.array(numbers)


def _report_counts(path: Path, header: Mapping[str, str], table: FloatArray) -> None:
    """Log where the header's numbers of rows and columns are not those of the data."""
    for keys, found in (
        (("nRows", "nr", "datarows"), len(table)),
        (("nColumns", "nc", "datacolumns"), table.shape[1]),
    ):
        for key in keys:
            if key in header and header[key] != str(found):
                logger.warning("%s: %s is %s in the header, found %d", path, key, header[key], found)


def _one_row_per_time(path: Path, table: FloatArray, line_numbers: IntArray) -> FloatArray:
    """Check that time increases; of rows with equal time keep the last."""
    time = table[:, 0]
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise DataError(
            f"{path}, line {line_numbers[bad[0]]}: time is {time[bad[0]]} at row {bad[0]}, "
            "expected a finite number"
        )
    back = np.flatnonzero(time[1:] < time[:-1])
    if len(back):
        k = int(back[0]) + 1
        raise DataError(
            f"{path}, line {line_numbers[k]}: time must increase, found {_shown(time[k])} s at row {k} "
            f"after {_shown(time[k - 1])} s"
        )
    is_distinct = time[1:] > time[:-1]
    if not is_distinct.all():
        _report_equal_times(str(path), time, is_distinct)
    return table[np.append(is_distinct, True)]


def _report_equal_times(where: str, time: FloatArray, is_distinct: BoolArray) -> None:
    """Log how many rows, shape (n_rows,) [s], have the time of the next, shape (n_rows - 1,)."""
    logger.warning(
        "%s: %d row(s) have the time of the next row, first at t = %s s; the last of each time is kept",
        where,
        int((~is_distinct).sum()),
        _shown(time[int(np.argmin(is_distinct))]),
    )


def _check_names(storage: Storage, path: Path) -> None:
    """Refuse labels and titles that OpenSim, or this reader, would read back as something else."""
    for position, label in enumerate(storage.labels):
        if not label or not label.isprintable() or any(character.isspace() for character in label):
            raise DataError(
                f"{path}: label {label!r} of column {position + 1} cannot be written, because OpenSim splits "
                "labels at white space and drops blank ones; rename the column"
            )
    lines = [storage.name, *storage.description.split("\n")]
    if any(
        not line.replace("\t", " ").isprintable() or line.strip().lower() == "endheader" for line in lines
    ):
        raise DataError(
            f"{path}: title and description must be printable text without an 'endheader' line, "
            f"found {storage.name!r} and {storage.description!r}"
        )
    if _parse_header(f"{storage.name}\n")[0] != storage.name:
        raise DataError(f"{path}: the title {storage.name!r} would be read as something else; change it")


def _is_tail(one: str, other: str) -> bool:
    """Tell if one path is the end of the other, whole folders only."""
    shorter, longer = sorted((one.strip("/"), other.strip("/")), key=len)
    return f"/{longer}".endswith(f"/{shorter}")


def _shown(number: float) -> str:
    return f"{float(number)!r}"
