"""Result files: OpenSim's formats, whole or not at all, nothing that looks like a result after a failure."""

import builtins
import concurrent.futures
import contextlib
import errno
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from solution_by_hand import solution_by_hand

from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.io import read_storage
from scso_nlp.report import results
from scso_nlp.report.folder import claimed, settle
from scso_nlp.report.results import NO_ITERATE, STATUS_CODES, RunRecord, write_solution
from scso_nlp.solution import Status

RESULTS = {
    "antagonists_StaticOptimization_activation.sto",
    "antagonists_StaticOptimization_force.sto",
    "antagonists_StaticOptimization_controls.xml",
}
ALWAYS = {"antagonists_status.sto", "report.json"}
FIGURES = {f"antagonists_{what}.{kind}" for what in ("activations", "moments") for kind in ("png", "pdf")}
STABILITY = "antagonists_stability.sto"

READ_WITH_OPENSIM = """
import json, sys
import opensim
opensim.Logger.setLevelString("Off")
answer = {}
for path in sys.argv[1:]:
    if path.endswith(".xml"):
        controls = opensim.ControlSet(path)
        answer[path] = [
            [controls.get(i).getName() for i in range(controls.getSize())],
            [[controls.get(i).getControlValue(t) for t in (0, 0.25, 1)] for i in range(controls.getSize())],
        ]
        continue
    storage = opensim.Storage(path)
    table = opensim.TimeSeriesTable(path)
    labels = [storage.getColumnLabels().get(i) for i in range(storage.getColumnLabels().getSize())]
    answer[path] = [storage.getName(), labels, storage.getSize(), list(table.getColumnLabels()),
                    table.getMatrix().to_numpy().tolist()]
print(json.dumps(answer))
"""

RUN_ANALYZE_TOOL = """
import sys
import opensim
opensim.Logger.setLevelString("Off")
tool = opensim.AnalyzeTool(sys.argv[1])
tool.setResultsDir(sys.argv[2])
tool.setFinalTime(0.3)
tool.run()
"""


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def write(solution, folder, **options):
    return write_solution(solution, folder, **{"figures": False, **options})


def opensim(script, *arguments):
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], check=True, capture_output=True, text=True
    ).stdout


def header(path: Path) -> list[str]:
    return path.read_text().split("endheader")[0].splitlines()


def test_a_solved_motion_leaves_every_file_and_nothing_else(tmp_path):
    written = write_solution(solution_by_hand(), tmp_path / "results")
    stability_figures = {
        f"antagonists_{what}.{kind}" for what in ("stability", "contributions") for kind in ("png", "pdf")
    }
    assert files(tmp_path / "results") == RESULTS | ALWAYS | {STABILITY} | FIGURES | stability_figures
    assert {path.name for path in written} == files(tmp_path / "results")
    assert files(tmp_path) == {"results"}


def test_without_stability_rows_there_is_no_stability_file(tmp_path):
    write_solution(solution_by_hand(stability=False), tmp_path / "results")
    assert files(tmp_path / "results") == RESULTS | ALWAYS | FIGURES


def test_columns_are_actuators_in_the_order_of_the_force_set(tmp_path):
    solution = solution_by_hand(n_pairs=2)
    write(solution, tmp_path / "results")
    start = tmp_path / "results" / "antagonists_StaticOptimization"
    activation = read_storage(f"{start}_activation.sto")
    force = read_storage(f"{start}_force.sto")
    order = ("hinge_0_reserve", "front_0", "back_0", "front_1", "back_1", "hinge_1_reserve")
    assert activation.labels == order
    assert force.labels == (*order, "hand_load_Fx", "hand_load_Fy")
    # the writer keeps all digits, so the numbers come back as they were
    np.testing.assert_array_equal(activation.columns(("back_1",))[:, 0], solution.activation[:, 3])
    np.testing.assert_array_equal(activation.column("hinge_1_reserve"), solution.control[:, 1])
    np.testing.assert_array_equal(force.column("front_0"), solution.tendon_force[:, 0])
    np.testing.assert_array_equal(force.column("hinge_0_reserve"), solution.actuator_force[:, 0])
    np.testing.assert_array_equal(force.column("hand_load_Fy"), np.arange(5.0))
    np.testing.assert_array_equal(force.time, solution.problem.motion.trajectory.time)


