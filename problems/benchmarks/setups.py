"""Setups for recorded data that come without one, to ask OpenSim and this package the same question."""

from __future__ import annotations

import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

from problems.opensim_files import ground_reactions, reserves, with_data
from scso_nlp.io.storage import read_storage, write_storage

#: Reserves of all coordinates at a control of one [N or N·m].
RESERVES = {"*": 10.0}
SETUP = """<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="40600"><AnalyzeTool name="{name}">
<model_file>{model}</model_file><force_set_files>{actuators}</force_set_files>
<results_directory>Results</results_directory>
<initial_time>{start}</initial_time><final_time>{end}</final_time>
<AnalysisSet name="Analyses"><objects><StaticOptimization name="StaticOptimization"><on>true</on>
<step_interval>{step}</step_interval></StaticOptimization></objects></AnalysisSet>
<external_loads_file>{loads}</external_loads_file><coordinates_file>{motion}</coordinates_file>
<lowpass_cutoff_frequency_for_coordinates>{cutoff}</lowpass_cutoff_frequency_for_coordinates>
</AnalyzeTool></OpenSimDocument>
"""


def write_setups(data: Path, folder: Path) -> list[Path]:
    """Write setups for the third-party data that have none, and three of our own.

    Knees that leave their range; patellas in radians, where the data have degrees that OpenSim takes for
    radians and its assembly has to move; and a public model without its muscles: outside the ForceSet, these
    make OpenSim's static optimization read memory that it has not written.

    Parameters
    ----------
    data : Path
        The data sets, one folder each; only read.
    folder : Path
        For the files that are written.

    Returns
    -------
    list of Path
    """
    treadmill, implant, lifting = data / "treadmill", data / "knee_implant", data / "back_lifting"
    found = []
    for trial, start, end in (("walk36", 1.0, 1.3), ("run81", 1.0, 1.2)):
        model = treadmill / "gait2392.osim"
        feet = {"ground": "calcn_r", "l_ground": "calcn_l"}
        found.append(
            _write(
                folder / f"treadmill_{trial}",
                model=model,
                motion=treadmill / trial / "ik.sto",
                loads=ground_reactions(feet, treadmill / trial / "XLD.mot"),
                actuators=reserves(model, RESERVES),
                start=start,
                end=end,
                step=3,
                cutoff=8,
            )
        )
    changes = ("GC5_ss1", "clamped_"), ("GC5_ss1", "agreeing_")
    for trial, changed in (("GC5_ss1", ""), ("GC5_ss3", ""), ("GC5_ss8", ""), *changes):
        found.append(write_implant(implant, folder, trial, changed, start=0.3, end=0.8, step=3))
    for trial in ("stoop5kg", "stoop15kg"):
        model = lifting / "lumbarModel_scaled.osim"
        found.append(
            _write(
                folder / f"back_lifting_{trial}",
                model=model,
                motion=lifting / trial / "ik.sto",
                loads="",
                actuators=reserves(model, RESERVES),
                start="-Inf",
                end="Inf",
                step=130,
                cutoff=-1,
            )
        )
    found.append(_without_muscles(data / "public" / "moco_2d_muscles_as_components", folder))
    return found


def write_implant(implant: Path, folder: Path, trial: str, changed: str = "", **settings: object) -> Path:
    """Write a setup for a trial of the knee with an implant.

    Parameters
    ----------
    implant : Path
        The data.
    folder : Path
    trial : str
    changed : str
        ``"clamped_"``: knees of the model with a narrow range. ``"agreeing_"``: coupled columns in radians.
    settings
        Start, end and step.

    Returns
    -------
    Path
    """
    made = folder / f"knee_implant_{changed}{trial}"
    model, motion = implant / "Rajagopal2015-scaled.osim", implant / f"{trial}.mot"
    return _write(
        made,
        model=_with_narrow_knees(model, made) if changed == "clamped_" else model,
        motion=_in_radians(motion, made) if changed == "agreeing_" else motion,
        loads=with_data(implant / "ExternalLoads.xml", implant / f"{trial}_kinetics.mot"),
        actuators=(implant / "ForceSet.xml").read_text(encoding="utf-8"),
        cutoff=6,
        **settings,
    )


def _without_muscles(public: Path, folder: Path) -> Path:
    """Copy a setup with its files, the muscles taken out of its model."""
    made = folder / "moco_2d_without_muscles"
    shutil.copytree(public, made, dirs_exist_ok=True)
    model = made / "2D_gait.osim"
    muscle = r"<DeGrooteFregly2016Muscle name.*?</DeGrooteFregly2016Muscle>"
    text = model.read_text(encoding="utf-8")
    model.chmod(0o644)
    model.write_text(re.sub(muscle, "", text, flags=re.DOTALL), encoding="utf-8")
    return made / "setup.xml"


def _write(folder: Path, *, loads: str, actuators: str, **settings: object) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "actuators.xml").write_text(actuators, encoding="utf-8")
    if loads:
        (folder / "loads.xml").write_text(loads, encoding="utf-8")
    setup = folder / "setup.xml"
    text = SETUP.format(
        name=folder.name, actuators="actuators.xml", loads="loads.xml" if loads else "", **settings
    )
    setup.write_text(text, encoding="utf-8")
    return setup


def _in_radians(motion: Path, folder: Path) -> Path:
    """Copy a motion whose coupled columns, which no header turns into radians, are in degrees."""
    folder.mkdir(parents=True, exist_ok=True)
    table = read_storage(motion)
    scale = [math.radians(1) if label.endswith("_beta") else 1.0 for label in table.labels]
    write_storage(replace(table, values=table.values * scale), folder / motion.name)
    return folder / motion.name


def _with_narrow_knees(model: Path, folder: Path) -> Path:
    """Copy a model whose knees may bend from 0.2 to 0.8 rad only, less than they do."""
    folder.mkdir(parents=True, exist_ok=True)
    text = model.read_text(encoding="utf-8")
    for side in "rl":
        start = text.index(f'<Coordinate name="knee_angle_{side}">')
        end = text.index("</Coordinate>", start)
        knee = re.sub("<range>.*?</range>", "<range>0.2 0.8</range>", text[start:end])
        knee = re.sub("<default_value>.*?</default_value>", "<default_value>0.5</default_value>", knee)
        text = text[:start] + knee + text[end:]
    copy = folder / model.name
    copy.write_text(text, encoding="utf-8")
    return copy
