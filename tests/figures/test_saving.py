"""Figures are written twice, whole or not at all."""

import pytest
from matplotlib.figure import Figure

from scso_nlp.exceptions import DataError
from scso_nlp.figures import save_figure


def test_a_figure_is_written_to_look_at_and_for_print(tmp_path):
    save_figure(Figure(), tmp_path, "walk")
    assert {path.name for path in tmp_path.iterdir()} == {"walk.png", "walk.pdf"}
    assert (tmp_path / "walk.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "walk.pdf").read_bytes().startswith(b"%PDF")


def test_a_folder_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(DataError, match=r"walk\.png cannot be written: No such file"):
        save_figure(Figure(), tmp_path / "nowhere", "walk")
