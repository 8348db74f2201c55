"""Mutations of small good inputs: what is done is drawn by a generator, what must become of it is declared.

Nothing here is from the package: what a mutated file says is read again by :func:`plain_columns`, in Python's
own terms.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import math
import re
from collections.abc import Callable, Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np

#: What must become of a mutant.
REFUSE, ACCEPT, EITHER = "must be refused", "must be accepted", "may be either"
#: Instead of a file's content, a folder in its place; instead of a value, a key that must not be there.
FOLDER, GONE = b"\xff folder", "not there any more"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Mutant:
    """A mutated file, or another input, and what must become of it.

    `changes` is how the data that are read may differ from the original's: by these entries alone. Without
    them it is enough that numbers are finite. `names` may stand in a message in place of the file's name.
    `by_opensim` is what must become of it where OpenSim reads it too.
    """

    how: str
    content: Any
    must: str = EITHER
    changes: Mapping[str, Any] | None = None
    names: tuple[str, ...] = ()
    by_opensim: str = ""


def pick(rng: np.random.Generator, things: Any) -> Any:
    """Draw one of several things."""
    things = list(things)
    return things[int(rng.integers(len(things)))]


# Any file ----------------------------------------------------------------------------------------------

GOOD_NUMBERS = ("-17.25", "1e5", "+3", "007", ".5", "5.", "1E-3", "0.1e+01", "1e-400", "-0", "0.1" + "7" * 60,
                "1e300", "-1.5e-300")  # fmt: skip
BAD_NUMBERS = (
    "text",
    "1_0",
    "0x10",
    "1e",
    "--1",
    "1.2.3",
    "1d5",
    "½",
    "१",
    "1.5 2",
    "True",
    "1e5.0",
    "#",
    "=1",
)
NOT_FINITE = ("nan", "-NaN", "inf", "-Infinity", "1e400", "-1e400", "9" * 400)


def plain_number(token: str) -> float | None:
    """Read a number as C does; None where the text is none."""
    if re.fullmatch(r"[-+]?((\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|nan|inf(inity)?)", token, re.ASCII | re.I):
        return float(token)
    return None


def of_any_file(rng: np.random.Generator, original: bytes, others: list[bytes], empty: str) -> Mutant:
    """Damage bytes and lines, whatever the file is."""
    lines = original.split(b"\n")
    at, line = int(rng.integers(len(original))), int(rng.integers(len(lines)))
    other = int(rng.integers(len(lines)))
    how = pick(rng, (
        "no file", "a folder", "empty file", "blank file", "another kind of file", "cut", "cut at a line",
        "bits flipped", "bytes inserted", "bytes deleted", "zero byte", "UTF-16", "Latin-1 letter",
        "line deleted", "line twice", "lines swapped", "lines in another order", "very long line",
    ))  # fmt: skip
    must, changes = EITHER, None
    content: bytes | None = original
    if how == "no file":
        content, must = None, REFUSE
    elif how == "a folder":
        content, must = FOLDER, REFUSE
    elif how in ("empty file", "blank file"):
        content, must = b"" if how == "empty file" else b" \n\t\r\n", empty
    elif how == "another kind of file":
        content, must = pick(rng, others), REFUSE
    elif how == "cut":
        content = original[:at]
    elif how == "cut at a line":
        content = b"\n".join(lines[:line]) + b"\n"
    elif how == "bits flipped":
        flipped = bytearray(original)
        for _ in range(int(rng.integers(1, 4))):
            flipped[int(rng.integers(len(flipped)))] ^= 1 << int(rng.integers(8))
        content = bytes(flipped)
    elif how == "bytes inserted":
        content = original[:at] + rng.bytes(int(rng.integers(1, 9))) + original[at:]
    elif how == "bytes deleted":
        content = original[:at] + original[at + int(rng.integers(1, 9)) :]
    elif how == "zero byte":
        content = original[:at] + b"\0" + original[at:]
    elif how == "UTF-16":
        content = original.decode("latin-1").encode(pick(rng, ("utf-16", "utf-16-le", "utf-16-be")))
    elif how == "Latin-1 letter":
        content = original[:at] + b"\xe9" + original[at:]
    elif how == "line deleted":
        content = b"\n".join(lines[:line] + lines[line + 1 :])
    elif how == "line twice":
        content = b"\n".join(lines[: line + 1] + lines[line:])
    elif how == "lines swapped":
        lines[line], lines[other] = lines[other], lines[line]
        content = b"\n".join(lines)
    elif how == "lines in another order":
        content = b"\n".join(lines[i] for i in rng.permutation(len(lines)))
    else:
        long = pick(rng, (b"x", b"x ", b"<!--", b"1\t", b"[", b"{", b'"', b"#"))
        lines.insert(line, long * int(rng.integers(1000, 100_000)))
        content = b"\n".join(lines)
    return Mutant(how=how, content=content, must=must, changes=changes)


# Tables ------------------------------------------------------------------------------------------------


@dataclasses.dataclass
class Table:
    """A Storage file, or a table with commas where there is no header."""

    header: list[str]
    labels: list[str]
    rows: list[list[str]]

    def text(self, separator: str, end: str = "\n") -> str:
        """Write it again."""
        lines = [*self.header, separator.join(self.labels), *(separator.join(row) for row in self.rows)]
        return end.join(lines) + end

    def columns(self) -> dict[str, np.ndarray] | None:
        """Read numbers by label; None if some are none, or rows are of other lengths."""
        if len(set(self.labels)) < len(self.labels) or any(len(r) != len(self.labels) for r in self.rows):
            return None
        numbers = [[plain_number(cell.strip()) for cell in row] for row in self.rows]
        if not numbers or any(number is None for row in numbers for number in row):
            return None
        return dict(zip(self.labels, np.array(numbers, dtype=float).T, strict=True))


def plain_table(text: str, separator: str) -> Table | None:
    """Read a table without mercy; None if it is none."""
    lines = text.splitlines()
    header: list[str] = []
    if separator != ",":
        ends = [i for i, line in enumerate(lines) if line.strip().lower() == "endheader"]
        if not ends:
            return None
        header, lines = lines[: ends[0] + 1], lines[ends[0] + 1 :]
    split = [
        re.split(r"," if separator == "," else r"[\s,]+", line.strip()) for line in lines if line.strip()
    ]
    split = [[cell.strip() for cell in row] for row in split]
    return Table(header, split[0], split[1:]) if len(split) > 1 else None


def plain_columns(content: bytes, separator: str) -> dict[str, np.ndarray] | None:
    """Read the columns of a damaged table in Python's own terms; None where they are not plain."""
    try:
        table = plain_table(content.decode("utf-8-sig"), separator)
    except UnicodeDecodeError:
        return None
    columns = None if table is None else table.columns()
    if columns is None or table is None or table.labels[0].lower() != "time":
        return None
    time = columns.pop(table.labels[0])
    last = np.append(np.diff(time) != 0, True)
    return {"time": time[last], **{label: values[last] for label, values in columns.items()}}


