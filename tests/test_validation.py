"""Names and patterns of names: what they stand for, and what is said of those that are not there."""

import numpy as np
import pytest

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.validation import by_name, matches, nearest, read_only, read_only_flags, read_only_integers

MUSCLES = ("soleus_r", "soleus_l", "psoas_r", "odd[1]", "star*")


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("soleus_l", [1]),
        ("soleus_*", [0, 1]),
        ("*_r", [0, 2]),
        ("soleus_?", [0, 1]),
        ("[ps]o*_[!l]", [0]),
        # a name is itself, whatever signs it holds
        ("odd[1]", [3]),
        ("star*", [4]),
        ("*", [0, 1, 2, 3, 4]),
    ],
)
def test_a_pattern_stands_for_the_names_it_fits_in_their_order(pattern, expected):
    assert matches("muscle", pattern, MUSCLES).tolist() == expected


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("soleus", r"unknown muscle 'soleus' \(closest: soleus_r, soleus_l\)"),
        ("SOLEUS_*", r"pattern 'SOLEUS_\*' fits no muscle \(available: soleus_r, "),
        ("soles_*", r"pattern 'soles_\*' fits no muscle \(closest: soleus_"),
        ("vas?", r"pattern 'vas\?' fits no muscle"),
    ],
)
def test_what_fits_nothing_is_refused_with_a_hint(pattern, message):
    with pytest.raises(NameMismatchError, match=message):
        matches("muscle", pattern, MUSCLES)
    with pytest.raises(NameMismatchError, match=message):
        by_name("muscle", {"*": 1.0, pattern: 2.0}, MUSCLES)


def test_later_entries_win_and_the_rest_gets_the_default():
    found = by_name("muscle", {"soleus_*": 2.0, "soleus_l": 3.0}, MUSCLES, default=1.0)
    assert found.tolist() == [2, 3, 1, 1, 1]
    assert by_name("muscle", {"soleus_l": 3.0, "soleus_*": 2.0}, MUSCLES)[:2].tolist() == [2, 2]
    assert np.isnan(by_name("muscle", {}, MUSCLES)).all()


def test_a_hint_names_three_at_most_or_the_first_twelve():
    assert nearest("m1", [f"m{i}" for i in range(20)]).count(",") == 2
    assert nearest("tibialis", [f"m{i}" for i in range(20)]) == "available: " + ", ".join(
        f"m{i}" for i in range(12)
    )


@pytest.mark.parametrize(
    "values", [[1, 2], (1.0, 2.0), np.array([1, 2], dtype=object), np.array([1, 2], np.float32)]
)
def test_numbers_of_any_kind_are_numbers(values):
    assert read_only("x", values, (2,), "n").tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.array([1 + 1j, 2]), r"x cannot be read as numbers: found .*1\+1j"),
        (np.array(["2020-01-01", "2020-01-02"], dtype="datetime64[D]"), "x cannot be read as numbers: found"),
        (["1.5", "2.5"], "x cannot be read as numbers: found .*'1.5'"),
        ([1.0, None], "x cannot be read as numbers"),
        ([[1.0], [1.0, 2.0]], "x cannot be read as numbers: its rows differ in length"),
        (np.ma.array([1.0, 2.0], mask=[False, True]), "x has masked entries"),
    ],
)
def test_what_is_no_real_number_is_refused_even_where_gaps_are_allowed(values, message):
    with pytest.raises(DataError, match=message):
        read_only("x", values, (2,), "n", finite=False)


def test_whole_numbers_are_not_cut():
    assert read_only_integers("x", [0.0, 2.0], (2,), "n", least=-1, below=3).tolist() == [0, 2]
    for values in ([0.5, 1], [0, 3], [-2, 0], [np.nan, 0]):
        with pytest.raises(DataError, match=r"x is .* at index \(.\,\) of \(n\), expected"):
            read_only_integers("x", values, (2,), "n", least=-1, below=3)


def test_only_true_and_false_are_flags():
    assert read_only_flags("x", [1, False], (2,), "n").tolist() == [True, False]
    for values in ([0.5, 1], [np.nan, 0], ["yes", "no"]):
        with pytest.raises(DataError, match=r"^x "):
            read_only_flags("x", values, (2,), "n")


def test_what_nobody_can_write_to_is_taken_as_it_is_and_all_else_is_copied():
    """Motions of hundreds of megabytes are in memory once."""
    mine = np.arange(6.0)
    first = read_only("x", mine, (-1,), "n")
    mine[0] = 7.0
    assert first[0] == 0.0
    assert read_only("x", first, (-1,), "n") is first
    part = read_only("x", first[1:3], (-1,), "n")  # a view would keep all of it alive
    assert part.flags.owndata
    assert read_only("x", np.asfortranarray(np.ones((2, 3))), (2, 3), "n, m").flags.c_contiguous
    few = read_only_integers("i", np.array([3, 1], dtype=np.int16), (-1,), "n", least=0, below=4)
    assert few.dtype == np.int16
    assert read_only_integers("i", few, (-1,), "n", least=0, below=4) is few
    with pytest.raises(DataError, match="i is 3 at index"):
        read_only_integers("i", few, (-1,), "n", least=0, below=3)
    flags = read_only_flags("f", [1, 0], (-1,), "n")
    assert read_only_flags("f", flags, (-1,), "n") is flags
