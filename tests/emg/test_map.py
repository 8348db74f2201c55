"""Map files with every mistake we know of."""

import pytest

from scso_nlp.emg import EmgMap, GroupPair, MuscleGroup, map_skeleton, read_emg_map
from scso_nlp.exceptions import DataError, FileFormatError, NameMismatchError

MAP = """
format = 1
[groups."rectus, right"]
channels = ["rectabd_r"]
muscles = ["rect_abd_r"]
[groups.back]
channels = ["iliocost_r", "longlumb_r"]
muscles = ["IL_*", "LTp?_r"]
[groups.oblique]
muscles = ["EO"]
[mvc]
rectabd_r = 0.5
[pairs."abdomen over back"]
numerator = ["rectus, right"]
denominator = ["back"]
"""
MUSCLES = ("EO", "IL_1", "IL_2", "LTpL_r", "LTpT_r", "rect_abd_r", "psoas")
CHANNELS = ("iliocost_r", "longlumb_r", "rectabd_r")


def written(tmp_path, text):
    path = tmp_path / "map.toml"
    path.write_text(text)
    return path


def test_a_map_file_is_resolved_to_muscles_in_the_models_order(tmp_path):
    found = read_emg_map(written(tmp_path, MAP)).resolve(MUSCLES, CHANNELS)
    assert [group.name for group in found.groups] == ["rectus, right", "back", "oblique"]
    assert found.groups[1].muscles == ("IL_1", "IL_2", "LTpL_r", "LTpT_r")
    assert found.groups[2].channels == ()
    assert found.mvc == {"rectabd_r": 0.5}
    assert found.pairs == (
        GroupPair(name="abdomen over back", numerator=("rectus, right",), denominator=("back",)),
    )


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        ('"rect_abd_r"', '"rect_abd_R"', NameMismatchError, r"'rect_abd_R' \(closest: rect_abd_r\)"),
        ('"IL_*"', '"LI_*"', NameMismatchError, r"pattern 'LI_\*' fits no muscle in group 'back'"),
        ('"rectabd_r"', '"rectabdr"', NameMismatchError, r"'rectabdr' \(closest: rectabd_r\)"),
        ('"EO"', '"IL_1"', DataError, "muscle 'IL_1' is in two groups, 'back' and 'oblique'"),
        ('"longlumb_r"', '"rectabd_r"', DataError, "channel 'rectabd_r' is in two groups"),
        ('muscles = ["EO"]', "muscles = []", DataError, "group 'oblique' has no muscles"),
        ('muscles = ["EO"]', 'muscle = ["EO"]', FileFormatError, r"unknown key 'muscle' in groups.'oblique'"),
        ('muscles = ["EO"]', 'muscles = "EO"', FileFormatError, "is 'EO', expected a list of names"),
        ("[mvc]", "[scale]\niliocost_r = -1\n[mvc]", FileFormatError, "scale.iliocost_r is -1, expected"),
        ("[mvc]", "[delay]\nrectabd_r = inf\n[mvc]", FileFormatError, "delay.rectabd_r is inf, expect"),
        ("[mvc]", "[delay]\nrect = 0.1\n[mvc]", NameMismatchError, r"channel of \[delay\] in .* 'rect'"),
        ("[mvc]", "[mvcs]", FileFormatError, r"unknown key 'mvcs' \(closest: mvc"),
        ("= 0.5", "= 0", FileFormatError, "mvc.rectabd_r is 0, expected a number above 0"),
        ("= 0.5", "= true", FileFormatError, "mvc.rectabd_r is True"),
        ("= 0.5", "= nan", FileFormatError, "mvc.rectabd_r is nan"),
        ("rectabd_r = 0.5", "rectabd = 0.5", NameMismatchError, r"channel of \[mvc\] in .* 'rectabd'"),
        ("format = 1", "format = 2", FileFormatError, "format is 2, expected format = 1"),
        ("format = 1", "", FileFormatError, "format is 'missing', expected"),
        ("format = 1", "format == 1", FileFormatError, "is not TOML"),
        ('denominator = ["back"]', 'denominator = ["bakc"]', NameMismatchError, r"'bakc' \(closest: back\)"),
        ('denominator = ["back"]', "", DataError, "needs a numerator and a denominator"),
        ('denominator = ["back"]', 'denominator = ["rectus, right"]', DataError, "on both sides"),
    ],
)  # fmt: skip
def test_each_mistake_in_a_map_file_is_named(tmp_path, old, new, error, message):
    assert old in MAP
    text = (
        MAP.replace('channels = ["rectabd_r"]', f"channels = [{new}]")
        if old == '"rectabd_r"'
        else MAP.replace(old, new)
    )
    if old == '"rectabd_r"':
        text = text.replace("[mvc]\nrectabd_r = 0.5\n", "")
    with pytest.raises(error, match=message):
        read_emg_map(written(tmp_path, text)).resolve(MUSCLES, CHANNELS)


def test_a_map_without_groups_is_refused():
    with pytest.raises(DataError, match="has no group"):
        EmgMap(groups=())
    with pytest.raises(DataError, match="group names must be unique"):
        EmgMap(groups=(MuscleGroup(name="a", muscles=("x",)),) * 2)


def test_a_skeleton_is_a_map_of_all_muscles_whatever_they_are_called(tmp_path):
    muscles = ("psoas", 'a "b" \\ c', "12", "soleus_r", "IL_1", "IL_2")
    found = read_emg_map(written(tmp_path, map_skeleton(muscles)))
    assert sorted(m for group in found.groups for m in group.muscles) == sorted(muscles)
    assert found.groups[-1].muscles == ("IL_1", "IL_2")
    text = map_skeleton(["glutäus_1", "glutäus_2", "Gastroc#1"])
    assert '[groups."glutäus_"]' in text
    assert '[groups."Gastroc#1"]' in text
    with pytest.raises(DataError, match="no muscle"):
        map_skeleton(())
