"""Means, spreads and intervals of made-up people, worked out by hand."""

import numpy as np
import pandas as pd
import pytest

from scso_nlp.studies.cycles import POINTS
from scso_nlp.studies.statistics import mean_curves, mean_numbers, paired_differences, varying

#: Of A two trials, of B and C one; "stiff" is greater by 1, 3, 4 and 6.
VALUES = [("A", "1", 10.0, 11.0), ("A", "2", 20.0, 23.0), ("B", "1", 30.0, 34.0), ("C", "1", 50.0, 56.0)]


def table(values=VALUES, conditions=("off", "stiff")):
    rows = [
        (subject, trial, condition, "force", "soleus", "peak", value, "N")
        for subject, trial, *both in values
        for condition, value in zip(conditions, both, strict=True)
    ]
    names = ["subject", "trial", "condition", "quantity", "name", "statistic", "value", "unit"]
    return pd.DataFrame(rows, columns=names)


def test_a_person_with_many_trials_weighs_as_one():
    """People's means are 15, 30 and 50."""
    found = mean_numbers(table()).set_index("condition").loc["off"]
    assert found["mean"] == pytest.approx(95 / 3)
    assert found["sd"] == pytest.approx(np.std([15, 30, 50], ddof=1))
    assert (found["people"], found["trials"]) == (3, 4)


def test_paired_differences_have_the_interval_of_student():
    """People differ by 2, 4 and 6: mean 4, sd 2, and t of 0.975 with 2 degrees of freedom is 4.30265."""
    (found,) = paired_differences(table(), "off").to_dict("records")
    assert (found["condition"], found["reference"]) == ("stiff", "off")
    assert found["mean"] == pytest.approx(4.0)
    assert found["sd"] == pytest.approx(2.0)
    assert found["reference_mean"] == pytest.approx(95 / 3)
    half = 4.302653 * 2 / np.sqrt(3)
    assert [found["low"], found["high"]] == pytest.approx([4 - half, 4 + half], rel=1e-6)


def test_the_other_way_round_the_sign_changes():
    (found,) = paired_differences(table(), "stiff").to_dict("records")
    assert (found["condition"], found["mean"]) == ("off", pytest.approx(-4.0))


def test_constant_differences_have_an_interval_without_width():
    (found,) = paired_differences(table([("A", "1", 1.0, 3.0), ("B", "1", 5.0, 7.0)]), "off").to_dict(
        "records"
    )
    assert (found["mean"], found["low"], found["high"]) == (2.0, 2.0, 2.0)


def test_of_one_person_there_is_no_interval():
    (found,) = paired_differences(table(VALUES[:2]), "off").to_dict("records")
    assert found["mean"] == pytest.approx(2.0)
    assert (found["people"], found["trials"]) == (1, 2)
    assert np.isnan([found["sd"], found["low"], found["high"]]).all()


def test_only_trials_that_have_both_conditions_count():
    both = table()
    lacking = both[~((both["subject"] == "C") & (both["condition"] == "off"))]
    (found,) = paired_differences(lacking, "off").to_dict("records")
    assert (found["people"], found["mean"]) == (2, pytest.approx(3.0))


def cycles(values):
    """Constant curves by subject, trial and cycle."""
    rows = [(*keys, "off", "activation", "m", "-", "", cycle, 0.0, 1.0) for *keys, cycle, _ in values]
    about = ["subject", "trial", "condition", "quantity", "name", "unit", "foot", "cycle", "start", "stop"]
    points = np.repeat([[float(value)] for *_, value in values] or np.zeros((0, 1)), len(POINTS), axis=1)
    return pd.concat([pd.DataFrame(rows, columns=about), pd.DataFrame(points, columns=list(POINTS))], axis=1)


@pytest.mark.parametrize(
    ("values", "over", "mean", "sd"),
    [
        # trials of A: 2 and 6, so A is 4; B is 10
        ([("A", "1", 1, 1), ("A", "1", 2, 3), ("A", "2", 1, 6), ("B", "1", 1, 10)], "people", 7, np.sqrt(18)),
        ([("A", "1", 1, 1), ("A", "1", 2, 3), ("A", "2", 1, 6)], "trials", 4, np.sqrt(8)),
        ([("A", "1", 1, 1), ("A", "1", 2, 3)], "cycles", 2, np.sqrt(2)),
        ([("A", "1", 1, 1)], "cycles", 1, np.nan),
    ],
)
def test_curves_are_averaged_over_cycles_then_trials_then_people(values, over, mean, sd):
    assert varying(cycles(values)) == over
    found = mean_curves(cycles(values)).set_index("measure")
    assert set(found["over"]) == {over}
    np.testing.assert_allclose(found.loc["mean", list(POINTS)].astype(float), mean)
    np.testing.assert_allclose(found.loc["sd", list(POINTS)].astype(float), sd)


def test_a_gap_in_one_cycle_leaves_the_others():
    found = cycles([("A", "1", 1, 1), ("A", "1", 2, 3)])
    found.loc[0, "p10"] = np.nan
    means = mean_curves(found).set_index("measure").loc["mean"]
    assert (means["p10"], means["p11"]) == (3.0, 2.0)


def test_nothing_has_no_curves():
    assert len(mean_curves(cycles([]))) == 0
