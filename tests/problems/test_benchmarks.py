"""The benchmark command: what is in its result and how it goes on; never how long anything takes."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

import scso_nlp as scso
from problems.benchmarks import __main__ as command
from problems.benchmarks import measuring, page, same_answers
from problems.benchmarks.cases import CASES, FULL, SCSO, SO, Case, synthetic
from problems.benchmarks.history.solve import Solve
from problems.benchmarks.peers import PEERS, Peer
from problems.benchmarks.questions import ask

SMALLEST = "synthetic_smallest"
OURS = ("trajectory-wide", "frame by frame")
#: Answers differ by what solvers are asked for, about 1e-8, over the least objectives [-].
SAME = 1e-5


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Path:
    """Result file of a quick run of the smallest case."""
    output = tmp_path_factory.mktemp("benchmark") / "result.json"
    assert command.main(["--cases", SMALLEST, "--quick", "--output", str(output)]) == 0
    return output


def test_every_answer_is_judged_by_the_benchmark(result):
    found = json.loads(result.read_text())
    assert list(found["seconds"]) == [SMALLEST]
    assert found["facts"]["cores"]
    rows = [row for row in found["rows"] if "alone" not in row["what"]]
    for kind in (SO, SCSO, FULL):
        some = {row["by"]: row for row in rows if row["what"].startswith(f"{kind},")}
        assert {*OURS, "Clarabel"} <= set(some)
        assert ("DAQP" in some) == ("SciPy SLSQP" in some) == (kind != FULL)
        for row in some.values():
            if "not installed" in row.get("note", ""):
                continue
            assert row["kept"] == row["frames"] == 20, row
            assert row["seconds"] > 0
            assert row["equilibrium"] <= measuring.KEPT
            assert row["stability"] <= measuring.KEPT
            assert abs(row["objective"]) <= SAME


def test_memory_is_measured_in_processes_of_their_own(result):
    alone = [row for row in json.loads(result.read_text())["rows"] if row["what"].endswith("alone")]
    assert len(alone) == 3
    assert all(0 <= row["solving_mb"] < row["peak_mb"] for row in alone)  # short ones may need nothing more


def test_a_finished_case_is_not_measured_again(result, monkeypatch, capsys):
    before = result.read_text()
    monkeypatch.setattr(command, "_run_case", lambda *_: pytest.fail("measured again"))
    assert command.main(["--cases", SMALLEST, "--quick", "--output", str(result)]) == 0
    assert result.read_text() == before
    assert capsys.readouterr().out.count("\n") > len(json.loads(before)["rows"])


def test_a_stopped_run_keeps_finished_cases_and_drops_half_a_case(result, tmp_path):
    found = json.loads(result.read_text())
    kept = {"case": "arm26", "what": "SO", "by": "DAQP"}
    half = {"case": SMALLEST, "what": "left over", "by": "DAQP"}
    found["rows"], found["seconds"] = [kept, half], {"arm26": {"wall": 1.0, "processor": 1.0}}
    copy = tmp_path / "result.json"
    copy.write_text(json.dumps(found))
    command.main(["--cases", f"arm26,{SMALLEST}", "--quick", "--peers", "none", "--output", str(copy)])
    after = json.loads(copy.read_text())
    assert list(after["seconds"]) == ["arm26", SMALLEST]
    assert after["rows"][0] == kept
    assert half not in after["rows"]
    assert {row["by"] for row in after["rows"][1:]} == {*OURS, "Cholesky factor as unknowns"}


def test_results_of_another_machine_are_not_mixed(result, tmp_path):
    found = json.loads(result.read_text())
    found["facts"]["processor"] = "another"
    copy = tmp_path / "result.json"
    copy.write_text(json.dumps(found))
    with pytest.raises(SystemExit, match="give another --output"):
        command.main(["--cases", SMALLEST, "--quick", "--output", str(copy)])


def test_unknown_names_are_refused(capsys):
    with pytest.raises(SystemExit):
        command.main(["--cases", "walking"])
    assert "unknown 'walking', expected some of arm26" in capsys.readouterr().err


def test_peers_that_lie_fail_or_are_absent_are_one_line_each(monkeypatch):
    def breaks(_):
        raise ValueError("no")

    def lies(question):
        return np.zeros((question.n_frames, len(question.lower)))

    peers = tuple(
        Peer(name, module, solve, math.isfinite)
        for name, module, solve in (
            ("breaks", "numpy", breaks),
            ("lies", "numpy", lies),
            ("absent", "no_such_module", lies),
        )
    )
    monkeypatch.setattr(measuring, "PEERS", peers)
    case = Case(name="tiny", about="", powers={SO: (2.0,)}, sizes=((2, 8, 3),))
    rows = {row["by"]: row for row in measuring.measure(case, Path(), None) if "alone" not in row["what"]}
    assert len(rows) == 5
    assert rows["breaks"]["note"] == "ValueError: no"
    assert "not installed" in rows["absent"]["note"]
    assert rows["lies"]["kept"] == 0
    assert "objective" not in rows["lies"]
    largest = np.abs(synthetic(2, 8, 3, SO).motion.trajectory.generalized_forces).max()
    assert rows["lies"]["equilibrium"] == pytest.approx(largest)
    assert rows["trajectory-wide"]["kept"] == 3


@pytest.mark.parametrize("kind", [SO, SCSO, FULL])
def test_the_question_has_the_packages_own_numbers(kind):
    """Equations, rows and Hessian as arrays give what the solution says of itself."""
    problem = synthetic(3, 12, 4, kind)
    solution = scso.solve_trajectory(problem)
    question = ask(problem)
    x = np.hstack([solution.activation, solution.control])
    assert question.objective(x).sum() == pytest.approx(solution.objective, rel=1e-12)
    assert question.missed(x)["equilibrium"].max() < 1e-8
    worse = x + 0.01
    value = np.einsum("kcn,kn->kc", question.equations, worse) - question.moments
    assert question.missed(worse)["equilibrium"] == pytest.approx(np.abs(value).max(axis=1))
    if kind == SCSO:
        rows = solution.rows["CoordinateStability"].value
        margin = np.einsum("krn,kn->kr", question.rows, x) - question.levels
        assert margin == pytest.approx(rows, abs=1e-9)
    if kind == FULL:
        matrix = np.einsum("kijn,kn->kij", question.matrices, x) + question.constant
        assert matrix == pytest.approx(solution.matrices["HessianStability"].value, abs=1e-9)


def test_forces_of_muscles_without_capacity_are_none_or_unknown():
    problem = synthetic(2, 8, 3, SO)
    trajectory = problem.motion.trajectory
    capacity = trajectory.active_force_capacity.copy()
    capacity[1, 0] = 0.0
    trajectory = dataclasses.replace(trajectory, active_force_capacity=capacity)
    problem = dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, trajectory=trajectory))
    solution = scso.solve_trajectory(problem)
    question, forces = ask(problem), solution.tendon_force.copy()
    x = np.hstack([solution.activation, solution.control])
    assert question.missed(x, forces)["equilibrium"].max() < 1e-8
    forces[1, 0] = 1.0
    assert np.isnan(question.missed(x, forces)["equilibrium"]).tolist() == [False, True, False]
    forces[1, 0], forces[2, 0] = 0.0, forces[2, 0] + 100.0
    arms = np.abs(trajectory.moment_arms[2, :, 0]).max()
    assert question.missed(x, forces)["equilibrium"][2] == pytest.approx(100 * arms)


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
@pytest.mark.parametrize("kind", [SO, SCSO, FULL])
@pytest.mark.parametrize("power", [2.0, 3.0, 10.0, math.inf])
def test_peers_have_our_optimum(peer, kind, power):
    pytest.importorskip(peer.module)
    problem = synthetic(3, 12, 4, kind)
    problem = dataclasses.replace(problem, objectives=(scso.ActivationEffort(exponent=power),))
    question = ask(problem)
    if not peer.can(question):
        pytest.skip("not of its kind")
    x = peer.solve(question)
    missed = question.missed(x)
    solution = scso.solve_trajectory(problem)
    ours = question.objective(np.hstack([solution.activation, solution.control]))
    assert max(missed["equilibrium"].max(), missed["stability"].max()) < measuring.KEPT
    assert question.objective(x) == pytest.approx(ours, rel=1e-4)


def test_pages_are_made_of_a_result(result, tmp_path):
    found = json.loads(result.read_text())
    run = {"by": "scso run", "seconds": 2.0, "cpu_seconds": 3.0, "frames": 100, "peak_mb": 150.0}
    # one core, which others have kept from it for a while
    theirs = {**run, "by": "OpenSim", "what": "OpenSim's StaticOptimization", "frames": 10}
    theirs |= {"seconds": 50.0, "cpu_seconds": 30.0}
    slope = [
        {"case": "synthetic_frames", "what": "SO, alone", "by": "trajectory-wide", "power": 2.0, "frames": n}
        | {"seconds": n / 1e3, "cpu_seconds": n / 1e3, "peak_mb": 100.0, "solving_mb": n**0.5}
        for n in (250, 1000, 4000)
    ]
    found["rows"] += [{"case": "walk", "what": "whole run, SO", **run}, {"case": "walk", **theirs}, *slope]
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("Speedy\n\nSpeed: old\nand more\n\nafter\n")
    page.write_pages(found, "result.json", tmp_path)
    text = (tmp_path / "docs" / "benchmarks.md").read_text()
    assert "| walk | 10 | 3e+03 | 150 |  |  |  |" in text
    ratios = [
        line.split(" | ") for line in text.splitlines() if line.startswith("| synthetic_smallest | full,")
    ]
    assert len(ratios[0]) == 12
    assert float(ratios[0][4]) > 0
    assert "| SO | 250 to 4000 | 1.00 | 1.00 | 0.50 |" in text
    assert text.count(f"\n| {SMALLEST} | SO, ") >= len(OURS) + 3  # one line of ratios, two solvers, memory
    readme = (tmp_path / "README.md").read_text()
    assert readme.startswith("Speedy\n\nSpeed: seconds of whole runs")
    assert readme.endswith(".\n\nafter\n")
    assert "walk, 100 frames: 30.0 (10 of them), 2.0, –, –." in readme.replace("\n", " ")
    assert "old" not in readme
    assert "and more" not in readme


@pytest.mark.opensim
def test_the_cases_kept_over_commits_are_solved():
    small = Solve()
    motion = small.setup_cache()
    for power in Solve.params:
        small.setup(motion, power)
        small.time_static_optimization(motion, power)
        small.time_stable(motion, power)
        small.peakmem_stable(motion, power)


def test_the_fast_path_is_where_a_cold_start_ends(tmp_path, capsys):
    written = tmp_path / "table.md"
    words = ["--cases", "synthetic_smallest", "--frames", "4", "--output", str(written)]
    assert same_answers.main(words) == 0
    assert written.read_text(encoding="utf-8") == capsys.readouterr().out
    rows = [line.strip("| \n").split(" | ") for line in written.read_text(encoding="utf-8").splitlines()[2:]]
    assert [row[2] for row in rows] == ["2", "3", "10", "inf"] * 2 + ["2"]
    for *_, power, frames, lost, apart, _, above, _ in rows:
        assert (frames, lost) == ("4", "0")
        assert float(above) < 1e-8
        assert float(apart) < 1e-6 if power in ("2", "3") else apart == "nan"


def test_every_case_says_what_it_is():
    assert len({case.name for case in CASES}) == len(CASES)
    assert all(case.about and case.powers for case in CASES)
    assert all(bool(case.sizes) + (case.setup is not None) + (case.make is not None) == 1 for case in CASES)


def test_a_case_whose_process_breaks_is_a_line_and_asked_again(tmp_path, monkeypatch):
    monkeypatch.setattr(command.sys, "executable", "false")
    output = tmp_path / "result.json"
    assert command.main(["--cases", SMALLEST, "--output", str(output)]) == 1
    found = json.loads(output.read_text())
    assert found["seconds"] == {}
    assert found["rows"][0]["note"] == "the process of this case ended with 1"
