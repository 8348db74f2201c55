"""The README keeps its word: its Python runs, its commands exist, its figure is there.

``python tests/test_readme.py`` writes its table of result files again, from their declarations.
"""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from conftest import PROJECT_ROOT
from typer.main import get_command
from typer.testing import CliRunner

import scso_nlp as scso
from scso_nlp.cli import app
from scso_nlp.examples import example_folder
from scso_nlp.report.contents import RESULT_FILES
from scso_nlp.report.results import FIGURES

PATH = PROJECT_ROOT / "README.md"
README = PATH.read_text(encoding="utf-8")
#: Rows of the table of result files between its head and the one of the report.
ROWS = re.compile(r"(?<=\| file \| what \|\n\|---\|---\|\n).*?(?=\| `report\.json`)", flags=re.S)


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.S)


@pytest.mark.opensim
def test_the_python_blocks_run_in_order(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    follow({})


def follow(changes):
    """Run all Python of the README in the working folder, with some of its words replaced."""
    names = {}
    for block in blocks("python"):
        for word, other in changes.items():
            block = block.replace(word, other)
        exec(compile(block, "README.md", "exec"), names)
    assert names["solution"].is_solved.all()
    assert Path("results", "report.json").is_file()
    both = scso.solve_trajectory(names["problem"])
    assert set(both.objective_terms) == {"ActivationEffort", "total_force"}


@pytest.fixture
def walk(shared_data, tmp_path, monkeypatch):
    """OpenSim's gait10dof18musc with the first frames of its motion, in the working folder."""
    folder = tmp_path / "gait10dof18musc"
    shutil.copytree(shared_data / "gait10dof18musc", folder)
    setup = (folder / "setup_static_optimization.xml").read_text(encoding="utf-8")
    (folder / "setup.xml").write_text(setup.replace("_time>1.7<", "_time>0.58<"), encoding="utf-8")
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.opensim
def test_the_python_blocks_run_on_a_walk_with_the_q_that_it_takes(walk):
    own = {'example_folder("spine-load-height") / "setup.xml"': '"setup.xml"'}
    with pytest.raises(scso.SolveFailed, match=r"try q = 18: at q = 17\.\d+ and above the failed frames"):
        follow(own)
    follow(own | {"q=5.0": "q=18"})


def test_the_first_example_is_short():
    lines = [line for line in blocks("python")[0].splitlines() if line.strip()]
    assert len(lines) <= 12


def test_every_command_and_option_exists():
    commands = get_command(app).commands
    lines = [line.split("#")[0].strip() for block in blocks("sh") for line in block.splitlines()]
    words = [shlex.split(part) for line in lines for part in line.split("&&")]
    seen = [word for word in words if word and word[0] == "scso"]
    assert len(seen) >= 5
    for word in seen:
        known = {option for parameter in commands[word[1]].params for option in parameter.opts}
        assert {option for option in word if option.startswith("--")} <= known


#: What README's lines on the command line end in, with the first frames of a motion that its words fit.
ENDS = {
    "run": "results in ",
    "init": "then scso run scso.toml",
    "info": "knee_r",
    "doctor": "knee_r",
    "example": "spine-load-height",
    "compare": "From 5 of 5 frames.",
    "plot": "85 mm wide",
    "report": "1 result, ",
    "reach": "static optimization keeps all rows from q = ",
}


COMMANDS, STUDIES = blocks("sh")[-2:]


@pytest.mark.opensim
def test_the_lines_about_studies_run_as_printed(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="needs Dask; pip install '.[studies]' brings it")
    shutil.copytree(example_folder("elbow"), tmp_path / "trials" / "S1" / "hold")
    (tmp_path / "trials/S1/hold/scso.toml").unlink()
    monkeypatch.chdir(tmp_path)
    line = STUDIES.split("#")[0]
    for words, said in ((line, "3 runs"), (line.replace("--dry-run", ""), "3 done (3 run now)")):
        done = CliRunner().invoke(app, shlex.split(words)[1:], prog_name="scso")
        assert done.exit_code == 0, (words, done.output)
        assert said in done.output


@pytest.mark.opensim
def test_every_command_line_runs_as_printed_on_a_model_that_its_words_fit(walk, monkeypatch):
    """Only the figures are left out."""
    monkeypatch.setattr("scso_nlp.report.results.FIGURES", {})
    seen = []
    for line in COMMANDS.splitlines():
        _, command, *arguments = shlex.split(line.split("#")[0])
        done = CliRunner().invoke(app, [command, *arguments], prog_name="scso")
        # the doctor finds residuals that no muscle carries: its exit code is advice
        assert done.exit_code in ((0, 1) if command == "doctor" else (0,)), (line, done.output)
        assert ENDS[command] in done.output, (line, done.output)
        seen.append(command)
    assert set(seen) == set(ENDS)
    for results in ("results_a", "results_b", "scso_results/setup", "scso_results/scso"):
        assert (walk / results / "report.json").is_file()


def rows():
    """The rows as they should be."""
    names = [file.name.format(name="<name>", analysis="StaticOptimization") for file in RESULT_FILES]
    return "".join(f"| `{name}` | {file.holds} |\n" for name, file in zip(names, RESULT_FILES, strict=True))


def test_every_result_file_is_in_the_table():
    assert ROWS.findall(README) == [rows()], "run: python tests/test_readme.py"


def test_every_figure_is_named():
    assert [figure for figure in FIGURES if f"_{figure}`" not in README] == []


def test_the_readme_is_short_and_its_links_lead_somewhere():
    assert len(README.splitlines()) < 220
    for target in re.findall(r"\]\(([^)]+)\)", README):
        assert (PROJECT_ROOT / target).is_file(), target


if __name__ == "__main__":
    PATH.write_text(ROWS.sub(lambda _: rows(), README), encoding="utf-8")
