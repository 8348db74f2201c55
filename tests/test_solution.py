"""Looking things up in a solution: muscles by name, tables, figures."""

import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from solution_by_hand import ARM, OPTIMAL_FORCE, STRENGTH, solution_by_hand

import scso_nlp as scso
from scso_nlp.exceptions import NameMismatchError, ScsoError


def test_a_muscle_is_looked_up_by_name():
    solution = solution_by_hand(n_pairs=2, failed=(1,))
    muscle = solution["back_1"]
    assert isinstance(muscle, scso.MuscleResult)
    solved = [0, 2, 3, 4]
    np.testing.assert_array_equal(muscle.time, [0, 0.25, 0.5, 0.75, 1])
    np.testing.assert_array_equal(muscle.activation[solved], solution.activation[solved, 3])
    np.testing.assert_allclose(muscle.tendon_force[solved], STRENGTH * muscle.activation[solved])
    np.testing.assert_allclose(muscle.muscle_tendon_length[solved], 2 * ARM)
    assert np.isnan([muscle.activation[1], muscle.tendon_force[1]]).all()
    assert (muscle.excitation, muscle.fiber_length, muscle.tendon_strain) == (None, None, None)
    assert repr(solution_by_hand()["front_0"]) == (
        "front_0: 5 frames, activation 0.05 to 0.14, tendon force up to 140 N at t = 0.75 s"
    )
    assert repr(solution_by_hand(failed=range(5))["front_0"]) == "front_0: 5 frames, none solved"


def test_a_wrong_name_suggests_the_nearest():
    with pytest.raises(NameMismatchError, match=r"unknown muscle 'fron_0' \(closest: front_0"):
        solution_by_hand()["fron_0"]


@pytest.mark.parametrize(
    ("quantity", "columns", "unit", "expected"),
    [
        # at t = 0.25 s 4.5 N·m ask for 90 N of the back muscle above the tonus of 50 N
        ("activation", ["front_0", "back_0"], ["-", "-"], [0.05, 0.14]),
        ("force", ["front_0", "back_0"], ["N", "N"], [50.0, 140.0]),
        ("control", ["hinge_0_reserve"], ["-"], [0.5 / OPTIMAL_FORCE]),
        ("actuator_force", ["hinge_0_reserve"], ["N or N·m"], [0.5]),
        ("stability", ["hinge_0_z"], ["N·m/rad"], [19.0]),
        ("margin", ["hinge_0_z"], ["N·m/rad"], [9.0]),
        (
            "moments",
            [("hinge_0", "required"), ("hinge_0", "muscles"), ("hinge_0", "actuators")],
            ["N·m"] * 3,
            [5.0, 4.5, 0.5],
        ),
        (
            "rows",
            [("MomentEquilibrium", "hinge_0"), ("JointStability", "hinge_0_z")],
            ["N·m", "N·m/rad"],
            [0.0, 19.0],
        ),
    ],
)
def test_every_quantity_is_a_table_with_times_names_and_units(quantity, columns, unit, expected):
    frame = solution_by_hand(failed=(3,)).to_dataframe(quantity)
    assert frame.index.name == "time"
    assert list(frame.index) == [0, 0.25, 0.5, 0.75, 1]
    assert list(frame.columns) == columns
    assert list(frame.attrs["units"].values()) == unit
    np.testing.assert_allclose(frame.loc[0.25], expected, atol=1e-12)
    assert frame.loc[0.75].isna().all()


def test_a_quantity_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(NameMismatchError, match=r"has no 'activatio' \(closest: activation"):
        solution_by_hand().to_dataframe("activatio")
    for missing in ("excitation", "fiber_length"):
        with pytest.raises(NameMismatchError, match=f"has no '{missing}'"):
            solution_by_hand().to_dataframe(missing)
    with pytest.raises(NameMismatchError, match="has no 'margin'"):
        solution_by_hand(stability=False).to_dataframe("margin")


def test_without_pandas_a_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ScsoError, match=r"need pandas, which is not installed: pip install"):
        solution_by_hand().to_dataframe()


def test_figures_are_an_attribute():
    solution = solution_by_hand()
    for draw in (
        solution.plot.activation,
        solution.plot.force,
        solution.plot.moments,
        solution.plot.stability,
        solution.plot.contributions,
    ):
        assert isinstance(draw(), Figure)
    kinds = "activation, contributions, force, joint_reactions, moments, stability"
    assert repr(solution.plot) == f"figures of antagonists: {kinds}"
