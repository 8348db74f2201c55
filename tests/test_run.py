"""One run from settings to files: what is built and judged, and how often."""

from __future__ import annotations

from collections import Counter

import pytest

import scso_nlp.solve.judge
import scso_nlp.solve.verbs
import scso_nlp.transcription.describe
from scso_nlp.examples import example_folder
from scso_nlp.run import run, write_run
from scso_nlp.settings import OutputSettings, read_settings


@pytest.mark.opensim
def test_a_run_on_the_whole_hessian_builds_twice_and_judges_each_answer_once(tmp_path, monkeypatch):
    """The symbolic program of the baseline and of the run itself; writing files and figures asks for none."""
    calls = Counter()

    def counted(name, function):
        def call(*arguments, **options):
            calls[name] += 1
            return function(*arguments, **options)

        return call

    for name, places in {
        "describe": (scso_nlp.solve.verbs, scso_nlp.solve.judge),
        "judge": (scso_nlp.solve.verbs,),
    }.items():
        wrapped = counted(name, getattr(places[0], name))
        for place in places:
            monkeypatch.setattr(place, name, wrapped)
    source = example_folder("spine-load-height") / "scso.toml"
    settings, _ = read_settings(source, {"stability": "full", "q": 5.0})
    result = run(settings)
    assert result.is_solved
    assert result.baseline.stability.rows == result.solution.stability.rows
    assert dict(calls) == {"describe": 2, "judge": 2}
    write_run(result, OutputSettings(folder=tmp_path / "results"))
    assert dict(calls) == {"describe": 2, "judge": 2}, "writing must not ask the symbolic layer"
