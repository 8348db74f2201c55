"""Figures are written twice, whole or not at all."""

import gc

import pytest
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from scso_nlp.exceptions import DataError
from scso_nlp.figures import draw_and_save, save_figure


def test_a_figure_is_written_to_look_at_and_for_print(tmp_path):
    save_figure(Figure(), tmp_path, "walk")
    assert {path.name for path in tmp_path.iterdir()} == {"walk.png", "walk.pdf"}
    assert (tmp_path / "walk.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "walk.pdf").read_bytes().startswith(b"%PDF")


def test_a_folder_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(DataError, match=r"walk\.png cannot be written: No such file"):
        save_figure(Figure(), tmp_path / "nowhere", "walk")


def test_a_figure_is_laid_out_once_for_both_files_and_keeps_its_layout(tmp_path, monkeypatch):
    asked = []
    figure = Figure(layout="constrained")
    panel = figure.subplots()
    figure.colorbar(panel.imshow([[0.0, 1.0]]))
    layout = figure.get_layout_engine()
    execute = ConstrainedLayoutEngine.execute
    monkeypatch.setattr(
        ConstrainedLayoutEngine, "execute", lambda *args: (asked.append(args), execute(*args))[1]
    )
    save_figure(figure, tmp_path, "walk")
    assert len(asked) == 1
    assert figure.get_layout_engine() is layout
    with pytest.raises(DataError):
        save_figure(figure, tmp_path / "nowhere", "walk")
    assert figure.get_layout_engine() is layout


@pytest.mark.parametrize("is_enabled", [True, False])
def test_drawing_leaves_the_search_for_garbage_as_it_was(tmp_path, caplog, is_enabled):
    def broken():
        assert not gc.isenabled()
        raise RuntimeError("no font")

    was_enabled = gc.isenabled()
    (gc.enable if is_enabled else gc.disable)()
    try:
        draw_and_save(broken, tmp_path, "walk")
        assert gc.isenabled() == is_enabled
    finally:
        (gc.enable if was_enabled else gc.disable)()
    assert "the figure walk is left out: no font" in caplog.text
    assert not list(tmp_path.iterdir())
