"""Stages are shown in a terminal and in a notebook, only while they last; what is short shows nothing."""

import io
import logging
import sys
from types import SimpleNamespace

import pytest

from scso_nlp.messages import COUNTS, LOGGER, STAGES
from scso_nlp.progress import stages_shown

CLEAR = "\r\x1b[2K"


class Terminal(io.StringIO):
    def isatty(self):
        return True


def use(monkeypatch, screen, modules=sys.modules):
    monkeypatch.setattr("scso_nlp.progress.sys", SimpleNamespace(stderr=screen, modules=modules))


@pytest.fixture
def terminal(monkeypatch):
    screen = Terminal()
    use(monkeypatch, screen)
    monkeypatch.setenv("COLUMNS", "30")
    return screen


def test_a_terminal_shows_stages_and_counts_in_one_line_and_is_cleared(terminal):
    with stages_shown(delay=0.0):
        STAGES.info("solving %d frames", 3)
        COUNTS.info("a line that is too long for this terminal")
    STAGES.info("after the block")
    lines = ("solving 3 frames ...", "a line that is too long for t", "")
    assert terminal.getvalue() == "".join(f"{CLEAR}{line}" for line in lines)


def test_who_calls_from_python_sees_nothing_of_what_is_short(terminal):
    with stages_shown():
        STAGES.info("solving 3 frames")
    assert terminal.getvalue() == ""


def test_a_block_within_another_adds_nothing_and_what_is_forbidden_stays_so(terminal):
    with stages_shown(delay=0.0), stages_shown(delay=0.0):
        STAGES.info("once")
    assert terminal.getvalue().count("once") == 1
    with stages_shown(False), stages_shown(delay=0.0):
        STAGES.info("not wanted")
    assert "not wanted" not in terminal.getvalue()


@pytest.mark.parametrize(("progress", "shown"), [(None, False), (True, True)])
def test_without_a_terminal_they_are_shown_only_where_asked_for(monkeypatch, progress, shown):
    file = io.StringIO()
    use(monkeypatch, file)
    with stages_shown(progress, delay=0.0):
        STAGES.info("solving 3 frames")
    assert ("solving" in file.getvalue()) == shown


def test_counts_reach_no_log_and_loggers_are_as_before(terminal, monkeypatch):
    kept = []
    log = logging.Handler()
    log.emit = lambda record: kept.append(record.getMessage())
    monkeypatch.setattr(LOGGER, "handlers", [log])
    monkeypatch.setattr(LOGGER, "level", logging.INFO)
    before = [(logger.level, logger.propagate, list(logger.handlers)) for logger in (STAGES, COUNTS)]
    with stages_shown(delay=0.0):
        STAGES.info("solving")
        COUNTS.info("frame 1 of 3")
    assert kept == ["solving"]
    after = [(logger.level, logger.propagate, list(logger.handlers)) for logger in (STAGES, COUNTS)]
    assert after == before


def test_a_notebook_shows_them_in_one_output_that_changes(monkeypatch):
    seen = []

    def display(content, *, raw, display_id):
        assert raw
        assert display_id
        seen.append(("new", content["text/plain"]))
        return SimpleNamespace(update=lambda content, raw: seen.append(("again", content["text/plain"])))

    shell = SimpleNamespace(kernel=object())
    use(monkeypatch, io.StringIO(), {"IPython": SimpleNamespace(get_ipython=lambda: shell)})
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    with stages_shown(delay=0.0):
        STAGES.info("reading")
        COUNTS.info("OpenSim, 3 of 5 frames")
    assert seen == [("new", "reading ..."), ("again", "OpenSim, 3 of 5 frames ..."), ("again", "")]