def of_table(
    rng: np.random.Generator,
    original: bytes,
    *,
    used: frozenset[str],
    by_opensim: frozenset[str] = frozenset(),
    separator: str = "\t",
    unit: str = "",
    ordered: tuple[str, ...] = (),
) -> Mutant:
    """Mutate cells, columns, rows, times, separators or the header of a table.

    `used` are labels without which, or with NaN in which, it must be refused; `by_opensim` those that
    OpenSim asks for; `unit` is the entry of the data that tells the unit; columns of which the labels begin
    as those `ordered` must keep their order.
    """
    table = plain_table(original.decode(), separator)
    assert table is not None
    n_rows, n_columns = len(table.rows), len(table.labels)
    row, column = int(rng.integers(n_rows)), int(rng.integers(1, n_columns))
    label = table.labels[column]
    ways = [
        "cell: good number", "cell: no number", "cell: not finite", "cell empty", "cell more", "cut in a row",
        "time: other number", "time: no number", "time: not finite", "times shuffled", "times reversed",
        "time repeated", "row deleted", "row twice", "rows swapped", "column deleted", "columns swapped",
        "label renamed", "label twice", "label blank", "first label renamed", "decimal commas", "semicolons",
        "CRLF", "CR", "BOM", "blank lines", "padded cells", "trailing blanks",
    ]  # fmt: skip
    if separator != ",":
        ways += ["spaces for tabs", "commas for tabs", "mixed separators", "comments in the header", "unit",
                 "unit unknown", "counts wrong", "no endheader", "long header", "type wrong"]  # fmt: skip
    how = pick(rng, ways)
    new = copy.deepcopy(table)
    refused_by_opensim = REFUSE if label in by_opensim else ""

    def mutant(must: str, *, text: str | bytes | None = None, by: str = "", same: bool = True) -> Mutant:
        content = new.text(separator) if text is None else text
        content = content.encode() if isinstance(content, str) else content
        columns = new.columns()
        changes = None
        if same and columns is not None:
            found = {"time": columns.pop(new.labels[0]), **columns}
            changes = {name: found.get(name, GONE) for name in ("time", *table.labels[1:])}
            unusable = tuple(name for name in columns if not np.isfinite(columns[name]).all())
            changes |= {"unusable": unusable} if unusable else {}
        return Mutant(how=how, content=content, must=must, changes=changes, by_opensim=by, names=(label,))

    if how.startswith("cell:"):
        token = pick(rng, {"g": GOOD_NUMBERS, "n": NOT_FINITE}.get(how[6], NOT_FINITE))
        token = pick(rng, BAD_NUMBERS) if how == "cell: no number" else token
        new.rows[row][column] = token
        must = EITHER
        if plain_number(token) is None:
            must = REFUSE
        elif how == "cell: not finite":
            must = REFUSE if label in used else EITHER
        return mutant(must, by=refused_by_opensim if how == "cell: not finite" else "")
    if how == "cell empty":
        new.rows[row][column] = ""
        return mutant(REFUSE)
    if how == "cell more":
        new.rows[row].append("1")
        return mutant(REFUSE)
    if how == "cut in a row":
        lines = [*table.header, separator.join(table.labels)]
        lines += [separator.join(cells) for cells in table.rows[:row]]
        cut = int(rng.integers(1, n_columns))
        return mutant(REFUSE, text="\n".join([*lines, separator.join(table.rows[row][:cut])]))
    if how.startswith("time:"):
        tokens = {"time: other number": GOOD_NUMBERS, "time: no number": BAD_NUMBERS}.get(how, NOT_FINITE)
        new.rows[row][0] = pick(rng, tokens)
        columns = new.columns()
        time = None if columns is None else columns[new.labels[0]]
        is_good = time is not None and np.isfinite(time).all() and (np.diff(time) >= 0).all()
        return mutant(EITHER if is_good else REFUSE, same=is_good and bool((np.diff(time) > 0).all()))
    if how in ("times shuffled", "times reversed"):
        order = rng.permutation(n_rows) if how == "times shuffled" else np.arange(n_rows)[::-1]
        for target, source in zip(new.rows, order, strict=True):
            target[0] = table.rows[int(source)][0]
        return mutant(EITHER if (order == np.arange(n_rows)).all() else REFUSE)
    if how == "time repeated":
        new.rows[row][0] = table.rows[max(row - 1, 0)][0]
        return mutant(EITHER, same=row == 0)
    if how == "row deleted":
        del new.rows[row]
        return mutant(EITHER)
    if how == "row twice":
        new.rows.insert(row, list(table.rows[row]))
        found = mutant(EITHER if separator == "," else ACCEPT)
        return dataclasses.replace(found, changes={})
    if how == "rows swapped":
        if n_rows > 1:
            new.rows[0], new.rows[-1] = new.rows[-1], new.rows[0]
        return mutant(REFUSE)
    if how == "column deleted":
        del new.labels[column]
        for cells in new.rows:
            del cells[column]
        return mutant(REFUSE if label in used else EITHER, by=refused_by_opensim)
    if how == "columns swapped":
        order = [0, *(1 + rng.permutation(n_columns - 1))]
        new.labels = [table.labels[i] for i in order]
        new.rows = [[cells[i] for i in order] for cells in table.rows]
        triples = [[label for label in new.labels if label.startswith(start)] for start in ordered]
        return mutant(ACCEPT if all(triple == sorted(triple) for triple in triples) else REFUSE)
    if how == "label renamed":
        new.labels[column] = pick(rng, ("x" + label, label[::-1], "Zeit", "1.0", label.upper()))
        return mutant(REFUSE if label in used else EITHER, by=refused_by_opensim)
    if how == "label twice":
        new.labels[1 + (column % max(n_columns - 1, 1))] = label
        if n_columns == 2:
            new.labels.append(label)
            new.rows = [[*cells, cells[column]] for cells in table.rows]
        must = REFUSE if {label, *table.labels[1:]} <= used else EITHER
        return mutant(must if len(set(new.labels)) < len(new.labels) else EITHER, same=False)
    if how == "label blank":
        new.labels[column] = ""
        return mutant(REFUSE if label in used else EITHER, same=False, by=refused_by_opensim)
    if how == "first label renamed":
        new.labels[0] = pick(rng, ("frame", "t", "", "time2"))
        return mutant(REFUSE, same=False)
    if how == "decimal commas":
        new.rows = [[f"{float(cell):.3f}".replace(".", ",") for cell in cells] for cells in table.rows]
        return mutant(REFUSE, same=False)
    if how == "semicolons":
        return mutant(
            REFUSE, text=table.text(";") if separator == "," else ";".join(original.decode().split("\t"))
        )
    if how in ("CRLF", "CR"):
        end = "\r\n" if how == "CRLF" else "\r"
        return mutant(ACCEPT, text=table.text(separator, end))
    if how == "BOM":
        return mutant(ACCEPT, text=b"\xef\xbb\xbf" + original)
    if how == "blank lines":
        new.rows.insert(row, [""])
        text = new.text(separator) + "\n" * int(rng.integers(5))
        new.rows = copy.deepcopy(table.rows)
        return mutant(ACCEPT, text=text)
    if how == "padded cells":
        padded = copy.deepcopy(table)
        padded.rows = [[f" {cell}  " for cell in cells] for cells in table.rows]
        return mutant(ACCEPT, text=padded.text(separator))
    if how == "trailing blanks":
        return mutant(
            ACCEPT, text=table.text(separator, " \n") if separator == "," else table.text("\t", "\t\n")
        )
    if how in ("spaces for tabs", "commas for tabs"):
        return mutant(ACCEPT, text=table.text("  " if how[0] == "s" else ","))
    if how == "mixed separators":
        lines = [pick(rng, ("\t", " ", " \t ", ", ")).join(cells) for cells in table.rows]
        return mutant(ACCEPT, text="\n".join([*table.header, "\t".join(table.labels), *lines]) + "\n")
    if how == "comments in the header":
        new.header.insert(-1, "# a remark: nRows=3, endheader? no")
        return mutant(ACCEPT)
    if how == "unit":
        flipped = ["inDegrees=no" if line == "inDegrees=yes" else line for line in table.header]
        flipped = flipped if flipped != table.header else [
            "inDegrees=yes" if line == "inDegrees=no" else line for line in table.header
        ]  # fmt: skip
        new.header = flipped
        found = mutant(ACCEPT)
        now = "inDegrees=yes" in new.header
        return dataclasses.replace(found, changes={**(found.changes or {}), **({unit: now} if unit else {})})
    if how == "unit unknown":
        new.header = [re.sub("inDegrees=.*", "inDegrees=maybe", line) for line in table.header]
        return mutant(REFUSE)
    if how == "counts wrong":
        wrong = pick(rng, ("0", "-1", "99999999999", "nan", ""))
        new.header = [re.sub("(nRows|nColumns)=.*", rf"\1={wrong}", line) for line in table.header]
        return mutant(ACCEPT)
    if how == "no endheader":
        new.header = [line for line in table.header if line != "endheader"]
        return mutant(REFUSE, same=False)
    if how == "long header":
        new.header.insert(1, pick(rng, ("x", "a = ", "# ")) * int(rng.integers(1, 100_000)))
        return mutant(ACCEPT)
    new.header.insert(1, "DataType=Vec3")
    return mutant(REFUSE)


