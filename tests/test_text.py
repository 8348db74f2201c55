"""Numbers in text, and values in messages."""

import math

import numpy as np
import pytest

from scso_nlp.text import number, printable, shown


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1.5", 1.5),
        (" -.5e-3\n", -0.0005),
        ("007", 7.0),
        ("5.", 5.0),
        ("-Inf", -math.inf),
    ],
)
def test_numbers_are_read_as_other_programs_write_them(text, value):
    assert number(text) == value


@pytest.mark.parametrize(
    "text", ["", "1_0", "१", "0x10", "1,5", "1.2.3", "1e", "nan(7)", "1 2", "True", "1e400", "9" * 400]
)
def test_what_no_other_program_takes_for_a_number_is_none(text):
    with pytest.raises(ValueError, match="is not a number"):
        number(text)


def test_long_values_are_cut_where_they_are_shown():
    assert shown("soleus") == "'soleus'"
    assert len(shown("x" * 10_000)) <= 62
    assert len(shown(10**1000)) <= 62
    assert len(shown([["x" * 50] * 6] * 6)) <= 123


@pytest.mark.parametrize(
    ("array", "text"),
    [
        (np.array(["a", "b"]), "an array of text of shape (2,)"),
        (np.array([[1j]]), "an array of complex numbers of shape (1, 1)"),
        (
            np.ma.array([1.0, 2.0], mask=[True, False]),
            "an array of numbers of shape (2,) with masked entries",
        ),
    ],
)
def test_of_arrays_it_is_said_what_they_hold(array, text):
    assert shown(array) == text


def test_control_characters_do_not_reach_the_terminal():
    assert printable("knee\x1b[31m_r\r\nürgh\x07") == "knee\\x1b[31m_r\\r\nürgh\\x07"