def test_a_trajectory_without_force_columns_writes_muscles_then_actuators_then_other_forces(tmp_path):
    solution = solution_by_hand()
    trajectory = replace(solution.problem.motion.trajectory, force_columns=())
    solution = replace(
        solution,
        problem=replace(solution.problem, motion=replace(solution.problem.motion, trajectory=trajectory)),
    )
    write(solution, tmp_path / "results")
    force = read_storage(tmp_path / "results" / "antagonists_StaticOptimization_force.sto")
    assert force.labels == ("front_0", "back_0", "hinge_0_reserve", "hand_load_Fx", "hand_load_Fy")


def test_a_force_column_that_nobody_fills_is_named(tmp_path):
    solution = solution_by_hand()
    columns = (*solution.problem.motion.trajectory.force_columns, "spring_left")
    trajectory = replace(solution.problem.motion.trajectory, force_columns=columns)
    solution = replace(
        solution,
        problem=replace(solution.problem, motion=replace(solution.problem.motion, trajectory=trajectory)),
    )
    with pytest.raises(NameMismatchError, match="spring_left"):
        write(solution, tmp_path / "results")
    assert files(tmp_path) == set()


def test_the_controls_hold_one_node_per_frame_with_the_activation(tmp_path):
    solution = solution_by_hand()
    write(solution, tmp_path / "results")
    path = tmp_path / "results" / "antagonists_StaticOptimization_controls.xml"
    controls = ElementTree.parse(path).getroot().findall("ControlSet/objects/ControlLinear")
    assert [control.get("name") for control in controls] == ["hinge_0_reserve", "front_0", "back_0"]
    values = [float(node.text) for node in controls[2].findall("x_nodes/ControlLinearNode/value")]
    np.testing.assert_array_equal(values, solution.activation[:, 1])


def test_the_stability_file_holds_stability_level_margin_and_multiplier(tmp_path):
    write(solution_by_hand(), tmp_path / "results")
    table = read_storage(tmp_path / "results" / STABILITY)
    assert table.labels == tuple(
        f"hinge_0_z_{what}" for what in ("stability", "level", "margin", "multiplier")
    )
    # two muscles of 50 N at zero moment, 0.1 N·m/rad per newton (r = 0.05 m, length 0.1 m, q = 5): 10 N·m/rad
    assert table.values[0] == pytest.approx([10.0, 10.0, 0.0, 0.25], abs=1e-12)
    # at a quarter of the period one muscle has 90 N more for 4.5 N·m
    assert table.values[1] == pytest.approx([19.0, 10.0, 9.0, 0.0], abs=1e-12)


def test_a_failed_frame_leaves_a_status_and_a_report_only(tmp_path):
    write_solution(solution_by_hand(failed=(1, 3)), tmp_path / "results")
    assert files(tmp_path / "results") == ALWAYS


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_failed_run_leaves_earlier_results_and_stands_beside_them(tmp_path, caplog):
    folder = tmp_path / "results"
    write_solution(solution_by_hand(), folder)
    (folder / "notes.txt").write_text("mine")
    before = content(folder)
    for keep_failed in (True, False):
        written = write(solution_by_hand(failed=(1,)), folder, keep_failed=keep_failed)
        assert content(folder) == before
        assert {path.parent for path in written} == {folder / "failed"}
        assert "because it failed: earlier results in" in caplog.text
    assert files(folder / "failed") == ALWAYS
    write(solution_by_hand(tonus=0.1), folder)
    assert files(folder) == RESULTS | ALWAYS | {STABILITY, "notes.txt"}
    assert content(folder) != before


def test_results_with_gaps_are_replaced_by_their_like_but_not_by_none(tmp_path):
    folder = tmp_path / "results"
    write(solution_by_hand(failed=(1, 2)), folder)
    write(solution_by_hand(failed=(1,)), folder, keep_failed=True)
    write(solution_by_hand(failed=(1, 3)), folder, keep_failed=True)
    before = content(folder)
    assert json.loads(before["report.json"])["status_counts"] == {"SOLVED": 3, "INFEASIBLE": 2}
    write(solution_by_hand(failed=(1,)), folder)
    assert content(folder) == before
    assert files(folder / "failed") == ALWAYS


