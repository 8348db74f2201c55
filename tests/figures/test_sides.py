"""Left and right find each other by the marks of their names, and by nothing else."""

import pytest

from scso_nlp.figures.sides import paired


@pytest.mark.parametrize(
    ("right", "left", "title"),
    [
        ("soleus_r", "soleus_l", "soleus"),
        ("RA_R", "RA_L", "RA"),
        ("r_soleus", "l_soleus", "soleus"),
        ("Right_TA", "left_TA", "TA"),
        ("knee_r_z", "knee_l_z", "knee_z"),
        ("knee_r_on_tibia_r_in_ground_fx", "knee_l_on_tibia_l_in_ground_fx", "knee_on_tibia_in_ground_fx"),
        ("IL_L1_r", "IL_L1_l", "IL_L1"),
        ("TrapeziusR", "TrapeziusL", "Trapezius"),
        ("soleus-r", "soleus-l", "soleus"),
    ],
)
def test_names_that_differ_by_their_side_are_a_pair(right, left, title):
    for names in ((right, "other", left), (left, "other", right)):
        pair, other = paired(names)
        assert (pair.title, list(pair.members.items())) == (title, [("right", right), ("left", left)])
        assert other.members == {"": "other"}


@pytest.mark.parametrize(
    "names",
    [
        ("gas_m", "gas_l"),  # medial and lateral
        ("soleus_r", "gastroc_l"),
        ("r", "l_1"),
        ("hand_r_on_l", "hand_l_on_l"),
        ("twist_left", "abduction_right"),
    ],
)
def test_other_names_are_no_pairs(names):
    assert [(each.title, each.members) for each in paired(names)] == [(name, {"": name}) for name in names]


def test_a_name_without_mark_is_the_other_side_only_where_all_marks_are_of_one_side():
    # as in models whose left side was mirrored from the right one
    (pair, single) = paired(("digastric", "digastric_L", "larynx"))
    assert pair.members == {"right": "digastric", "left": "digastric_L"}
    assert single.members == {"": "larynx"}
    assert len(paired(("digastric", "digastric_L", "neck_R"))) == 3
    assert [each.title for each in paired(("soleus", "soleus_r", "soleus_l"))] == ["soleus", "soleus"]
