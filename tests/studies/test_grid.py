"""Grids: options with several values, combinations with names, and none that has no effect."""

import pytest

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.studies.grid import alternatives, checked_grid, conditions


@pytest.mark.parametrize(
    ("name", "text", "values"),
    [
        ("q", "3,5,10", [3.0, 5.0, 10.0]),
        ("q", "a=3,b=4", [{"a": 3.0, "b": 4.0}]),
        ("q", "a=3,b=4; 5", [{"a": 3.0, "b": 4.0}, 5.0]),
        ("stability", "off, full", ["off", "full"]),
        ("joints", "knee_r,ankle_r", [("knee_r", "ankle_r")]),
        ("joints", "knee_r;knee_r,ankle_r", [("knee_r",), ("knee_r", "ankle_r")]),
        ("weights", "volume,pcsa", ["volume", "pcsa"]),
        ("max_iterations", "100,200", [100, 200]),
    ],
)
def test_an_option_may_hold_several_values(name, text, values):
    assert alternatives(name, text) == values


def test_a_value_that_is_none_is_said_by_itself():
    with pytest.raises(DataError, match="stability is 'fulll', expected"):
        alternatives("stability", "off,fulll")
    with pytest.raises(DataError, match="q is 'many', expected a number"):
        alternatives("q", "many")


def test_every_combination_has_a_name_and_is_there_once():
    found = conditions({"q": [3.0, 5.0], "stability": ["off", "diagonal", "potvin-brown"]})
    assert found == (
        ("off", {"stability": "off"}),
        ("diagonal_q=3", {"stability": "diagonal", "q": 3.0}),
        ("diagonal_q=5", {"stability": "diagonal", "q": 5.0}),
        ("potvin-brown_q=3", {"stability": "potvin-brown", "q": 3.0}),
        ("potvin-brown_q=5", {"stability": "potvin-brown", "q": 5.0}),
    )


def test_a_setting_that_only_one_method_has_stands_with_that_method():
    found = conditions({"stability": ["potvin-brown", "full"], "axes": [("x",), ("x", "z")]})
    assert [name for name, _ in found] == ["potvin-brown_axes=x", "potvin-brown_axes=x+z", "full"]


def test_names_tell_tables_flags_and_lists():
    names = [
        conditions({name: [value]})[0][0]
        for name, value in (
            ("q", {"soleus_*": 7.5}),
            ("activation_dynamics", True),
            ("joints", ("knee_r", "hip_r")),
            ("exponent", float("inf")),
        )
    ]
    assert names == ["q=soleus_*=7.5", "activation_dynamics=true", "joints=knee_r+hip_r", "exponent=inf"]


def test_an_empty_grid_is_one_condition_without_a_name():
    assert conditions({}) == (("", {}),)


@pytest.mark.parametrize(
    ("grid", "kind", "words"),
    [
        ({"Q": [3]}, NameMismatchError, r"unknown setting 'Q'"),
        ({"q": 3}, DataError, "the grid's q is 3, expected a list of values"),
        ({"q": "3,5"}, DataError, "the grid's q is '3,5', expected a list of values"),
        ({"q": []}, DataError, r"the grid's q is \[\], expected a list of values"),
        ({"q": [3, "x"]}, DataError, "q is 'x', expected a number"),
        ({"q": [3, 3.0]}, DataError, "the grid's q holds a value twice"),
    ],
)
def test_a_grid_that_is_none_is_refused(tmp_path, grid, kind, words):
    with pytest.raises(kind, match=words):
        checked_grid(grid, "here", tmp_path)
