"""A study of made-up numbers, with names as long as people give them, and trials that went wrong."""

import numpy as np
import pandas as pd

from scso_nlp.studies import Study, StudyTables, StudyTrial
from scso_nlp.studies.cycles import POINTS

CONDITIONS = ("off", "potvin-brown_q=20_level=10", "full_q=20_level=10")
MUSCLES = ("gastrocnemius_medialis_r", "gastrocnemius_medialis_l", "vastus_lateralis_r", "vastus_lateralis_l")


def made_up(folder, name="lift"):
    """Three people with two trials each; the last trial has bad input."""
    trials, numbers, curves = [], [], []
    for p, person in enumerate(("Person_01", "Person_02", "Person_03")):
        for trial in ("stoop_lift_5kg_first", "stoop_lift_5kg_second"):
            for c, condition in enumerate(CONDITIONS):
                keys = {"subject": person, "trial": trial, "condition": condition}
                is_bad = (person, trial) == ("Person_03", "stoop_lift_5kg_second")
                sentence = (
                    f"/data/{person}/{trial}/a_file_with_a_long_name_that_is_not_there.osim does not exist"
                )
                state = {"state": "bad input", "sentence": sentence} if is_bad else {"state": "done"}
                counts = {} if is_bad else {"events": "ground reaction", "cycles": 1, "frames_all": 100}
                rows = (
                    {"frames_usable": 100, "frames_stable": 100, "margin_all_rows": 0.0}
                    if counts and c
                    else {}
                )
                trials.append({**keys, "sentence": "", **state, **counts, **rows})
                if not is_bad:
                    numbers += _numbers(keys, 1 + 0.1 * p + 0.2 * c)
                    curves += _curves(keys, 0.2 + 0.02 * p + 0.1 * c)
    plan = Study(name=name, source="/data", grid={"stability": ["off", "potvin-brown", "full"]}, trials=tuple(
        StudyTrial(folder="/".join((row["subject"], row["trial"], row["condition"])), identity="",
                   **{key: row[key] for key in ("subject", "trial", "condition")})
        for row in trials
    ))  # fmt: skip
    return StudyTables(
        folder=folder,
        plan=plan,
        reference="off",
        trials=pd.DataFrame(trials),
        table=pd.DataFrame(numbers),
        cycles=_joined(curves),
    )


def _numbers(keys, size):
    for quantity, name, statistic, unit in (
        ("effort", "muscles", "mean", "-"),
        ("activation", "all muscles", "mean", "-"),
        *(("activation", muscle, "mean", "-") for muscle in MUSCLES),
        ("co-contraction", "knee_angle_r", "index", "-"),
        ("reaction", "knee_r", "peak", "BW"),
    ):
        about = {"quantity": quantity, "name": name, "statistic": statistic, "value": size, "unit": unit}
        yield {**keys, **about}


def _curves(keys, size):
    wave = size * (1 + np.sin(np.linspace(0, 2 * np.pi, len(POINTS))))
    for quantity, names, unit in (("activation", MUSCLES, "-"), ("margin", ("knee_r_z",), "N·m/rad")):
        for name in names:
            about = {"quantity": quantity, "name": name, "unit": unit, "foot": "right", "cycle": 1}
            yield {**keys, **about, "start": 0.0, "stop": 1.0}, wave


def _joined(curves):
    about, values = zip(*curves, strict=True)
    return pd.concat([pd.DataFrame(about), pd.DataFrame(np.array(values), columns=list(POINTS))], axis=1)
