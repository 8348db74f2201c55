"""Comparisons of results whose numbers are known, read from memory and from folders."""

import csv
import dataclasses
import json
import math

import numpy as np
import pytest
from solution_by_hand import solution_by_hand

from scso_nlp.emg import (
    Emg,
    EmgMap,
    GroupPair,
    MotionResult,
    MuscleGroup,
    compare,
    format_comparison,
    read_result,
    read_results,
    result_of,
    write_comparison_csv,
)
from scso_nlp.emg.comparison import ALL_GROUPS, EMG_LABEL, ComparisonRow, format_number
from scso_nlp.exceptions import DataError, FileFormatError, NameMismatchError
from scso_nlp.io.storage import Storage, write_storage

N_FRAMES = 40
TIME = np.linspace(0.0, 2.0, N_FRAMES)
MUSCLES = ("rectus_r", "rectus_l", "erector_r", "erector_l", "psoas")
WAVE = 0.3 + 0.2 * np.sin(2 * np.pi * 0.7 * TIME)
MAP = EmgMap(
    groups=(
        MuscleGroup(name="abdomen", muscles=("rectus_*",), channels=("ra_r", "ra_l")),
        MuscleGroup(name="back", muscles=("erector_*",), channels=("es",)),
        MuscleGroup(name="deep", muscles=("psoas",)),
    ),
    pairs=(GroupPair(name="abdomen over back", numerator=("abdomen",), denominator=("back",)),),
)


def make_result(label, abdomen=0.0, back=WAVE, solved=None, time=TIME, **changes):
    activation = np.zeros((N_FRAMES, 5))
    activation[:, 0], activation[:, 1] = abdomen, 3 * np.asarray(abdomen)
    activation[:, 2] = activation[:, 3] = back
    solved = np.ones(N_FRAMES, bool) if solved is None else solved
    values = {"label": label, "name": "lift", "time": time, "muscles": MUSCLES, "activation": activation}
    return MotionResult(**{**values, "is_solved": solved, **changes})


def make_emg(start=-0.5):
    time = start + np.arange(3100) / 1000
    back = 0.35 + 0.2 * np.sin(2 * np.pi * 0.7 * time)
    return Emg(
        channels=("ra_r", "ra_l", "es", "spare"),
        time=time,
        values=np.column_stack([np.full(3100, 0.03), np.full(3100, 0.05), back, 0 * time]),
    )


def number(comparison, result, group, metric):
    rows = [r for r in comparison.rows if (r.result, r.group, r.metric) == (result, group, metric)]
    assert len(rows) == 1, rows
    return rows[0]


def test_a_silent_abdomen_differs_from_emg_by_the_mean_emg_and_has_no_correlation():
    found = compare([make_result("SO"), make_result("SCSO", abdomen=0.02)], emg_map=MAP, emg=make_emg())
    silent = number(found, "SO", "abdomen", "mean absolute difference")
    assert silent.value == pytest.approx(0.04, abs=1e-6)  # mean of the two channels
    # mean of 0.02 and 0.06 over the two muscles is the EMG exactly
    assert number(found, "SCSO", "abdomen", "mean absolute difference").value == pytest.approx(0, abs=1e-6)
    correlation = number(found, "SO", "abdomen", "Pearson r")
    assert math.isnan(correlation.value)
    assert "constant" in correlation.note
    # EMG of the back lies 0.05 above with the same shape; the resampling filter damps 0.7 Hz by under 1 %
    back = number(found, "SO", "back", "mean absolute difference")
    assert back.value == pytest.approx(0.05, abs=2e-3)
    assert back.low <= back.value <= back.high
    assert number(found, "SO", "back", "Pearson r").value == pytest.approx(1, abs=1e-3)
    assert number(found, "SO", "back", "lag of best r").value == pytest.approx(0, abs=1e-9)
    both = number(found, "SO", ALL_GROUPS, "mean absolute difference")
    assert both.value == pytest.approx((0.04 + 0.05) / 2, abs=2e-3)
    assert not [row for row in found.rows if row.group == "deep" and row.metric == "RMSE"]