# XML ---------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, kw_only=True)
class XmlRules:
    """What is read of an XML file: kinds and data entries of its leaves, elements that it needs.

    A file that is `lenient` is read by OpenSim, which takes more than the XML standard does.
    """

    leaves: Mapping[str, tuple[str, str]]
    needed: frozenset[str]
    own_name: str
    lenient: bool = False
    by_opensim: frozenset[str] = frozenset()


FLAGS = {"TRUE": True, "False": False, "1": True, "0": False, " true ": True, "false": False}
BAD_FLAGS = ("yes", "2", "maybe", "tru", "-1", "on")
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'


def of_xml(rng: np.random.Generator, original: bytes, rules: XmlRules) -> Mutant:
    """Mutate leaves, structure or syntax of an XML file."""
    broken = EITHER if rules.lenient else REFUSE
    how = pick(rng, ("leaf",) * 12 + (
        "element deleted", "element renamed", "leaf twice", "element twice", "elements in another order",
        "nested deeper", "other root", "unclosed", "bare ampersand", "bare bracket", "entities", "comments",
        "padded leaves", "CRLF", "BOM", "one line", "CDATA", "character references", "Latin-1", "UTF-16",
        "text behind the end", "attribute twice", "long comment", "long text", "cut in a tag",
    ))  # fmt: skip
    text = original.decode()
    if how == "leaf":
        return _of_leaf(rng, text, rules)
    if how in ("element deleted", "element renamed", "leaf twice", "element twice"):
        root = ElementTree.fromstring(original)
        pairs = [(parent, child) for parent in root.iter() for child in parent]
        if how == "leaf twice":
            pairs = [(p, c) for p, c in pairs if not len(c) and c.tag in rules.leaves]
        parent, child = pick(rng, pairs)
        tag = child.tag
        if how == "element deleted":
            parent.remove(child)
        elif how == "element renamed":
            child.tag = pick(rng, (tag + "s", tag[:-1] or "x", tag.lower() + "_", "Thing"))
        else:
            parent.insert(list(parent).index(child), copy.deepcopy(child))
        must, by = EITHER, ""
        if how in ("element deleted", "element renamed"):
            must = REFUSE if tag in rules.needed else EITHER
            by = REFUSE if tag in rules.by_opensim else ""
        elif how == "leaf twice":
            must = ACCEPT
        changes = {} if how == "leaf twice" else None
        return Mutant(how=how, content=ElementTree.tostring(root), must=must, changes=changes, names=(tag,),
                      by_opensim=by)  # fmt: skip
    if how == "elements in another order":
        root = ElementTree.fromstring(original)
        parent = pick(rng, [element for element in root.iter() if len(element) > 1] or [root])
        parent[:] = [parent[int(i)] for i in rng.permutation(len(parent))]
        return Mutant(how=how, content=ElementTree.tostring(root), must=ACCEPT, changes={}, by_opensim=EITHER)
    must, changes, by = broken, None, ""
    content: str | bytes = text
    first = text.index("<OpenSimDocument")
    if how == "nested deeper":
        depth = int(rng.integers(2, 500))
        content, must = f"{text[:first]}{'<a>' * depth}{text[first:]}{'</a>' * depth}", REFUSE
    elif how == "other root":
        content, must = "<Thing><other>1</other></Thing>", REFUSE
    elif how == "unclosed":
        tags = list(re.finditer(r"</[^>]*>", text))
        tag = pick(rng, tags)
        content = text[: tag.start()] + text[tag.end() :]
    elif how in ("bare ampersand", "bare bracket"):
        place = pick(rng, list(re.finditer(r"</", text))).start()
        content = text[:place] + (" & " if how == "bare ampersand" else " < ") + text[place:]
    elif how == "entities":
        content, must = text[:first] + BOMB + text[first:], REFUSE
    elif how in ("comments", "long comment"):
        place = pick(rng, list(re.finditer(r">\s*<", text))[1:]).start() + 1
        inside = "<a> -- </b> --" if how == "comments" else "x" * int(rng.integers(1000, 1_000_000))
        content, must, changes = f"{text[:place]}<!-- {inside} -->{text[place:]}", ACCEPT, {}
    elif how == "padded leaves":
        content = re.sub(r">([^<>\s][^<>]*)</", r"> \n\t\1 </", text)
        must, changes = ACCEPT, {}
    elif how == "CRLF":
        content, must, changes = text.replace("\n", "\r\n"), ACCEPT, {}
    elif how == "BOM":
        content, must, changes = b"\xef\xbb\xbf" + original, ACCEPT, {}
    elif how == "one line":
        content, must, changes = re.sub(r">\s+<", "><", text), ACCEPT, {}
    elif how == "CDATA":
        content = re.sub(r">([^<>\s][^<>]*)</", r"><![CDATA[\1]]></", text, count=int(rng.integers(1, 5)))
        must, changes, by = ACCEPT, {}, EITHER
    elif how == "character references":
        content = re.sub(r">([a-z])([^<>]*)</", lambda m: f">&#{ord(m[1])};{m[2]}</", text)
        must, changes, by = ACCEPT, {}, EITHER
    elif how == "Latin-1":
        body = text[first:].replace("<OpenSimDocument", "<!-- é --><OpenSimDocument", 1)
        content = ('<?xml version="1.0" encoding="ISO-8859-1"?>\n' + body).encode("latin-1")
        must, changes, by = ACCEPT, {}, EITHER
    elif how == "UTF-16":
        content = ('<?xml version="1.0" encoding="UTF-16"?>\n' + text[first:]).encode("utf-16")
        must, changes = EITHER, {}
    elif how == "text behind the end":
        content = text + pick(rng, ("x", "<a/>", "</a>"))
    elif how == "attribute twice":
        content = re.sub(r' name="', ' name="a" name="', text, count=1)
    elif how == "long text":
        leaf = pick(rng, list(re.finditer(r">[^<>\s][^<>]*</", text)))
        content = text[: leaf.end() - 2] + "x" * int(rng.integers(1000, 100_000)) + text[leaf.end() - 2 :]
        must = EITHER
    else:
        tag = pick(rng, list(re.finditer(r"<[^>]*>", text)))
        content = text[: int(rng.integers(tag.start() + 1, tag.end()))]
    content = content.encode() if isinstance(content, str) else content
    return Mutant(how=how, content=content, must=must, changes=changes, by_opensim=by)