def test_a_failed_run_leaves_results_that_have_no_report(tmp_path):
    """Such as OpenSim's own, which have the same names."""
    folder = tmp_path / "results"
    write(solution_by_hand(), folder)
    (folder / "report.json").unlink()
    write(solution_by_hand(failed=(1,)), folder)
    assert files(folder) > RESULTS


def test_results_of_another_name_stay(tmp_path):
    folder = tmp_path / "results"
    write(solution_by_hand(name="antagonists_2"), folder)
    write(solution_by_hand(), folder)
    assert "antagonists_2_StaticOptimization_force.sto" in files(folder)


def test_what_fails_in_a_figure_costs_that_figure_alone(tmp_path, monkeypatch, caplog):
    def broken(*_, **__):
        raise ValueError("no such\nglyph")

    monkeypatch.setattr("scso_nlp.figures.plot_moments", broken)
    written = write_solution(solution_by_hand(stability=False), tmp_path / "results")
    left = RESULTS | ALWAYS | {"antagonists_activations.png", "antagonists_activations.pdf"}
    assert files(tmp_path / "results") == {path.name for path in written} == left
    assert "the figure antagonists_moments is left out: no such glyph" in caplog.text
    report = json.loads((tmp_path / "results" / "report.json").read_text())
    assert set(report["files_sha256"]) == left - {"report.json"}


def test_dollars_in_names_are_dollars_in_figures(tmp_path, caplog):
    """Between two of them matplotlib would read mathematics, of which not every text is one."""
    solution = solution_by_hand(name="$_$", sides=("$_$", "back_$\\$"))
    written = write_solution(solution, tmp_path / "results")
    assert caplog.text == ""
    assert {path.name for path in written if path.suffix == ".png"} == {
        f"$_$_{what}.png" for what in ("activations", "moments", "stability", "contributions")
    }


def test_failed_frames_that_are_kept_are_not_numbers_in_any_result_file(tmp_path):
    write(solution_by_hand(failed=(1,)), tmp_path / "results", keep_failed=True)
    for name in RESULTS | {STABILITY}:
        if name.endswith(".sto"):
            values = read_storage(tmp_path / "results" / name).values
            assert np.isnan(values[1]).all(), name
            assert np.isfinite(values[[0, 2, 3, 4]]).all(), name
    root = ElementTree.parse(tmp_path / "results" / "antagonists_StaticOptimization_controls.xml").getroot()
    for nodes in root.iter("x_nodes"):
        values = [float(value.text) for value in nodes.iter("value")]
        assert np.flatnonzero(np.isnan(values)).tolist() == [1]


def test_status_codes_are_explained_in_the_header_of_the_status_file(tmp_path):
    solution = solution_by_hand(failed=(1, 3))
    write(solution, tmp_path / "results")
    table = read_storage(tmp_path / "results" / "antagonists_status.sto")
    assert table.labels == ("status", "violation_MomentEquilibrium", "violation_JointStability")
    assert table.column("status").tolist() == [0, 2, 0, 2, 0]
    for status, code in STATUS_CODES.items():
        assert f"{code} {status.name}: {status.value}" in table.description
    assert set(STATUS_CODES) == set(Status)


def test_the_status_file_has_no_gap_where_a_frame_has_no_iterate(tmp_path):
    solution = solution_by_hand(failed=(1,))
    rows = dict(solution.rows)
    value = rows["MomentEquilibrium"].value.copy()
    value[0], value[1] = -0.25, np.nan
    rows["MomentEquilibrium"] = replace(rows["MomentEquilibrium"], value=value)
    write(replace(solution, rows=rows), tmp_path / "results")
    table = read_storage(tmp_path / "results" / "antagonists_status.sto")
    assert table.column("violation_MomentEquilibrium")[:2].tolist() == [0.25, NO_ITERATE]