def test_ratios_and_co_contraction_stand_for_every_result_and_for_emg():
    found = compare([make_result("SO"), make_result("SCSO", abdomen=WAVE / 2)], emg_map=MAP, emg=make_emg())
    assert number(found, "SO", "abdomen over back", "activity ratio").value == 0
    assert number(found, "SCSO", "abdomen over back", "activity ratio").value == pytest.approx(1)
    assert number(found, "SCSO", "abdomen over back", "common activity").value == pytest.approx(1)
    assert number(found, "SCSO", "abdomen over back", "co-contraction").value == pytest.approx(
        2 * WAVE.mean()
    )
    measured = number(found, EMG_LABEL, "abdomen over back", "activity ratio").value
    assert measured == pytest.approx(0.04 / found.emg[:, 1].mean(), abs=1e-9)


def test_without_emg_results_are_compared_with_the_first_muscle_by_muscle():
    found = compare([make_result("SO"), make_result("SCSO", abdomen=0.02)])
    row = number(found, "SCSO", "rectus_l", "mean absolute difference from SO")
    assert row.value == pytest.approx(0.06)
    assert found.group_names == MUSCLES
    assert not [row for row in found.rows if row.result == "SO" and "difference" in row.metric]


def test_only_frames_solved_by_all_are_used_and_the_text_says_how_many():
    solved = np.ones(N_FRAMES, bool)
    solved[3:10] = False
    abdomen = np.where(solved, 0.02, np.nan)
    found = compare([make_result("SO"), make_result("SCSO", abdomen=abdomen, solved=solved)])
    assert found.is_used.sum() == N_FRAMES - 7
    assert number(found, "SCSO", "rectus_r", "mean activity").value == pytest.approx(0.02)
    assert number(found, "SO", "erector_r", "mean activity").value == pytest.approx(WAVE[solved].mean())
    assert "From 33 of 40 frames, solved by all." in format_comparison(found)
    with pytest.raises(DataError, match="no frame is solved in all results"):
        compare([make_result("a", solved=solved), make_result("b", solved=~solved)])


def test_static_tasks_get_no_lag_but_all_else():
    tasks = np.array([0.0, 1.0, 2.0, 5.0])
    results = [
        MotionResult(label="SO", name="tasks", time=tasks, muscles=("a",), is_solved=[True] * 4,
                     activation=[[0.1], [0.2], [0.3], [0.4]])
    ]  # fmt: skip
    emg = Emg(channels=("a",), time=tasks, values=[[0.2], [0.3], [0.4], [0.5]])
    emg_map = EmgMap(groups=(MuscleGroup(name="a", muscles=("a",), channels=("a",)),))
    found = compare(results, emg_map=emg_map, emg=emg)
    lag = number(found, "SO", "a", "lag of best r")
    assert math.isnan(lag.value)
    assert "not uniform" in lag.note
    assert number(found, "SO", "a", "RMSE").value == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("second", "error", "message"),
    [
        ({"label": "SO"}, DataError, "label names must be unique, found twice: SO"),
        ({"label": "EMG"}, DataError, "'EMG' is taken"),
        ({"muscles": ("rectus_r", "rectus_l", "erector_r", "erector_l", "iliacus")}, NameMismatchError,
         r"missing muscles \['psoas'\], extra \['iliacus'\]"),
        ({"muscles": MUSCLES[::-1]}, NameMismatchError, "different order"),
        ({"time": TIME + 0.01}, DataError, "frame 0 of 'SCSO' is at t = 0.01 s"),
    ],
)  # fmt: skip
def test_results_that_do_not_belong_together_are_refused(second, error, message):
    with pytest.raises(error, match=message):
        compare([make_result("SO"), make_result(**{"label": "SCSO", **second})])


def test_nothing_to_compare_and_emg_without_a_map_are_refused():
    with pytest.raises(DataError, match="no result to compare"):
        compare([])
    with pytest.raises(DataError, match="EMG needs a map file"):
        compare([make_result("SO")], emg=make_emg())
    with pytest.raises(DataError, match="names no EMG channel"):
        compare([make_result("SO")], emg=make_emg(), emg_map=EmgMap(groups=MAP.groups[2:]))
    with pytest.raises(DataError, match="the motion needs"):
        compare([make_result("SO")], emg=make_emg(start=0.5), emg_map=MAP)