def _of_leaf(rng: np.random.Generator, text: str, rules: XmlRules) -> Mutant:
    """Give one leaf that is read another text."""
    leaves = [m for m in re.finditer(r"<(\w+)>([^<>]*)</\1>|<(\w+) />", text)
              if (m[1] or m[3]) in rules.leaves]  # fmt: skip
    leaf = pick(rng, leaves)
    tag, old = leaf[1] or leaf[3], leaf[2] or ""
    kind, key = rules.leaves[tag]
    must, changes, by = EITHER, None, ""
    if kind in ("number", "whole", "physical"):
        how = pick(rng, ("good number", "no number", "not finite", "empty"))
        token = {"good number": pick(rng, GOOD_NUMBERS), "no number": pick(rng, BAD_NUMBERS),
                 "not finite": pick(rng, NOT_FINITE)}.get(how, "")  # fmt: skip
        number = plain_number(token)
        is_wrong = number is not None and (
            math.isnan(number) or (kind == "whole" and number != np.round(number))
        )
        if (token and number is None) or is_wrong:
            must = REFUSE
        elif how == "good number" and key:
            changes = {key: number}
        if kind == "physical":
            by = REFUSE if how in ("no number", "not finite") and not math.isinf(number or 0.0) else EITHER
            must, changes = EITHER, {}
    elif kind == "flag":
        token = pick(rng, (*FLAGS, *BAD_FLAGS))
        how = "flag" if token in FLAGS else "no flag"
        must = EITHER if token in FLAGS else REFUSE
        changes = {key: FLAGS[token]} if key and token in FLAGS else None
    elif kind == "path":
        how = pick(rng, ("path missing", "path to a folder", "path to another kind", "path to itself",
                         "path with ./", "path with backslash", "path padded", "path with text"))  # fmt: skip
        token = {
            "path missing": f"nowhere/{old}",
            "path to a folder": ".",
            "path to another kind": "README.md",
            "path to itself": rules.own_name,
            "path with ./": f"./././{old}",
            "path with backslash": f".\\{old}",
            "path padded": f"\n  {old}\t",
            "path with text": pick(rng, ("a b", "\\\\server\\x", "C:\\x", "é")),
        }[how]
        must = ACCEPT if how in ("path with ./", "path with backslash", "path padded") and old else REFUSE
        must = EITHER if how in ("path with ./", "path padded") and not old else must
        changes = {} if must == ACCEPT else None
    else:
        how = "name"
        token = pick(rng, ("", "nobody", old + "x", old.upper(), "/" + old, "a b"))
        must = REFUSE if kind == "needed name" and token in ("nobody", old + "x") else EITHER
        by = REFUSE if kind in ("name", "needed name") and token in ("nobody", old + "x") else ""
    content = text[: leaf.start()] + f"<{tag}>{token}</{tag}>" + text[leaf.end() :]
    return Mutant(how=f"leaf: {how}", content=content.encode(), must=must, changes=changes, by_opensim=by,
                  names=(tag,))  # fmt: skip