def test_the_report_is_strict_json_with_what_is_needed_to_reproduce(tmp_path):
    solution = solution_by_hand(failed=(1,))
    record = RunRecord(
        inputs={"model.osim": "ab" * 32},
        settings={"exponent": float("inf"), "output": tmp_path, "nothing": float("nan")},
        seconds={"extraction": 1.5},
        notes=("a note",),
    )
    write(solution, tmp_path / "results", record=record)
    text = (tmp_path / "results" / "report.json").read_text()
    report = json.loads(text, parse_constant=lambda token: pytest.fail(f"{token} is not JSON"))
    assert report["inputs_sha256"] == {"model.osim": "ab" * 32}
    assert report["settings"] == {"exponent": "inf", "output": str(tmp_path), "nothing": None}
    assert report["versions"]["casadi"] == "3.8.2"
    assert report["solver"]["options"] == {"tolerance": 1e-6, "max_iterations": 500}
    assert report["seconds"] == {"extraction": 1.5, "build": 0.1, "solve": 0.2}
    assert report["problem"]["muscle_names"] == list(solution.problem.motion.trajectory.muscles)
    assert report["frame_status"] == ["SOLVED", "INFEASIBLE", "SOLVED", "SOLVED", "SOLVED"]
    assert report["status_counts"] == {"SOLVED": 4, "INFEASIBLE": 1}
    assert report["shortfalls"][0]["row"] == "hinge_0"
    assert report["shortfalls"][0]["amount"] == 3.1
    assert report["objective"]["total"] == pytest.approx(solution.objective)
    assert report["notes"] == ["a note"]
    # muscles take nine tenths of every moment
    assert report["actuator_share"]["hinge_0"] == pytest.approx(0.1, abs=1e-9)
    status = tmp_path / "results" / "antagonists_status.sto"
    assert list(report["files_sha256"]) == [status.name]


def test_the_report_says_what_the_terminal_says_beside_the_baseline(tmp_path):
    solution = solution_by_hand(tonus=0.1)
    balance = solution.moment_balance
    baseline = replace(solution, moment_balance=replace(balance, actuators=balance.actuators / 2))
    more = replace(solution, moment_balance=replace(balance, actuators=3 * balance.actuators))
    for judged in (solution, more):
        write(judged, tmp_path / "results", baseline=baseline)
        report = json.loads((tmp_path / "results" / "report.json").read_text())
        assert report["verdict"]["lines"] == list(judged.verdict.lines(baseline.verdict))
        assert report["verdict"]["effort"] == judged.verdict.effort
    assert report["verdict"]["lines"][1].endswith("stability is bought from reserves")


@pytest.mark.parametrize("broken", ["_force.sto", "_controls.xml", "_status.sto", "report.json"])
@pytest.mark.parametrize("exists", [False, True])
def test_a_full_disk_leaves_what_was_there_before(tmp_path, monkeypatch, broken, exists):
    folder = tmp_path / "results"
    if exists:
        write(solution_by_hand(tonus=0.1), folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()} if exists else {}
    real = open

    def full(file, mode="r", *arguments, **options):
        name = os.fspath(file) if isinstance(file, (str, os.PathLike)) else ""
        if broken in name and ("w" in mode or "x" in mode):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(file, mode, *arguments, **options)

    monkeypatch.setattr(builtins, "open", full)
    monkeypatch.setattr(io, "open", full)
    with pytest.raises(DataError, match="No space left"):
        write_solution(solution_by_hand(), folder)
    monkeypatch.undo()
    assert files(tmp_path) == ({"results"} if exists else set())
    if exists:
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize("step", range(11))
def test_a_move_that_is_interrupted_is_taken_back(tmp_path, monkeypatch, step):
    folder = tmp_path / "results"
    write_solution(solution_by_hand(), folder)
    before = content(folder)
    real = os.replace
    steps = iter(range(1000))

    def interrupted(source, target):
        # only the last steps count, out of the temporary folder and before it into another
        moves = folder in (Path(target).parent, Path(source).parent)
        if moves and next(steps) == step:
            raise KeyboardInterrupt
        real(source, target)

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write(solution_by_hand(tonus=0.1), folder)
    monkeypatch.undo()
    assert content(folder) == before
    assert files(tmp_path) == {"results"}


