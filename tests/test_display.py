"""What data show of themselves: short, escaped, no arrays; numbers known by hand."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import random_problem, with_motion, with_trajectory
from solution_by_hand import solution_by_hand

import scso_nlp as scso
from scso_nlp.display import MOST_ROWS, card, table, without_defaults

EVIL = "<script>alert(1)</script> & more"


def shows(thing):
    """What a terminal and a notebook show, the latter without styles."""
    return repr(thing), plain(thing._repr_html_())


def plain(html):
    return html.replace(' style="text-align: left"', "")


def test_a_solution_says_its_problem_and_its_verdict():
    text, html = shows(solution_by_hand(failed=(1,)))
    first, second, third, fourth = text.splitlines()
    assert first == (
        "Solution of antagonists: 5 frames from 0 to 1 s, 2 muscles, 1 actuators, 1 free coordinates"
    )
    assert second.strip().startswith(
        "4 of 5 frames solved (1 infeasible); stable in 4; least margin 0 N·m/rad"
    )
    assert third.strip().startswith("reserves carry at most")
    assert fourth.strip().startswith("worst: MomentEquilibrium[hinge_0] short by 3.1 N·m at t = 0.25 s")
    assert len(repr(solution_by_hand()).splitlines()) == 3
    # at t = 0.75 s 4.5 N·m ask for 90 N of the front muscle above the tonus of 50 N, of 1000 N
    assert "<tr><td>front_0</td><td>0.14</td><td>0.75</td><td>0.0725</td><td>140</td></tr>" in html
    # two muscles of 50 N at zero moment keep the level of 10 N·m/rad: at 0, 0.5 and 1 s
    assert "<tr><td>hinge_0_z</td><td>0</td><td>0</td><td>3</td></tr>" in html


def test_a_solution_without_rows_or_solved_frames_has_no_tables():
    assert "stability row" not in solution_by_hand(stability=False)._repr_html_()
    assert "<table>" not in solution_by_hand(failed=range(5))._repr_html_()


def test_a_motion_says_frames_and_ranges():
    motion = solution_by_hand(n_pairs=2).problem.motion
    text, html = shows(motion)
    assert text.splitlines() == [
        "Motion antagonists: 5 frames from 0 to 1 s, 4 muscles, 2 actuators, 2 free coordinates",
        "  skeleton of 3 bodies and 2 joints, with points of muscle paths",
    ]
    assert shows(motion.trajectory) == (text, html)
    values = np.array([[0.0, 0.1], [np.pi / 2, 0.2], [-np.pi / 4, 0.3], [0.0, 0.1], [0.0, 0.1]])
    changed = {"coordinate_values": values, "is_rotational": [True, False]}
    # 5 N·m at most; the second pair is one radian ahead, and 5 sin(1) is its largest at these times
    html = plain(replace(motion.trajectory, **changed)._repr_html_())
    assert "<tr><td>hinge_0</td><td>-45</td><td>90</td><td>°</td><td>5</td><td>N·m</td></tr>" in html
    assert "<tr><td>hinge_1</td><td>0.1</td><td>0.3</td><td>m</td><td>4.207</td><td>N</td></tr>" in html


def test_a_problem_says_its_terms():
    problem = solution_by_hand().problem
    text, html = shows(problem)
    assert text == str(problem)
    assert len(text.splitlines()) == 7
    assert html.count("<tr>") == 7
    assert "<td>  forces     </td><td> NoPhysiology()</td>" in html


def test_muscles_say_their_classes_and_constants():
    muscles = solution_by_hand(n_pairs=2).problem.motion.muscles
    mixed = replace(muscles, muscle_class=("Thelen2003Muscle", *muscles.muscle_class[1:]))
    text, html = shows(mixed)
    assert text == "4 muscles: 1 Thelen2003Muscle, 3 Millard2012EquilibriumMuscle"
    row = f"<td>{muscles.max_isometric_force[0]:g}</td><td>{muscles.optimal_fiber_length[0]:g}</td>"
    assert f"<td>front_0</td><td>Thelen2003Muscle</td>{row}" in html


def test_names_are_escaped_in_notebooks():
    solution = solution_by_hand()
    motion = solution.problem.motion
    names = (EVIL, "back_0")
    muscles = replace(motion.muscles, muscles=names)
    trajectory = replace(motion.trajectory, muscles=names, coordinates=(EVIL,), name=EVIL)
    problem = with_motion(solution.problem, trajectory=trajectory, muscles=muscles)
    for thing in (replace(solution, problem=problem), problem, problem.motion, muscles):
        html = thing._repr_html_()
        assert "<script>" not in html
        assert "&lt;script&gt;" in html


@pytest.mark.parametrize("n_frames", [2, 2000])
def test_nothing_grows_with_frames(n_frames):
    """A solution of 80 muscles over 1131 frames printed 234619 characters."""
    rng = np.random.default_rng(3)
    problem = random_problem(rng, n_frames=n_frames, n_muscles=80, reserve=5.0)
    motion = problem.motion
    for thing in (motion, motion.trajectory, motion.muscles, motion.actuators, problem):
        assert len(repr(thing)) < 1000, type(thing)
    assert len(motion._repr_html_()) + len(motion.muscles._repr_html_()) < 10000


def test_no_array_is_ever_printed():
    solution = solution_by_hand(n_frames=400, failed=(1,))
    things = [
        solution, solution["front_0"], solution.stability, solution.moment_balance, solution.optimality,
        *solution.rows.values(), *solution.infeasibility, solution.problem.motion.trajectory.skeleton,
        solution.problem.motion.actuators, scso.row_contributions(solution),
    ]  # fmt: skip
    for thing in things:
        assert "[0." not in repr(thing)
        assert len(repr(thing)) < 1500, type(thing)
    assert "stability=array of shape (400, 1)" in repr(solution.stability)


def test_curvature_is_named_not_printed():
    rng = np.random.default_rng(4)
    problem = random_problem(rng, n_frames=3, n_muscles=4, reserve=5.0)
    names = problem.motion.trajectory.coordinates
    n = len(names)
    curvature = scso.CoordinateCurvature(
        coordinates=names,
        path_curvature=np.zeros((3, n, n, 4)),
        load_stiffness=np.zeros((3, n, n)),
        passive_stiffness=np.zeros((3, n, n)),
        asymmetry=np.zeros((3, 4)),
        is_uncertain=np.zeros((3, 4), dtype=bool),
    )
    trajectory = with_trajectory(problem, curvature=curvature).motion.trajectory
    assert f"curvature along {names!r}"[:30] in repr(trajectory)
    assert f"path_curvature=array of shape (3, {n}, {n}, 4)" in repr(curvature)


def test_long_tables_are_cut_and_what_is_left_is_counted():
    rows = [(f"muscle_{i}", i / 7) for i in range(MOST_ROWS + 5)]
    text = table(("name", "value"), rows)
    assert text.count("<tr>") == MOST_ROWS + 2
    assert '<td style="text-align: left">muscle_1</td><td>0.1429</td>' in text
    assert "and 5 more" in text
    assert table(("name",), []) == ""
    assert card(f"{EVIL}\n  {EVIL}").count("&lt;script&gt;") == 2


def test_what_is_so_by_default_is_left_out():
    assert without_defaults(scso.ActivationEffort()) == "ActivationEffort()"
    changed = without_defaults(scso.JointStability(q=20.0, axes=("z",)))
    assert changed == "JointStability(q=20.0, axes=('z',))"
    of_some = without_defaults(scso.JointStability(level={"knee_r_z": 10.0}))
    assert of_some == "JointStability(level={'knee_r_z': 10.0})"
    many = {f"m{i}": float(i) for i in range(MOST_ROWS + 1)}
    assert without_defaults(scso.ActivationEffort(weights=many)).endswith("'m11': 11.0, ...})")
    assert without_defaults(3.5) == "3.5"