# Trees: TOML and JSON -----------------------------------------------------------------------------------

VALUES: dict[str, tuple[Any, ...]] = {
    "text": ("", "abc", "nan", "1.0", "ä b", "*", "a=b", "../..", "x" * 100),
    "number": (0, -1, 3, 2.5, -0.25, 1e300, 1e-300, 4.0),
    "not finite": (math.nan, math.inf, -math.inf),
    "huge": (10**30, -(10**25), 10**320),
    "flag": (True, False),
    "list": ([], ["a"], [1.0], ["a", 1], [[["a"]]], ["a", "a"], [""]),
    "table": ({}, {"a": 1.0}, {"a": "b"}, {"a": {"b": 1}}, {"": 1.0}),
}
Path = tuple[Any, ...]
#: From what was done, where, and the new value, to what must become of it and how the data change.
TreeRule = Callable[[str, Path, Any], tuple[str, Mapping[str, Any] | None]]


def _paths(tree: Any, path: Path = ()) -> list[Path]:
    here = [path] if path else []
    if isinstance(tree, dict):
        return here + [p for key, value in tree.items() for p in _paths(value, (*path, key))]
    if isinstance(tree, list):
        return here + [p for i, value in enumerate(tree[:3]) for p in _paths(value, (*path, i))]
    return here


