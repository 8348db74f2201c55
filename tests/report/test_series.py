"""Result folders give figures the numbers that were written."""

import json

import numpy as np
import pytest
from solution_by_hand import solution_by_hand, write

from scso_nlp.exceptions import DataError
from scso_nlp.io import Storage, write_storage
from scso_nlp.report.series import read_series, result_folders, telling_panels


@pytest.fixture
def solution(tmp_path):
    solution = solution_by_hand(21, n_pairs=2, failed=(4,))
    write(solution, tmp_path / "run", keep_failed=True)
    return solution


def blank(values):
    """What is drawn of a table: frame 4 is not solved."""
    values = np.array(values, dtype=float)
    values[4] = np.nan
    return values


def test_activations_forces_and_stability_come_back(tmp_path, solution):
    muscles = solution.problem.motion.trajectory.muscles
    (activation,) = read_series([tmp_path / "run"], "activation")
    assert (activation.label, activation.names, set(activation.units)) == ("run", muscles, {"-"})
    np.testing.assert_array_equal(activation.values, blank(solution.activation))
    np.testing.assert_array_equal(activation.highest, solution.problem.motion.muscles.max_activation)
    np.testing.assert_array_equal(activation.time, solution.problem.motion.trajectory.time)
    (force,) = read_series([tmp_path / "run"], "force", ["SCSO"])
    assert (force.label, set(force.units)) == ("SCSO", {"N"})
    np.testing.assert_array_equal(force.values, blank(solution.tendon_force))
    (stability,) = read_series([tmp_path / "run"], "stability")
    assert stability.names == ("hinge_0_z", "hinge_1_z")
    np.testing.assert_array_equal(stability.values, blank(solution.stability.stability))
    np.testing.assert_array_equal(stability.level, [10.0, 10.0])


def test_activations_of_a_single_result_come_after_those_without_stability(tmp_path, solution):
    before = solution_by_hand(21, n_pairs=2, stability=False)
    write(solution, tmp_path / "run", keep_failed=True, baseline=before)
    first, second = read_series([tmp_path / "run"], "activation")
    assert (first.label, second.label) == ("static optimization", "run")
    np.testing.assert_array_equal(first.values, before.activation)
    np.testing.assert_array_equal(second.values, blank(solution.activation))
    write(before, tmp_path / "other")
    labels = [each.label for each in read_series([tmp_path / "other", tmp_path / "run"], "activation")]
    assert labels == ["other", "run"]


def test_what_is_no_quantity_of_a_result_is_refused(tmp_path, solution):
    with pytest.raises(DataError, match="the quantity is 'shortfall', expected one of activation, force"):
        read_series([tmp_path / "run"], "shortfall")


def test_moments_of_one_result_are_its_parts_and_of_several_what_muscles_give(tmp_path, solution):
    balance = solution.moment_balance
    required, muscles, reserves = read_series([tmp_path / "run"], "moment")
    assert [part.label for part in (required, muscles, reserves)] == ["required", "muscles", "reserves"]
    assert (required.names, set(required.units)) == (balance.coordinates, {"N·m"})
    np.testing.assert_array_equal(required.values, blank(balance.required))
    np.testing.assert_array_equal(muscles.values, blank(balance.muscles))
    np.testing.assert_array_equal(reserves.values, blank(balance.actuators))
    # reserves carry a tenth of all moments by hand
    panels, notes = telling_panels("moment", (required, muscles, reserves))
    assert ([panel.title for panel in panels], notes) == (["hinge_0", "hinge_1"], ())
    write(solution_by_hand(21, n_pairs=2), tmp_path / "other")
    series = read_series([tmp_path / "run", tmp_path / "other"], "moment")
    assert [each.label for each in series] == ["required", "muscles, run", "muscles, other"]


def test_few_frames_in_which_nothing_moves_are_tasks(tmp_path, solution):
    assert not read_series([tmp_path / "run"], "activation")[0].are_tasks
    write(solution_by_hand(5), tmp_path / "tasks")
    assert read_series([tmp_path / "tasks"], "activation")[0].are_tasks
    path = tmp_path / "tasks" / "report.json"
    report = json.loads(path.read_text())
    report["problem"]["at_rest"] = False
    path.write_text(json.dumps(report))
    assert not read_series([tmp_path / "tasks"], "force")[0].are_tasks


