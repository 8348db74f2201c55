"""``scso plot``: from result folders to figures for print."""

import pytest
import typer
from solution_by_hand import solution_by_hand
from typer.testing import CliRunner

from scso_nlp.cli.compare import compare
from scso_nlp.cli.plot import plot
from scso_nlp.report.results import write_solution

APP = typer.Typer()
APP.command()(plot)
APP.command()(compare)


def call(*arguments):
    return CliRunner().invoke(APP, ["plot", *map(str, arguments)])


@pytest.fixture
def runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for label, stability, tonus in (("so", False, 0.0), ("scso", True, 0.05)):
        solution = solution_by_hand(21, stability=stability, tonus=tonus, sides=("vasti_r", "vasti_l"))
        write_solution(solution, tmp_path / "runs" / label, figures=False)
    return tmp_path


def test_two_results_are_drawn_in_the_formats_and_the_width_that_are_asked_for(runs):
    options = ("--format", "pdf,svg,png", "--dpi", 100, "--columns", 1, "--percent", "--muscles", "vasti*")
    found = call("runs/so", "runs/scso", *options)
    assert (found.exit_code, found.stderr) == (0, "")
    names = [f"antagonists_activation.{kind}" for kind in ("pdf", "svg", "png")]
    assert found.stdout == f"{', '.join(names)}: 85 mm wide\n"
    assert {path.name for path in runs.iterdir()} == {"runs", *names}
    assert int.from_bytes((runs / names[2]).read_bytes()[16:20]) == 334  # 85 mm at 100 dots per inch
    text = (runs / names[1]).read_text(encoding="utf-8")
    for word in ("vasti_0", "so", "scso", "right", "left", "Cycle [%]", "Activation [-]"):
        assert f">{word}<" in text, word


@pytest.mark.parametrize("quantity", ["activation", "force", "stability", "moment"])
@pytest.mark.parametrize(
    ("width", "shown"), [("85mm", "85"), ("8.5 cm", "85"), ("4in", "101.6"), ("90", "90")]
)
def test_every_quantity_has_a_figure_of_any_width(runs, quantity, width, shown):
    options = ("--quantity", quantity, "--width", width, "--format", "svg", "--events", "0.1,0.5,0.9")
    found = call("runs/scso", *options, "--output", runs / "figure")
    assert (found.exit_code, found.stderr) == (0, "")
    assert found.stdout == f"{runs / 'figure'}.svg: {shown} mm wide\n"


def test_tasks_have_their_names(runs):
    names = [f"task {k}" for k in range(21)]
    assert call("runs", "--tasks", ",".join(names), "--format", "svg", "--output", "tasks").exit_code == 0
    text = (runs / "tasks.svg").read_text(encoding="utf-8")
    assert all(f">{name}<" in text for name in names)
    assert ">Task<" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--muscles", "vesti*"], "pattern 'vesti*' fits no muscle (closest: vasti_r_0, vasti_l_0)"),
        (["--quantity", "power"], "the quantity is 'power', expected one of activation, force"),
        (["--quantity", "reaction"], "run again with --joint-reactions"),
        (["--width", "wide"], "--width is 'wide', expected a length such as 85mm"),
        (["--width", "3 m"], "--width is '3 m', expected a length"),
        (["--width", "9"], "the figure's width is 9 mm, expected 50 to 500 mm"),
        (["--events", "0.1,late"], "--events: 'late' is not a number, expected times in s"),
        (["--events", "0.1,7"], "the events reach from 0.1 to 7 s, expected times within the motion"),
        (["--format", "bmp"], "figures cannot be written as 'bmp', expected some of pdf, svg, png"),
        (["--output", "nowhere/figure"], "nowhere/figure.pdf cannot be written: No such file"),
        (["--labels", "a,b"], "2 labels for 1 results"),
        (["--tasks", "a,b"], "2 task names for 21 frames"),
    ],
)
def test_what_cannot_be_drawn_ends_with_code_2_and_one_sentence(runs, options, message):
    found = call("runs/scso", *options)
    assert found.exit_code == 2, found.output
    assert found.stderr.startswith("error: ")
    assert len(found.stderr.splitlines()) == 1
    assert message in found.stderr
    assert {path.name for path in runs.iterdir()} == {"runs"}


def test_a_folder_without_results_is_one_sentence(runs):
    found = call("nothing")
    assert (found.exit_code, "nothing is not a folder" in found.stderr) == (2, True)