def value_at(tree: Any, path: Path) -> Any:
    """Follow keys and positions."""
    for step in path:
        tree = tree[step]
    return tree


def of_tree(rng: np.random.Generator, tree: Any, write: Callable[[Any], str], rule: TreeRule) -> Mutant:
    """Mutate keys and values of nested tables and lists."""
    new = copy.deepcopy(tree)
    path = pick(rng, _paths(tree))
    parent, step = value_at(new, path[:-1]), path[-1]
    how = pick(rng, ("other value",) * 6 + ("renamed", "deleted", "one deeper", "entry twice", "new key",
                                            "another order"))  # fmt: skip
    value: Any = None
    if how == "other value":
        family = pick(rng, VALUES)
        value = copy.deepcopy(pick(rng, VALUES[family]))
        parent[step] = value
        how = f"value: {family}"
    elif how == "deleted":
        del parent[step]
    elif how == "one deeper":
        value = pick(rng, ([parent[step]], {"inner": parent[step]}))
        parent[step] = value
    elif how == "another order" and isinstance(parent, dict):
        keys = list(parent)
        items = {keys[int(i)]: parent[keys[int(i)]] for i in rng.permutation(len(keys))}
        parent.clear()
        parent.update(items)
    elif how == "entry twice" and isinstance(parent, list):
        parent.insert(step, parent[step])
    elif isinstance(parent, dict) and how in ("renamed", "new key"):
        name = pick(rng, (f"{step}s", str(step)[:-1] or "x", str(step).upper() + "_", "thing", "", "a.b"))
        value = name
        if name in parent:
            how = "nothing"
        elif how == "renamed":
            items = {name if key == step else key: entry for key, entry in parent.items()}
            parent.clear()
            parent.update(items)
        else:
            parent[name] = pick(rng, (1, "a", [], {}))
    else:
        how = "nothing"
    must, changes = (ACCEPT, {}) if how == "nothing" else rule(how, path, value)
    return Mutant(how=how, content=write(new).encode(), must=must, changes=changes,
                  names=tuple(str(key) for key in path if isinstance(key, str)))  # fmt: skip