#: Ends the process at its n-th step of moving files, as kill -9 does.
KILLED = """
import os, sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from solution_by_hand import solution_by_hand
from scso_nlp.report.results import write_solution
real, left = os.replace, [{step}]
def killed(source, target):
    if {folder!r} in (str(Path(target).parent), str(Path(source).parent)):
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), 9)
    real(source, target)
os.replace = killed
write_solution(solution_by_hand(tonus=0.1, stability=False), {folder!r}, figures=False)
"""


@pytest.mark.skipif(os.name != "posix", reason="kill -9")
@pytest.mark.parametrize("step", [0, 1, 7, 14, 16, 18, 19])
def test_a_run_that_is_killed_while_it_moves_files_leaves_one_result_whole(tmp_path, step):
    """The next run finds the earlier results, or the new ones, never something of both."""
    folder = tmp_path / "results"
    write_solution(solution_by_hand(), folder)
    (folder / "notes.txt").write_text("mine")
    before = content(folder)
    script = KILLED.format(tests=str(Path(__file__).parents[1]), step=step, folder=str(folder))
    done = subprocess.run([sys.executable, "-c", script], check=False, capture_output=True, text=True)
    assert done.returncode == (-9 if step < 19 else 0), done.stderr
    with claimed(folder, lambda _: True):
        found = content(folder)
    if step < 19:
        assert found == before
    else:
        assert set(found) == RESULTS | ALWAYS | {"notes.txt"}
    write(solution_by_hand(tonus=0.1), folder)
    assert files(folder) == RESULTS | ALWAYS | {STABILITY, "notes.txt"}
    assert files(tmp_path) == {"results"}


def test_taking_back_may_be_interrupted_too(tmp_path, monkeypatch):
    """At any of its steps; the next one goes on."""
    folder = tmp_path / "results"
    write_solution(solution_by_hand(), folder)
    before = content(folder)
    script = KILLED.format(tests=str(Path(__file__).parents[1]), step=17, folder=str(folder))
    subprocess.run([sys.executable, "-c", script], check=False)
    half = tmp_path / "half"
    os.replace(folder, half)
    real = os.replace
    for step in range(1000):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(half, folder)

        count = iter(range(1000))

        def interrupted(source, target, count=count, step=step):
            if next(count) == step:
                raise KeyboardInterrupt
            real(source, target)

        monkeypatch.setattr(os, "replace", interrupted)
        with contextlib.suppress(KeyboardInterrupt):
            settle(folder)
            break
        monkeypatch.undo()
        settle(folder)
        assert content(folder) == before
    assert step > 10
    assert content(folder) == before


def test_what_a_killed_run_was_writing_is_cleared_away(tmp_path):
    folder = tmp_path / "results"
    write(solution_by_hand(), folder)
    (folder / ".scso_new").mkdir()
    (folder / ".scso_new" / "half").write_text("0.1 0.")
    for name in ("report.json", "antagonists_moments.png"):
        (folder / f".{'0' * 32}.{name}").write_text("half")
    (folder / ".hidden").write_text("mine")
    write(solution_by_hand(tonus=0.1), folder)
    assert files(folder) == RESULTS | ALWAYS | {STABILITY, ".hidden"}


def test_runs_that_write_into_one_folder_at_the_same_time_wait_for_each_other(tmp_path, monkeypatch, caplog):
    """What is there in the end is all of one run."""
    folder = tmp_path / "results"
    solutions = [solution_by_hand(tonus=tonus) for tonus in (0.0, 0.1, 0.2, 0.3)]
    expected = []
    for k, solution in enumerate(solutions):
        write(solution, tmp_path / f"alone_{k}")
        expected.append(content(tmp_path / f"alone_{k}"))
    inside, most = [], []
    put = results._put

    def watched(*arguments):
        inside.append(1)
        most.append(len(inside))
        put(*arguments)
        inside.pop()

    monkeypatch.setattr(results, "_put", watched)
    for _ in range(5):
        with concurrent.futures.ThreadPoolExecutor(len(solutions)) as pool:
            list(pool.map(lambda solution: write(solution, folder), solutions))
        found = content(folder)
        report = json.loads(found.pop("report.json"))
        assert found in [{n: c for n, c in each.items() if n != "report.json"} for each in expected]
        assert report["files_sha256"] == {n: hashlib.sha256(c).hexdigest() for n, c in found.items()}
    assert set(most) == {1}
    assert "is being written to by another run; waiting for it" in caplog.text


