"""AnalyzeTool setup files, read without OpenSim."""

import re
from pathlib import Path

import pytest
from tiny_model import Tiny, setup_text

from scso_nlp.exceptions import DataError, FileFormatError
from scso_nlp.opensim.setup_xml import (
    MotionInput,
    check_document,
    read_analyze_setup,
    read_external_loads,
)
from scso_nlp.opensim.worker.exchange import LOAD_DATA


def test_every_setting_of_a_setup_is_read(tiny: Tiny) -> None:
    tiny.setup.write_text(
        setup_text(
            output_precision="12",
            replace_force_set=" True ",
            lowpass_cutoff_frequency_for_coordinates=" 6.5 ",
            results_directory=".\\out\\here",
            step_interval="3",
        ).replace(
            "</StaticOptimization>",
            "<activation_exponent>3.5</activation_exponent>"
            "<use_muscle_physiology>false</use_muscle_physiology></StaticOptimization>",
        )
    )
    setup = read_analyze_setup(tiny.setup)
    assert setup.name == setup.motion.name == "tiny"
    assert setup.analysis_name == "StaticOptimization"
    assert setup.output_precision == 12
    assert setup.results_directory == tiny.folder / "out" / "here"
    assert setup.activation_exponent == 3.5
    assert setup.use_muscle_physiology is False
    assert setup.motion == MotionInput(
        model=tiny.model,
        coordinates=tiny.moving,
        external_loads=tiny.loads,
        actuators=(tiny.actuators,),
        replace_force_set=True,
        initial_time=0.1,
        final_time=0.8,
        lowpass_cutoff_frequency=6.5,
        step_interval=3,
        name="tiny",
    )


def test_what_is_absent_or_empty_is_what_opensim_takes(tiny: Tiny) -> None:
    tiny.setup.write_text(
        """<AnalyzeTool name="old"><model_file>tiny.osim</model_file>
        <coordinates_file>moving.mot</coordinates_file><states_file/><speeds_file> Unassigned </speeds_file>
        <external_loads_file>  </external_loads_file><force_set_files/>
        <AnalysisSet><objects><StaticOptimization/></objects></AnalysisSet></AnalyzeTool>"""
    )
    setup = read_analyze_setup(tiny.setup)
    assert setup.motion == MotionInput(
        model=tiny.model, coordinates=tiny.moving, initial_time=0.0, final_time=1.0, name="old"
    )
    assert (setup.activation_exponent, setup.use_muscle_physiology, setup.output_precision) == (2.0, True, 8)


def test_several_force_sets_and_old_names_are_understood(tiny: Tiny) -> None:
    (tiny.folder / "more.xml").write_text(tiny.actuators.read_text())
    text = setup_text(force_set_files="reserves.xml  more.xml")
    tiny.setup.write_text(text.replace("force_set_files", "actuator_set_files"))
    motion = read_analyze_setup(tiny.setup).motion
    assert [path.name for path in motion.actuators] == ["reserves.xml", "more.xml"]


def test_the_active_static_optimization_is_found_among_other_analyses(tiny: Tiny) -> None:
    others = (
        "<MuscleAnalysis name='m'><on>true</on></MuscleAnalysis>"
        "<StaticOptimization name='first'><on>false</on></StaticOptimization>"
        "<StaticOptimization name='second'><on> 1 </on><step_interval>4</step_interval></StaticOptimization>"
    )
    text = setup_text()
    start, end = text.index("<StaticOptimization"), text.index("</objects>")
    tiny.setup.write_text(text[:start] + others + text[end:])
    setup = read_analyze_setup(tiny.setup)
    assert setup.analysis_name == "second"
    assert setup.motion.step_interval == 4


def test_two_hyphens_in_a_comment_do_no_harm(tiny: Tiny) -> None:
    tiny.setup.write_text(setup_text().replace("<AnalysisSet", "<!--a -- b--><AnalysisSet"))
    assert read_analyze_setup(tiny.setup).name == "tiny"


def test_states_win_over_coordinates_as_in_opensim(tiny: Tiny, caplog: pytest.LogCaptureFixture) -> None:
    tiny.setup.write_text(setup_text(states_file="still.mot"))
    motion = read_analyze_setup(tiny.setup).motion
    assert (motion.states, motion.coordinates) == (tiny.still, None)
    assert any("other motion files are ignored" in message for message in caplog.messages)