def toml(tree: Mapping[str, Any]) -> str:
    """Write a table with inline tables inside."""
    return "".join(f"{_toml_key(key)} = {_toml_value(value)}\n" for key, value in tree.items())


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)


def _toml_value(value: Any) -> str:
    if isinstance(value, dict):
        return (
            "{" + ", ".join(f"{json.dumps(key)} = {_toml_value(entry)}" for key, entry in value.items()) + "}"
        )
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value)


def of_toml_text(rng: np.random.Generator, original: bytes) -> Mutant:
    """Mutate the syntax of a TOML file of lines `key = value`."""
    lines = original.decode().splitlines()
    at = int(rng.integers(len(lines)))
    how = pick(rng, (
        "CRLF", "BOM", "comments", "blanks", "another order", "key twice", "unclosed text", "no value",
        "no key", "bare word", "deep list", "CR", "long comment", "colon", "cut in a line", "date",
    ))  # fmt: skip
    must, changes = ACCEPT, {}
    text: str | bytes = original
    if how == "CRLF":
        text = "\r\n".join(lines) + "\r\n"
    elif how == "BOM":
        text = b"\xef\xbb\xbf" + original
    elif how == "comments":
        text = "\n".join(["# é = 1", *(f"{line}  # remark" for line in lines)])
    elif how == "long comment":
        lines.insert(at, "# " + "x" * int(rng.integers(1000, 1_000_000)))
        text = "\n".join(lines)
    elif how == "blanks":
        text = "\n\n".join(f"  {line.replace(' = ', '  =   ', 1)}\t" for line in lines)
    elif how == "another order":
        text = "\n".join(lines[int(i)] for i in rng.permutation(len(lines)))
    else:
        must, changes = REFUSE, None
        key = lines[at].split(" = ")[0]
        lines[at] = {
            "key twice": f"{lines[at]}\n{lines[at]}",
            "unclosed text": f'{key} = "abc',
            "no value": f"{key} =",
            "no key": "= 3",
            "bare word": f"{key} = word",
            "deep list": f"{key} = {'[' * int(rng.integers(2, 200))}",
            "CR": lines[at].replace(" = ", " = \r"),
            "colon": lines[at].replace(" = ", ": "),
            "cut in a line": lines[at][: len(key) + 2],
            "date": f"{key} = 1979-05-27",
        }[how]
        text = "\n".join(lines[: at + 1] if how == "cut in a line" else lines)
    return Mutant(
        how=how, content=text.encode() if isinstance(text, str) else text, must=must, changes=changes
    )