@pytest.mark.parametrize("name", ["../escape", "a/b", "", ".hidden", "a\nb", "a\\b"])
def test_a_name_that_leaves_the_folder_is_refused(tmp_path, name):
    with pytest.raises(DataError, match="cannot start a file name"):
        write(solution_by_hand(name=name), tmp_path / "results")
    with pytest.raises(DataError, match="cannot start a file name"):
        write(solution_by_hand(), tmp_path / "results", analysis_name=name)
    assert files(tmp_path) == set()


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "results").write_text("mine")
    with pytest.raises(DataError, match="is a file"):
        write(solution_by_hand(), tmp_path / "results")
    assert (tmp_path / "results").read_text() == "mine"


@pytest.mark.opensim
def test_opensim_reads_the_files_and_finds_the_same_numbers(tmp_path):
    solution = solution_by_hand(n_pairs=2)
    written = write(solution, tmp_path / "results")
    paths = [path for path in written if path.suffix in (".sto", ".xml")]
    answer = json.loads(opensim(READ_WITH_OPENSIM, *paths))
    for path in paths:
        found = answer[str(path)]
        if path.suffix == ".xml":
            activations = read_storage(str(path).replace("_controls.xml", "_activation.sto"))
            assert tuple(found[0]) == activations.labels
            # these are times of frames; OpenSim interpolates all the same, so round-off remains
            np.testing.assert_allclose(found[1], activations.values[[0, 1, 4]].T, rtol=0, atol=1e-16)
            continue
        ours = read_storage(path)
        title, labels, size, table_labels, values = found
        assert title == ours.name
        assert tuple(labels) == ("time", *ours.labels)
        assert tuple(table_labels) == ours.labels
        assert size == ours.n_frames
        np.testing.assert_allclose(values, ours.values, rtol=1e-15)


@pytest.mark.opensim
def test_headers_and_controls_equal_those_of_opensims_own_tool(tmp_path, shared_data):
    setup = shared_data / "arm26" / "arm26_millard_Setup_StaticOptimization.xml"
    opensim(RUN_ANALYZE_TOOL, setup, tmp_path / "opensim")
    write(solution_by_hand(), tmp_path / "ours")
    for kind in ("activation.sto", "force.sto"):
        theirs = header(tmp_path / "opensim" / f"arm26_millard_StaticOptimization_{kind}")
        ours = header(tmp_path / "ours" / f"antagonists_StaticOptimization_{kind}")

        def without_sizes(lines):
            return [re.sub(r"(nRows|nColumns)=\d+", r"\1", line) for line in lines]

        assert without_sizes(ours) == without_sizes(theirs)
    theirs = (tmp_path / "opensim" / "arm26_millard_StaticOptimization_controls.xml").read_text()
    ours = (tmp_path / "ours" / "antagonists_StaticOptimization_controls.xml").read_text()

    def skeleton(text):
        text = re.sub(r"(\t*<ControlLinearNode>.*?</ControlLinearNode>\n)+", "NODES\n", text, flags=re.S)
        text = re.sub(r'ControlLinear name="[^"]*"', "ControlLinear", text)
        return re.sub(r"(\t*<ControlLinear>.*?</ControlLinear>\n)(\1)*", r"\1", text, flags=re.S)

    assert skeleton(ours) == skeleton(theirs)
    node = (
        r"\t{5}<ControlLinearNode>\n\t{6}<t>[^<]*</t>\n\t{6}<value>[^<]*</value>\n\t{5}</ControlLinearNode>\n"
    )
    for text in (ours, theirs):
        assert len(re.findall(node, text)) == text.count("<ControlLinearNode>")
