"""Folder layouts that labs have: what is recognised, by what, and what is said to be missing."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path

import pytest

import scso_nlp as scso
from scso_nlp.examples import example_folder
from scso_nlp.studies import Plan, plan
from scso_nlp.studies.layouts import LAYOUTS

ELBOW = example_folder("elbow")
#: What an OpenCap session says of itself, beside much of its cameras.
METADATA = "subjectID: {subject}\nmass_kg: 70.5\nheight_m: 1.8\nopenSimModel: LaiUhlrich2022\n"


def put(folder: Path, **names: str | Iterable[str]) -> None:
    """Copy files of the elbow, each under one or several other names."""
    for kind, several in names.items():
        source = next(ELBOW.glob(f"{kind}.*"))
        for name in [several] if isinstance(several, str) else several:
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, target)


def read_by(found: Plan, root: Path) -> list[tuple[str, ...]]:
    """Name of every trial, and the files that it would be made of, by their places."""
    rows = []
    for trial in found.trials:
        motion = trial.settings.motion if trial.settings else None
        files = (motion.model, motion.motion, motion.external_loads) if motion else ()
        rows.append(
            (
                f"{trial.subject}/{trial.trial}",
                *("" if p is None else str(p.relative_to(root)) for p in files),
            )
        )
    return rows


def opencap(session: Path, subject: str, *motions: str) -> None:
    data = session / "OpenSimData"
    put(data, elbow="Model/LaiUhlrich2022_scaled.osim", motion=[f"Kinematics/{name}.mot" for name in motions])
    (session / "MarkerData").mkdir()
    (session / "sessionMetadata.yaml").write_text(METADATA.format(subject=subject))


def test_opencap_sessions(tmp_path):
    opencap(tmp_path / "OpenCapData_1a", "Ada", "squats", "walk")
    opencap(tmp_path / "OpenCapData_2b", "'007'", "walk")
    dynamics = tmp_path / "OpenCapData_1a/OpenSimData/Dynamics"
    put(dynamics, external_loads="walk/external_loads.xml", loads="walk/loads.mot")
    (tmp_path / "OpenCapData_2b/scso.toml").write_text("exponent = 3.0\n")
    found = plan(tmp_path)
    assert found.source.endswith("(OpenCap sessions)")
    data = "OpenCapData_1a/OpenSimData"
    model = f"{data}/Model/LaiUhlrich2022_scaled.osim"
    assert read_by(found, tmp_path) == [
        ("Ada/squats", model, f"{data}/Kinematics/squats.mot", ""),
        ("Ada/walk", model, f"{data}/Kinematics/walk.mot", f"{data}/Dynamics/walk/external_loads.xml"),
        (
            "007/walk",
            "OpenCapData_2b/OpenSimData/Model/LaiUhlrich2022_scaled.osim",
            "OpenCapData_2b/OpenSimData/Kinematics/walk.mot",
            "",
        ),
    ]
    assert [trial.lacks for trial in found.trials] == [
        "not found: external_loads (Dynamics/squats/*.xml)",
        "",
        "not found: external_loads (Dynamics/walk/*.xml)",
    ]
    assert [trial.settings.exponent for trial in found.trials] == [2.0, 2.0, 3.0]
    assert [trial.settings.motion.name for trial in found.trials] == ["squats", "walk", "walk"]


def test_an_opencap_session_without_a_model_or_with_two_is_said(tmp_path):
    opencap(tmp_path / "one", "Ada", "walk")
    opencap(tmp_path / "two", "Bea", "walk")
    next((tmp_path / "one").rglob("*.osim")).unlink()
    put(tmp_path / "two/OpenSimData", elbow="Model/other.osim")
    first, second = plan(tmp_path).trials
    assert "names no motion, expected setup, or model and coordinates" in first.problem
    assert "not found: model (OpenSimData/Model/*.osim)" in first.problem
    assert (
        "model (2 are there: LaiUhlrich2022_scaled.osim, other.osim; name one in scso.toml)" in second.problem
    )
    (tmp_path / "two/scso.toml").write_text('model = "OpenSimData/Model/other.osim"\n')
    assert plan(tmp_path).trials[1].settings.motion.model.name == "other.osim"


@pytest.mark.parametrize("text", ["", "a: [", "- 3", "subjectID:"])
def test_a_session_whose_metadata_name_nobody_is_called_by_its_folder(tmp_path, text):
    opencap(tmp_path / "session", "Ada", "walk")
    (tmp_path / "session/sessionMetadata.yaml").write_text(text)
    if text == "a: [":
        with pytest.raises(scso.FileFormatError, match=r"sessionMetadata\.yaml is not YAML"):
            plan(tmp_path)
    else:
        assert plan(tmp_path).trials[0].subject == "session"


def test_pose2sim_trials(tmp_path):
    (tmp_path / "Config.toml").write_text("[project]\n")
    for trial in ("Trial_1", "Trial_2"):
        (tmp_path / trial / "pose-3d").mkdir(parents=True)
        (tmp_path / trial / "Config.toml").write_text("[project]\n")
    put(tmp_path / "Trial_1/kinematics", elbow="Trial_1_0-90.osim", motion="Trial_1_0-90.mot")
    put(tmp_path / "Trial_1", external_loads="grf.xml", loads="loads.mot")
    both = ("Trial_2_P0", "Trial_2_P1")
    put(
        tmp_path / "Trial_2/kinematics",
        elbow=[f"{name}.osim" for name in both],
        motion=[f"{name}.mot" for name in both],
    )
    found = plan(tmp_path)
    assert found.source.endswith("(Pose2Sim trials)")
    lab = tmp_path.name
    inside = "Trial_2/kinematics/Trial_2"
    assert read_by(found, tmp_path) == [
        (
            f"{lab}/Trial_1",
            "Trial_1/kinematics/Trial_1_0-90.osim",
            "Trial_1/kinematics/Trial_1_0-90.mot",
            "Trial_1/grf.xml",
        ),
        (f"{lab}/Trial_2_Trial_2_P0", f"{inside}_P0.osim", f"{inside}_P0.mot", ""),
        (f"{lab}/Trial_2_Trial_2_P1", f"{inside}_P1.osim", f"{inside}_P1.mot", ""),
    ]


def test_pose2sim_participants(tmp_path):
    for folder in ("", "Ada", "Bea"):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "Config.toml").write_text("[project]\n")
    for place in ("Ada/Trial_1", "Bea/Trial_1"):
        put(tmp_path / place / "kinematics", elbow="scaled.osim", motion="Trial_1.mot")
    assert [row[:2] for row in read_by(plan(tmp_path), tmp_path)] == [
        ("Ada/Trial_1", "Ada/Trial_1/kinematics/scaled.osim"),
        ("Bea/Trial_1", "Bea/Trial_1/kinematics/scaled.osim"),
    ]


def test_nmsm_trees(tmp_path):
    gaits = ("gait_1", "gait_2")
    for subject in ("Patient1", "Patient2"):
        put(tmp_path / subject, elbow="model.osim")
        put(
            tmp_path / subject / "preprocessed",
            motion=[f"IKData/{name}.sto" for name in gaits],
            loads=[f"GRFData/{name}.sto" for name in gaits],
        )
    loads = (ELBOW / "external_loads.xml").read_text().replace("loads.mot", "GRFData/gait_2.sto")
    (tmp_path / "Patient1/preprocessed/gait_2_loads.xml").write_text(loads)
    found = plan(tmp_path)
    assert found.source.endswith("(an NMSM tree)")
    assert read_by(found, tmp_path) == [
        (
            f"{subject}/{gait}",
            f"{subject}/model.osim",
            f"{subject}/preprocessed/IKData/{gait}.sto",
            "Patient1/preprocessed/gait_2_loads.xml" if (subject, gait) == ("Patient1", "gait_2") else "",
        )
        for subject in ("Patient1", "Patient2")
        for gait in gaits
    ]
    assert found.trials[0].lacks == "not found: external_loads (an ExternalLoads file for GRFData/gait_1.*)"


def test_ceinms_trees(tmp_path):
    put(tmp_path / "S1", elbow="scaled.osim")
    put(tmp_path / "S1/walk1", motion=["ik.mot", "id.sto"], external_loads="grf.xml", loads="loads.mot")
    put(tmp_path / "S1/walk2", motion=["walk2_ik.sto", "emgFilt.sto"])
    put(tmp_path / "S2/run/model", elbow="run.osim")
    put(tmp_path / "S2/run", motion=["inverse_kinematics.mot", "inverse_dynamics.sto"])
    put(tmp_path / "S2/static", motion=["ik.mot"])
    found = plan(tmp_path)
    assert found.source.endswith("(a CEINMS tree)")
    assert read_by(found, tmp_path) == [
        ("S1/walk1", "S1/scaled.osim", "S1/walk1/ik.mot", "S1/walk1/grf.xml"),
        ("S1/walk2", "S1/scaled.osim", "S1/walk2/walk2_ik.sto", ""),
        ("S2/run", "S2/run/model/run.osim", "S2/run/inverse_kinematics.mot", ""),
    ]


def test_setups_win_over_other_layouts(tmp_path):
    """Whoever has setups has said what is to be run."""
    opencap(tmp_path / "session", "Ada", "walk")
    put(tmp_path / "session/so", **{name: next(ELBOW.glob(f"{name}.*")).name for name in ("elbow", "motion")})
    put(tmp_path / "session/so", external_loads="external_loads.xml", loads="loads.mot", setup="setup.xml")
    assert [trial.source.name for trial in plan(tmp_path).trials] == ["setup.xml"]


@pytest.mark.parametrize("find", LAYOUTS.values(), ids=LAYOUTS)
def test_a_recogniser_finds_nothing_where_nothing_is(tmp_path, find):
    put(tmp_path / "papers", motion="data.mot", elbow="model.osim")
    (tmp_path / "papers/Config.toml").write_text("[project]\n")
    (tmp_path / "papers/kinematics.txt").write_text("walk")
    assert find(tmp_path) == ()
