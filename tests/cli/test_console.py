"""What a command says while it works: stages in a terminal, warnings in groups and not twice."""

import logging
import os
import pty
import subprocess
import sys
import time

import pytest

from scso_nlp.cli.console import Console
from scso_nlp.examples import example_folder
from scso_nlp.messages import LOGGER, STAGES, kept_warnings
from scso_nlp.progress import stages_shown


@pytest.fixture
def console():
    found = Console(verbose=False)
    LOGGER.addHandler(found)
    yield found
    LOGGER.removeHandler(found)


def test_warnings_are_kept_each_once_in_their_order():
    with kept_warnings() as kept:
        for text in ("second is long", "first", "first"):
            LOGGER.warning(text)
        LOGGER.info("no warning")
    LOGGER.warning("after the block")
    assert list(kept) == ["second is long", "first"]


def test_warnings_that_are_held_back_are_told_in_one_group_the_shortest_first(console, capsys):
    with kept_warnings() as kept, console.held_back():
        LOGGER.warning("a long warning")
        LOGGER.warning("short")
    assert capsys.readouterr().err == ""
    console.tell(kept)
    assert capsys.readouterr().err == "scso: short\nscso: a long warning\n"
    LOGGER.warning("at once again")
    assert capsys.readouterr().err == "scso: at once again\n"


def fail():
    LOGGER.warning("a reason, perhaps")
    raise KeyboardInterrupt


def test_what_fails_writes_what_was_held_back(console, capsys):
    with pytest.raises(KeyboardInterrupt), console.held_back():
        fail()
    assert capsys.readouterr().err == "scso: a reason, perhaps\n"


@pytest.mark.parametrize(
    ("known", "said"),
    [
        (["a", "b", "c"], "scso: the same 2 warnings as in the run before, see report.json\n"),
        (["a"], "scso: a\nscso: b\n"),
        ([], "scso: a\nscso: b\n"),
    ],
)
def test_the_warnings_of_the_run_before_are_not_told_again(known, said, capsys):
    Console(verbose=False).tell(["b", "a"], known)
    assert capsys.readouterr().err == said


def test_control_characters_move_no_cursor(console, capsys):
    LOGGER.warning("red \x1b[31m")
    assert capsys.readouterr().err == "scso: red \\x1b[31m\n"


def test_where_there_is_no_terminal_no_stages_are_shown(capsys):
    with stages_shown():
        STAGES.info("solving 3 frames")
    assert capsys.readouterr() == ("", "")
    assert STAGES.getEffectiveLevel() == logging.getLogger().getEffectiveLevel()


@pytest.mark.opensim
def test_a_terminal_shows_the_stages_and_is_left_clean(tmp_path):
    setup = example_folder("elbow") / "setup.xml"
    ours, theirs = pty.openpty()
    command = (sys.executable, "-m", "scso_nlp", "run", str(setup), "--no-figures", "--output", str(tmp_path))
    run = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    seen = b""
    deadline = time.monotonic() + 120
    # on Linux reading fails when the last writer is gone
    while time.monotonic() < deadline:
        try:
            piece = os.read(ours, 4096)
        except OSError:
            break
        seen += piece
    os.close(ours)
    assert run.wait(60) == 0
    text = seen.decode()
    stages = [text.index(f"\x1b[2K{stage}") for stage in ("starting ...", "reading ", "solving ")]
    assert stages == sorted(stages)
    last = text.rindex("\x1b[2K")
    assert "..." not in text[last:], "a stage was left standing"
    assert "frames solved" in text[stages[-1] :]