def test_a_narrower_range_of_the_analysis_is_reported_not_used(
    tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    """OpenSim 4.6 reads start_time and end_time and then writes every frame of the tool's range."""
    tiny.setup.write_text(
        setup_text().replace("</StaticOptimization>", "<start_time>0.5</start_time></StaticOptimization>")
    )
    assert read_analyze_setup(tiny.setup).motion.initial_time == 0.1
    assert any("start_time 0.5" in message for message in caplog.messages)


ENTITY = '<!DOCTYPE a [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>'
REFUSED = {
    "cut off": (setup_text()[:300], FileFormatError, "is not well-formed XML"),
    "not XML": ("hello", FileFormatError, "is not well-formed XML"),
    "empty": ("", FileFormatError, "is not well-formed XML"),
    "entities": (
        setup_text().replace("<OpenSimDocument", ENTITY + "<OpenSimDocument").replace(">8<", ">&b;<"),
        FileFormatError,
        "declares XML entities",
    ),
    "another tool": (
        "<OpenSimDocument><CMCTool/></OpenSimDocument>",
        FileFormatError,
        "holds CMCTool, expected an AnalyzeTool",
    ),
    "no analysis": (
        setup_text().replace("StaticOptimization", "Kinematics"),
        DataError,
        "found Kinematics, expected a StaticOptimization",
    ),
    "switched off": (setup_text(on="false"), DataError, "StaticOptimization is switched off"),
    "inverse dynamics": (
        setup_text().replace(
            "</StaticOptimization>", "<use_model_force_set>false</use_model_force_set></StaticOptimization>"
        ),
        DataError,
        "use_model_force_set is false",
    ),
    "a word for a number": (
        setup_text(initial_time="soon"),
        FileFormatError,
        "initial_time is 'soon', expected a number",
    ),
    "half a step": (setup_text(step_interval="1.5"), FileFormatError, "expected a whole number"),
    "no step": (setup_text(step_interval="0"), DataError, "step_interval is 0, expected 1 or more"),
    "a word for a flag": (
        setup_text(replace_force_set="maybe"),
        FileFormatError,
        "replace_force_set is 'maybe', expected true or false",
    ),
    "no motion": (setup_text(coordinates_file=""), DataError, "neither coordinates_file nor states_file"),
    "no model": (setup_text(model_file=""), DataError, "model_file is empty"),
    "a missing force set": (
        setup_text(force_set_files="reserves.xml other.xml"),
        DataError,
        "force_set_files 'other.xml' does not exist",
    ),
    "an empty range": (
        setup_text(initial_time="0.9", final_time="0.2"),
        DataError,
        "initial_time 0.9 s is after final_time 0.2 s",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_setup_that_cannot_be_used_is_refused_in_one_sentence(what: str, tiny: Tiny) -> None:
    text, kind, message = REFUSED[what]
    tiny.setup.write_text(text)
    with pytest.raises(kind, match=message) as failure:
        read_analyze_setup(tiny.setup)
    assert "\n" not in str(failure.value)


def test_a_setup_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nothing\.xml does not exist"):
        read_analyze_setup(tmp_path / "nothing.xml")


def test_external_loads_name_their_columns_and_find_their_data(tiny: Tiny) -> None:
    source = read_external_loads(tiny.loads)
    assert source.data == tiny.folder / "hand.mot"
    assert source.identifiers == (("hand", "hand_v"), ("hand", "hand_p"))
    assert f"<datafile>{LOAD_DATA}</datafile>" in source.text


def test_loads_of_a_class_that_opensim_does_not_read_are_refused(tiny: Tiny) -> None:
    tiny.loads.write_text(tiny.loads.read_text().replace("ExternalForce", "PrescribedForce"))
    with pytest.raises(DataError, match="'hand' is a PrescribedForce"):
        read_external_loads(tiny.loads)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"coordinates": "a.mot", "states": "b.sto"}, "either coordinates or states, found both"),
        ({}, "either coordinates or states, found neither"),
        ({"coordinates": "a.mot", "step_interval": 1.5}, "expected a whole number"),
        ({"coordinates": "a.mot", "final_time": float("nan")}, "final_time is not a number"),
    ],
)
def test_a_contradictory_description_is_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(DataError, match=message):
        MotionInput(model=Path("model.osim"), **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("text", ["text", "1_0", "1.2.3", "-NaN", "0x10"])
@pytest.mark.parametrize("tag", ["mass", "max_isometric_force", "tendon_slack_length"])
def test_a_number_of_a_model_for_which_opensim_would_take_its_default_is_refused(
    tag: str, text: str, tiny: Tiny
) -> None:
    tiny.model.write_text(re.sub(f"<{tag}>[^<]*<", f"<{tag}>{text}<", tiny.model.read_text(), count=1))
    with pytest.raises(FileFormatError, match=rf"tiny\.osim: {tag} is '{text}', expected a number"):
        check_document(tiny.model, "Model")
