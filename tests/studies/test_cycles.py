"""Curves over a cycle, against functions whose values are known."""

import numpy as np
import pytest

from scso_nlp.figures.series import Series
from scso_nlp.studies.cycles import POINTS, cut_curves
from scso_nlp.studies.events import Events

TIME = np.linspace(0.0, 3.0, 3001)


def series(names=("m_r", "m_l", "trunk"), **more):
    values = np.column_stack([np.sin(2 * np.pi * TIME) + i for i in range(len(names))])
    return Series(**{"label": "run", "time": TIME, "names": names, "values": values, "units": ("-",), **more})


def events(rule="ground reaction", **times):
    return Events(rule=rule, times={side: np.array(found) for side, found in times.items()})


def test_a_sine_between_given_events_is_a_cosine_over_each_cycle():
    """Interpolation in straight lines over 1 ms is off by at most (2π)² / 8e6 = 5e-6."""
    found = cut_curves(
        "activation", series(("m",)), Events(rule="given", times={"": np.array([0.25, 1.25, 2.25])})
    )
    assert [(curve.cycle, curve.start, curve.stop) for curve in found] == [(1, 0.25, 1.25), (2, 1.25, 2.25)]
    for curve in found:
        np.testing.assert_allclose(curve.values, np.cos(2 * np.pi * np.arange(101) / 100), atol=6e-6)


def test_sides_have_the_cycles_of_their_own_foot_and_the_trunk_the_right_ones():
    found = cut_curves("activation", series(), events(right=[0.0, 1.0, 2.0], left=[0.5, 1.5]))
    assert {(curve.name, curve.foot, curve.start) for curve in found} == {
        ("m_r", "right", 0.0), ("m_r", "right", 1.0), ("m_l", "left", 0.5),
        ("trunk", "right", 0.0), ("trunk", "right", 1.0),
    }  # fmt: skip
    first = {curve.name: curve.values[0] for curve in found if curve.cycle == 1}
    assert first["m_l"] == pytest.approx(np.sin(np.pi) + 1)


def test_a_side_without_a_whole_cycle_has_no_curve():
    found = cut_curves("activation", series(), events(right=[0.0, 1.0], left=[0.5]))
    assert {curve.name for curve in found} == {"m_r", "trunk"}


def test_frames_that_are_not_solved_leave_gaps():
    one = series(("m",))
    values = one.values.copy()
    values[(TIME > 0.5) & (TIME < 0.6)] = np.nan
    (curve,) = cut_curves("activation", series(("m",), values=values), events("given", **{"": [0.0, 1.0]}))
    assert np.isnan(curve.values[51:60]).all()
    assert np.isfinite(curve.values[:50]).all()
    assert np.isfinite(curve.values[61:]).all()


def test_tasks_have_no_cycle():
    assert cut_curves("activation", series(("m",), are_tasks=True), events("given", **{"": [0.0, 1.0]})) == []


def test_the_columns_of_tables_are_named_by_per_cent():
    assert (len(POINTS), POINTS[0], POINTS[50], POINTS[-1]) == (101, "p0", "p50", "p100")
