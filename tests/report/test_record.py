"""What ``report.json`` says."""

import json
from dataclasses import replace

import pytest
from solution_by_hand import solution_by_hand, write

from scso_nlp.report.record import RunRecord


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
    seconds = report["seconds"]
    assert list(seconds) == ["extraction", "build", "solve", "writing"]
    assert seconds | {"writing": 0} == {"extraction": 1.5, "build": 0.1, "solve": 0.2, "writing": 0}
    assert 0 < seconds["writing"] < 60
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
