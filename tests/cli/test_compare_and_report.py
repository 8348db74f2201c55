"""The two commands from result folders on disk to text, files and exit codes."""

import os
import subprocess
import sys

import numpy as np
import pytest
import typer
from solution_by_hand import solution_by_hand
from typer.testing import CliRunner

from scso_nlp.cli.compare import compare
from scso_nlp.cli.report import report
from scso_nlp.report.results import write_solution

APP = typer.Typer()
APP.command()(compare)
APP.command()(report)

MAP = """
format = 1
[groups.front]
muscles = ["front_*"]
channels = ["ch1"]
[groups.back]
muscles = ["back_*"]
[pairs."front over back"]
numerator = ["front"]
denominator = ["back"]
"""


def call(*arguments):
    return CliRunner().invoke(APP, [str(argument) for argument in arguments])


@pytest.fixture
def runs(tmp_path):
    """Result folders of the same motion with and without stability rows, EMG and a map."""
    for label, stability, tonus in (("so", False, 0.0), ("scso", True, 0.05)):
        solution = solution_by_hand(21, stability=stability, tonus=tonus)
        write_solution(solution, tmp_path / label, figures=False)
    time = np.arange(-100, 1200) / 1000
    rows = "\n".join(f"{t:.3f},{0.1 + 0.05 * np.sin(6 * t):.6f}" for t in time)
    (tmp_path / "emg.csv").write_text(f"time,ch1\n{rows}\n")
    (tmp_path / "map.toml").write_text(MAP)
    return tmp_path


def test_compare_prints_a_table_and_writes_csv_and_figures(runs):
    emg = ("--emg", runs / "emg.csv", "--emg-map", runs / "map.toml")
    found = call("compare", runs / "so", runs / "scso", *emg, "--output", runs / "out")
    assert found.exit_code == 0, found.output
    assert found.output.splitlines()[0].split() == ["metric", "group", "unit", "so", "scso", "EMG"]
    assert "front over back" in found.output
    assert "From 21 of 21 frames." in found.output
    assert {path.name for path in (runs / "out").iterdir()} == {
        "comparison.csv",
        *(f"comparison_{what}.{kind}" for what in ("activity", "mean_activity") for kind in ("png", "pdf")),
    }


def test_a_figure_that_fails_costs_compare_neither_table_nor_exit_code(runs, monkeypatch):
    def broken(*_):
        raise RuntimeError("no such font")

    monkeypatch.setattr("scso_nlp.figures.activity_pages", broken)
    found = call("compare", runs / "so", runs / "scso", "--output", runs / "out")
    assert (found.exit_code, found.stderr) == (
        0,
        "scso: the figure comparison_activity is left out: no such font\n",
    )
    assert "table and figures in" in found.stdout
    left = {path.name for path in (runs / "out").iterdir()}
    assert left == {"comparison.csv", "comparison_mean_activity.png", "comparison_mean_activity.pdf"}


def test_dollars_in_labels_are_no_mathematics(runs):
    found = call("compare", runs / "so", runs / "scso", "--labels", "$_$,$^$", "--output", runs / "out")
    assert (found.exit_code, found.stderr) == (0, "")
    page = call("report", runs / "so", runs / "scso", "--labels", "$_$,$^$", "--output", runs / "a.html")
    assert (page.exit_code, page.stderr) == (0, "")


def test_report_writes_one_page(runs):
    found = call("report", runs / "so", runs / "scso", "--labels", "SO,SCSO", "--output", runs / "page.html")
    assert found.exit_code == 0, found.output
    text = (runs / "page.html").read_text(encoding="utf-8")
    assert "<h3>SCSO</h3>" in text
    assert "21 of 21 frames solved" in text


def test_report_of_a_run_that_failed_says_what_is_missing(runs):
    write_solution(solution_by_hand(21, failed=(1, 3)), runs / "bad")
    found = call("report", runs / "bad", "--output", runs / "page.html")
    assert found.exit_code == 0, found.output
    assert "a run that failed" in found.output
    text = (runs / "page.html").read_text(encoding="utf-8")
    assert "<h3>bad</h3>" in text
    assert "19 of 21 frames solved" in text
    assert "it left no activations" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["compare", "nothing"], "is not a folder"),
        (["compare", "so", "--peak-emg"], "there is no --emg"),
        (["compare", "so", "--emg", "emg.csv"], "needs a map file"),
        (["compare", "so", "so"], "given twice"),
        (["compare", "so", "scso", "--labels", "a"], "1 labels for 2 results"),
        (
            ["compare", "so", "--emg", "emg.csv", "--emg-map", "map.toml", "--emg-offset", "50"],
            "the motion needs",
        ),
        (["compare", "so", "--output", "map.toml"], "cannot be made"),
        (["report", "so", "--output", "no/page.html"], "cannot be written"),
    ],
)
def test_what_cannot_be_used_ends_with_code_2_and_one_sentence(runs, arguments, message):
    files = [
        runs / a if (runs / a).exists() or a in ("nothing", "no/page.html") else a for a in arguments[1:]
    ]
    found = call(arguments[0], *files)
    assert found.exit_code == 2, found.output
    assert found.output.splitlines()[-1].startswith("error: ")
    assert message in found.output


@pytest.mark.skipif(sys.platform == "win32", reason="needs pipes as POSIX has them")
def test_a_reader_that_closes_the_pipe_is_no_bug_and_the_files_are_written(runs):
    command = [sys.executable, "-m", "scso_nlp", "compare", "so", "scso", "--output", "out"]
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            command, cwd=runs, stdout=writer, stderr=subprocess.PIPE, text=True, check=False
        )
    finally:
        os.close(writer)
    # 128 + SIGPIPE, what a shell says of a program that ends this way
    assert (done.returncode, done.stderr) == (141, "")
    assert (runs / "out" / "comparison.csv").is_file()


@pytest.mark.parametrize("command", ["compare", "report"])
def test_a_run_that_left_no_activations_says_why_and_what_to_do(runs, command):
    write_solution(solution_by_hand(21, failed=(1, 3)), runs / "bad")
    found = call(command, runs / "bad", *([runs / "so"] if command == "report" else []))
    assert found.exit_code == 2
    assert (
        "bad has no activations, because 2 of 21 frames failed; run again with --keep-failed" in found.stderr
    )