def reactions(folder, n_frames=21):
    """A file as OpenSim's JointReaction writes it."""
    time = np.linspace(0.0, 1.0, n_frames)
    labels, columns = [], []
    for joint, size in (("hip_r_on_femur_r_in_ground", 3.0), ("hip_l_on_femur_l_in_ground", 5.0)):
        for kind, factor in (("f", 1.0), ("m", 0.01), ("p", 0.1)):
            labels += [f"{joint}_{kind}{axis}" for axis in "xyz"]
            columns += [size * factor * (1 + time), 2 * size * factor * np.ones(n_frames), 0 * time]
    table = Storage(
        name="Joint Reaction Loads", labels=tuple(labels), time=time, values=np.column_stack(columns)
    )
    write_storage(table, folder / "antagonists_JointReaction_ReactionLoads.sto")
    return time


def test_joint_reactions_are_resultants_or_single_columns(tmp_path, solution):
    time = reactions(tmp_path / "run")
    (series,) = read_series([tmp_path / "run"], "reaction")
    right = series.column("hip_r_on_femur_r_in_ground")
    np.testing.assert_allclose(right, blank(3 * np.sqrt((1 + time) ** 2 + 4)))
    np.testing.assert_array_equal(series.column("hip_l_on_femur_l_in_ground_my"), blank(np.full(21, 0.1)))
    units = dict(zip(series.names, series.units, strict=True))
    assert units["hip_l_on_femur_l_in_ground_my"] == "N·m"
    assert units["hip_l_on_femur_l_in_ground_fx"] == units["hip_l_on_femur_l_in_ground"] == "N"
    assert not [name for name in series.names if name.endswith("_px")]
    (pair,), notes = telling_panels("reaction", (series,))
    assert (pair.title, notes) == ("hip_on_femur_in_ground", ())


def test_joint_forces_are_in_body_weights_where_the_report_has_the_weight(tmp_path, solution):
    reactions(tmp_path / "run")
    (newtons,) = read_series([tmp_path / "run"], "reaction")
    path = tmp_path / "run" / "report.json"
    report = json.loads(path.read_text(encoding="utf-8"))
    report["problem"]["body_weight"] = 700.0
    path.write_text(json.dumps(report), encoding="utf-8")
    (found,) = read_series([tmp_path / "run"], "reaction")
    units = dict(zip(found.names, found.units, strict=True))
    for name, unit, size in (("", "BW", 700.0), ("_fy", "BW", 700.0), ("_my", "N·m", 1.0)):
        name = f"hip_r_on_femur_r_in_ground{name}"
        assert units[name] == unit
        np.testing.assert_allclose(size * found.column(name), newtons.column(name), rtol=1e-14)


@pytest.mark.parametrize(
    ("quantity", "message"),
    [
        (
            "reaction",
            "has no reaction, expected antagonists_JointReaction_ReactionLoads.sto: run again",
        ),
        ("stability", "has no stability, .*: it was solved without stability rows"),
        ("moment", "has no moment, .*: it was written by an earlier version"),
        ("power", "the quantity is 'power', expected one of activation, force"),
    ],
)
def test_what_a_result_lacks_is_one_sentence_with_what_brings_it(tmp_path, quantity, message):
    write(solution_by_hand(5, stability=False), tmp_path / "run")
    (tmp_path / "run" / "antagonists_moments.sto").unlink()
    with pytest.raises(DataError, match=message):
        read_series([tmp_path / "run"], quantity)


def test_files_of_two_runs_are_refused(tmp_path, solution):
    reactions(tmp_path / "run", n_frames=20)
    with pytest.raises(DataError, match="the files of 'run' have 20 and 21 frames"):
        read_series([tmp_path / "run"], "reaction")


def test_a_folder_of_results_stands_for_all_of_them(tmp_path):
    for name in ("static_optimization", "with_stability"):
        write(solution_by_hand(), tmp_path / "example" / name)
    (tmp_path / "example" / "notes").mkdir()
    within = [tmp_path / "example" / name for name in ("static_optimization", "with_stability")]
    assert result_folders([tmp_path / "example"]) == within
    assert result_folders([within[0], tmp_path / "nothing"]) == [within[0], tmp_path / "nothing"]
    labels = [series.label for series in read_series([tmp_path / "example"], "activation")]
    assert labels == ["static_optimization", "with_stability"]