def test_a_hole_in_a_solved_frame_and_a_negative_activation_are_refused():
    with pytest.raises(DataError, match="nan for rectus_r at t = 0 s, in a frame that is marked as solved"):
        make_result("SO", abdomen=np.nan)
    with pytest.raises(DataError, match=r"activation of -0\.3"):
        compare([make_result("SO", abdomen=-0.1)])


def test_the_csv_file_holds_every_number_with_all_digits(tmp_path):
    found = compare(
        [make_result("SO, plain"), make_result("SCSO", abdomen=0.02)], emg_map=MAP, emg=make_emg()
    )
    write_comparison_csv(found, tmp_path / "table.csv")
    with open(tmp_path / "table.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found.rows)
    for read, row in zip(rows, found.rows, strict=True):
        assert (read["result"], read["group"], read["metric"]) == (row.result, row.group, row.metric)
        assert read["value"] == ("" if math.isnan(row.value) else repr(row.value))
    assert list(tmp_path.iterdir()) == [tmp_path / "table.csv"]
    with pytest.raises(DataError, match="cannot be written"):
        write_comparison_csv(found, tmp_path / "nowhere" / "table.csv")


def test_the_text_table_has_a_line_per_group_and_explains_what_is_missing():
    text = format_comparison(
        compare([make_result("SO"), make_result("SCSO", abdomen=0.02)], emg_map=MAP, emg=make_emg())
    )
    lines = text.splitlines()
    assert lines[0].split() == ["metric", "group", "unit", "SO", "SCSO", "EMG"]
    correlation = next(line for line in lines if line.startswith("Pearson r"))
    assert "n/a [1]" in correlation
    assert "n/a [2]" in correlation
    assert "[1] the predicted series is constant" in text
    assert "circular block bootstrap" in text


def test_what_rounds_to_zero_has_no_sign():
    row = ComparisonRow(result="a", group="b", metric="c", value=-1e-9, low=-2e-9, high=0.5)
    assert format_number(row) == "0.000 (0.000 to 0.500)"


def written_folder(tmp_path, failed=False, **report):
    name = "walk"
    folder = tmp_path / "results"
    folder.mkdir(exist_ok=True)
    time = np.array([0.0, 0.5, 1.0])
    activation = np.array([[0.5, -2.0, 0.1], [0.6, 3.0, 0.2], [0.7, 0.0, 0.3]])
    status = ["SOLVED", "ACCEPTABLE", "SOLVED"]
    if failed:
        activation[1], status[1] = np.nan, "INFEASIBLE"
    storage = Storage(name="x", labels=("soleus", "knee_reserve", "vasti"), time=time, values=activation)
    write_storage(storage, folder / f"{name}_StaticOptimization_activation.sto", allow_nonfinite=True)
    values = np.array([[9.0, 4.0, 5.0]] * 3)
    labels = ("ankle_z_stability", "ankle_z_level", "ankle_z_margin")
    write_storage(
        Storage(name="s", labels=labels, time=time, values=values), folder / f"{name}_stability.sto"
    )
    content = {
        "program": "scso_nlp",
        "name": name,
        "frame_status": status,
        "problem": {"muscle_names": ["soleus", "vasti"]},
        **report,
    }
    (folder / "report.json").write_text(json.dumps(content))
    return folder


def test_a_result_folder_is_read_without_its_reserves(tmp_path):
    found = read_result(written_folder(tmp_path, failed=True))
    assert found.label == "results"
    assert found.muscles == ("soleus", "vasti")
    assert found.is_solved.tolist() == [True, False, True]
    assert found.activation[[0, 2]].tolist() == [[0.5, 0.1], [0.7, 0.3]]
    assert found.stability_rows == ("ankle_z",)
    assert (found.stability == 9).all()


def test_folders_of_one_name_get_labels_that_differ(tmp_path):
    folders = []
    for run in ("so", "scso"):
        (tmp_path / run).mkdir()
        folders.append(written_folder(tmp_path / run))
    assert [result.label for result in read_results(folders)] == ["so/results", "scso/results"]
    assert [result.label for result in read_results(folders, ["a", "b"])] == ["a", "b"]
    with pytest.raises(DataError, match="given twice"):
        read_results([folders[0], folders[0]])
    with pytest.raises(DataError, match="1 labels for 2 results"):
        read_results(folders, ["a"])


@pytest.mark.parametrize(
    ("report", "error", "message"),
    [
        ({"program": "other"}, FileFormatError, "not a report of scso_nlp"),
        ({"frame_status": ["SOLVED"]}, FileFormatError, "not of one run"),
        ({"frame_status": "SOLVED"}, FileFormatError, "'frame_status' is missing or not a list"),
        ({"frame_status": ["SOLVED", "SOLVD", "SOLVED"]}, FileFormatError, "'SOLVD' is no status of a frame"),
        ({"frame_status": ["SOLVED", 1, "SOLVED"]}, FileFormatError, "1 is no status of a frame"),
        ({"problem": {}}, FileFormatError, "does not say which of the 3 columns"),
        ({"name": "../walk"}, FileFormatError, "cannot be the start of file names"),
        ({"name": "run"}, DataError, r"has 0 files run_\*_activation.sto"),
        ({"problem": {"muscle_names": ["solius"]}}, NameMismatchError, "soleus"),
    ],
)
def test_each_fault_of_a_result_folder_is_named(tmp_path, report, error, message):
    with pytest.raises(error, match=message):
        read_result(written_folder(tmp_path, **report))


def test_a_stability_file_belongs_to_its_run(tmp_path):
    folder = written_folder(tmp_path, files_sha256={"walk_stability.sto": "0"})
    stability = folder / "walk_stability.sto"
    good = stability.read_text()
    stability.write_text(good.replace("\n1.0\t", "\n1.5\t"))
    with pytest.raises(FileFormatError, match=r"walk_stability\.sto and .* have different frames"):
        read_result(folder)
    stability.write_text(good.replace("\t9.0", "\tinf", 1))
    with pytest.raises(DataError, match=r"results: stability of 'results' is inf for ankle_z at t = 0 s"):
        read_result(folder)
    stability.unlink()
    with pytest.raises(DataError, match=r"walk_stability\.sto does not exist"):
        read_result(folder)


@pytest.mark.parametrize(
    "change", [{"back": 1e300 * WAVE}, {"abdomen": np.where(TIME[3] == TIME, 1e10, 0.0)}]
)
def test_activations_beyond_all_measure_are_refused(change):
    with pytest.raises(DataError, match=r"the activation of 'a' is up to .*e\+.*, expected a fraction"):
        compare([make_result("a", **change)])


def test_a_reference_that_is_no_maximum_is_refused():
    small = dataclasses.replace(MAP, mvc={"es": 1e-300})
    with pytest.raises(DataError, match="the EMG over its references of EMG map is up to"):
        compare([make_result("a")], emg=make_emg(), emg_map=small)


def test_folders_without_results_are_refused(tmp_path):
    with pytest.raises(DataError, match="is not a folder"):
        read_result(tmp_path / "nothing")
    with pytest.raises(
        DataError, match=r"has no report\.json: it holds no results, or a run that was interrupted"
    ):
        read_result(tmp_path)
    (tmp_path / "report.json").write_text("{")
    with pytest.raises(FileFormatError, match="is not JSON"):
        read_result(tmp_path)


def test_a_solution_in_memory_gives_the_same_numbers_as_its_arrays():
    solution = solution_by_hand(5, failed=(2,))
    found = result_of(solution, "SCSO")
    assert found.is_solved.tolist() == [True, True, False, True, True]
    assert found.activation == pytest.approx(solution.activation)
    assert found.stability_rows == solution.rows["JointStability"].names
    solved = solution.is_solved
    assert found.stability[solved] == pytest.approx(solution.rows["JointStability"].value[solved])
    assert np.isnan(found.stability[~solved]).all()
    plain = result_of(solution_by_hand(5, stability=False), "SO")
    assert plain.stability_rows == ()
    table = compare([plain, found]).rows
    assert [row.result for row in table if row.metric == "smallest stability"] == ["SCSO"]
