"""Names and patterns of names: what they stand for, and what is said of those that are not there."""

import numpy as np
import pytest

from scso_nlp.exceptions import NameMismatchError
from scso_nlp.validation import by_name, matches, nearest

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
