"""What each result file holds: OpenSim's titles, columns and numbers."""

import ast
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers import with_joint_reactions, with_motion
from solution_by_hand import solution_by_hand, write

from scso_nlp.exceptions import NameMismatchError
from scso_nlp.io import read_storage
from scso_nlp.report.contents import NO_ITERATE, RESULT_FILES, STATUS_CODES
from scso_nlp.solution import Status

READ_WITH_OPENSIM = """
import json, sys
import opensim
opensim.Logger.setLevelString("Off")
answer = {}
for path in sys.argv[1:]:
    if path.endswith(".xml"):
        controls = opensim.ControlSet(path)
        answer[path] = [
            [controls.get(i).getName() for i in range(controls.getSize())],
            [[controls.get(i).getControlValue(t) for t in (0, 0.25, 1)] for i in range(controls.getSize())],
        ]
        continue
    storage = opensim.Storage(path)
    table = opensim.TimeSeriesTable(path)
    labels = [storage.getColumnLabels().get(i) for i in range(storage.getColumnLabels().getSize())]
    answer[path] = [storage.getName(), labels, storage.getSize(), list(table.getColumnLabels()),
                    table.getMatrix().to_numpy().tolist()]
print(json.dumps(answer))
"""

RUN_ANALYZE_TOOL = """
import sys
import opensim
opensim.Logger.setLevelString("Off")
tool = opensim.AnalyzeTool(sys.argv[1])
tool.setResultsDir(sys.argv[2])
tool.setFinalTime(0.3)
tool.run()
"""


def opensim(script, *arguments):
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], check=True, capture_output=True, text=True
    ).stdout


def header(path: Path) -> list[str]:
    return path.read_text().split("endheader")[0].splitlines()


@pytest.mark.parametrize("file", RESULT_FILES, ids=lambda file: file.name)
def test_every_result_file_has_a_test_that_names_it(file):
    ending, text = file.name.rpartition("}")[2], Path(__file__).read_text(encoding="utf-8")
    tests = [node for node in ast.parse(text).body if getattr(node, "name", "").startswith("test_")]
    naming = [test for test in tests if ending in (ast.get_source_segment(text, test) or "")]
    assert naming, f"no test of tests/report/test_contents.py names {ending}"


def test_without_stability_rows_there_is_no_stability_file(tmp_path):
    write(solution_by_hand(stability=False), tmp_path / "results")
    assert not (tmp_path / "results" / "antagonists_stability.sto").exists()


def test_static_optimization_stands_beside_the_results_of_a_run_with_stability_rows(tmp_path):
    before = solution_by_hand(stability=False)
    write(solution_by_hand(), tmp_path / "results", baseline=before)
    found = read_storage(tmp_path / "results" / "antagonists_without_stability.sto")
    alone = write(before, tmp_path / "alone")
    expected = read_storage(tmp_path / "alone" / "antagonists_StaticOptimization_activation.sto")
    assert found.labels == expected.labels
    np.testing.assert_array_equal(found.values, expected.values)
    assert not [path for path in alone if path.name.endswith("_without_stability.sto")]


def test_joint_reactions_are_written_as_opensim_writes_them(tmp_path, rng):
    path = tmp_path / "results" / "antagonists_JointReaction_ReactionLoads.sto"
    write(solution_by_hand(), path.parent)
    assert not path.exists()
    solution = solution_by_hand()
    solution = replace(solution, problem=with_joint_reactions(solution.problem, rng, ("hip", "knee")))
    write(solution, path.parent)
    # of a file of OpenSim 4.6
    assert header(path) == [
        "Joint Reaction Loads",
        "version=1",
        "nRows=5",
        "nColumns=19",
        "inDegrees=no",
        "",
        "This file contains the reaction forces and moments",
        "applied to the specified body of a joint pair and expressed  in the specified reference frame.",
        "",
        "Units are S.I. units (seconds, meters, Newtons, ...)",
    ]
    found, reactions = read_storage(path), solution.joint_reactions()
    parts = ("fx", "fy", "fz", "mx", "my", "mz", "px", "py", "pz")
    assert found.labels == tuple(
        f"{joint}_on_{joint}_child_in_ground_{part}" for joint in ("hip", "knee") for part in parts
    )
    np.testing.assert_array_equal(found.values[:, 9:12], reactions.forces[:, 1])
    np.testing.assert_array_equal(found.values[:, 12:15], reactions.moments[:, 1])
    np.testing.assert_array_equal(found.values[:, 15:], reactions.points[:, 1])
    peak = np.linalg.norm(reactions.forces[:, 1], axis=1).max()
    report = json.loads((path.parent / "report.json").read_text())
    assert report["problem"]["body_weight"] == 700.0
    assert report["joint_reaction_peaks"]["knee"] == pytest.approx(
        {"force": peak, "body_weights": peak / 700.0}
    )


def test_columns_are_actuators_in_the_order_of_the_force_set(tmp_path):
    solution = solution_by_hand(n_pairs=2)
    write(solution, tmp_path / "results")
    start = tmp_path / "results" / "antagonists_StaticOptimization"
    activation = read_storage(f"{start}_activation.sto")
    force = read_storage(f"{start}_force.sto")
    order = ("hinge_0_reserve", "front_0", "back_0", "front_1", "back_1", "hinge_1_reserve")
    assert activation.labels == order
    assert force.labels == (*order, "hand_load_Fx", "hand_load_Fy")
    # the writer keeps all digits, so the numbers come back as they were
    np.testing.assert_array_equal(activation.columns(("back_1",))[:, 0], solution.activation[:, 3])
    np.testing.assert_array_equal(activation.column("hinge_1_reserve"), solution.control[:, 1])
    np.testing.assert_array_equal(force.column("front_0"), solution.tendon_force[:, 0])
    np.testing.assert_array_equal(force.column("hinge_0_reserve"), solution.actuator_force[:, 0])
    np.testing.assert_array_equal(force.column("hand_load_Fy"), np.arange(5.0))
    np.testing.assert_array_equal(force.time, solution.problem.motion.trajectory.time)


def test_moments_are_called_as_inverse_dynamics_calls_them(tmp_path):
    solution = solution_by_hand(n_pairs=2)
    trajectory = replace(solution.problem.motion.trajectory, is_rotational=[True, False])
    balance = replace(solution.moment_balance, unit=("N·m", "N"))
    problem = with_motion(solution.problem, trajectory=trajectory)
    write(replace(solution, problem=problem, moment_balance=balance), tmp_path / "results")
    table = read_storage(tmp_path / "results" / "antagonists_moments.sto")
    names = ("hinge_0_moment", "hinge_1_force")
    assert table.labels == (*names, *(f"{n}_muscles" for n in names), *(f"{n}_reserves" for n in names))
    # by hand muscles take nine tenths
    required = trajectory.generalized_forces
    np.testing.assert_array_equal(table.columns(names), required)
    np.testing.assert_allclose(table.values[:, 2:4], 0.9 * required, atol=1e-12)
    np.testing.assert_allclose(table.values[:, 4:6], 0.1 * required, atol=1e-12)


def test_a_trajectory_without_force_columns_writes_muscles_then_actuators_then_other_forces(tmp_path):
    solution = solution_by_hand()
    trajectory = replace(solution.problem.motion.trajectory, force_columns=())
    solution = replace(
        solution,
        problem=with_motion(solution.problem, trajectory=trajectory),
    )
    write(solution, tmp_path / "results")
    force = read_storage(tmp_path / "results" / "antagonists_StaticOptimization_force.sto")
    assert force.labels == ("front_0", "back_0", "hinge_0_reserve", "hand_load_Fx", "hand_load_Fy")


def test_a_force_column_that_nobody_fills_is_named(tmp_path):
    solution = solution_by_hand()
    columns = (*solution.problem.motion.trajectory.force_columns, "spring_left")
    trajectory = replace(solution.problem.motion.trajectory, force_columns=columns)
    solution = replace(
        solution,
        problem=with_motion(solution.problem, trajectory=trajectory),
    )
    with pytest.raises(NameMismatchError, match="spring_left"):
        write(solution, tmp_path / "results")
    assert list(tmp_path.iterdir()) == []


def test_the_controls_hold_one_node_per_frame_with_the_activation(tmp_path):
    solution = solution_by_hand()
    write(solution, tmp_path / "results")
    path = tmp_path / "results" / "antagonists_StaticOptimization_controls.xml"
    controls = ElementTree.parse(path).getroot().findall("ControlSet/objects/ControlLinear")
    assert [control.get("name") for control in controls] == ["hinge_0_reserve", "front_0", "back_0"]
    values = [float(node.text) for node in controls[2].findall("x_nodes/ControlLinearNode/value")]
    np.testing.assert_array_equal(values, solution.activation[:, 1])


def test_the_stability_file_holds_stability_level_margin_and_multiplier(tmp_path):
    write(solution_by_hand(), tmp_path / "results")
    table = read_storage(tmp_path / "results" / "antagonists_stability.sto")
    assert table.labels == tuple(
        f"hinge_0_z_{what}" for what in ("stability", "level", "margin", "multiplier")
    )
    # two muscles of 50 N at zero moment, 0.1 N·m/rad per newton (r = 0.05 m, length 0.1 m, q = 5): 10 N·m/rad
    assert table.values[0] == pytest.approx([10.0, 10.0, 0.0, 0.25], abs=1e-12)
    # at a quarter of the period one muscle has 90 N more for 4.5 N·m
    assert table.values[1] == pytest.approx([19.0, 10.0, 9.0, 0.0], abs=1e-12)


def test_the_excitation_file_holds_what_dynamics_found(tmp_path):
    solution = solution_by_hand()
    excitation = np.linspace(0.1, 0.9, 10).reshape(5, 2)
    variables = {"ActivationDynamics.excitation": excitation}
    write(replace(solution, variables=variables), tmp_path / "results")
    table = read_storage(tmp_path / "results" / "antagonists_excitation.sto")
    assert (table.name, table.labels) == ("Excitations", ("front_0", "back_0"))
    np.testing.assert_array_equal(table.values, excitation)
    write(solution, tmp_path / "results")
    assert not (tmp_path / "results" / "antagonists_excitation.sto").exists()


def test_fiber_lengths_and_tendon_strains_have_files(tmp_path):
    solution = solution_by_hand()
    files = {"_MuscleAnalysis_FiberLength.sto": "fiber_length", "_tendon_strain.sto": "tendon_strain"}
    numbers = {name: np.linspace(k + 1, k + 2, 10).reshape(5, 2) for k, name in enumerate(files.values())}
    quantities = {f"NoPhysiology.{name}": values for name, values in numbers.items()}
    write(replace(solution, quantities=quantities), tmp_path / "results")
    for file, name in files.items():
        table = read_storage(tmp_path / "results" / f"antagonists{file}")
        assert table.labels == ("front_0", "back_0")
        np.testing.assert_array_equal(table.values, numbers[name])


def test_failed_frames_that_are_kept_are_not_numbers_in_any_result_file(tmp_path):
    written = write(solution_by_hand(failed=(1,)), tmp_path / "results", keep_failed=True)
    tables = [path for path in written if path.suffix == ".sto" and not path.match("*_status.sto")]
    assert len(tables) >= 3
    for path in tables:
        values = read_storage(path).values
        assert np.isnan(values[1]).all(), path
        assert np.isfinite(values[[0, 2, 3, 4]]).all(), path
    root = ElementTree.parse(tmp_path / "results" / "antagonists_StaticOptimization_controls.xml").getroot()
    for nodes in root.iter("x_nodes"):
        values = [float(value.text) for value in nodes.iter("value")]
        assert np.flatnonzero(np.isnan(values)).tolist() == [1]


def test_status_codes_are_explained_in_the_header_of_the_status_file(tmp_path):
    solution = solution_by_hand(failed=(1, 3))
    write(solution, tmp_path / "results")
    table = read_storage(tmp_path / "results" / "antagonists_status.sto")
    assert table.labels == ("status", "violation_MomentEquilibrium", "violation_JointStability")
    assert table.column("status").tolist() == [0, 2, 0, 2, 0]
    for status, code in STATUS_CODES.items():
        assert f"{code} {status.name}: {status.value}" in table.description
    assert set(STATUS_CODES) == set(Status)


def test_labels_of_terms_may_have_blanks(tmp_path):
    solution = solution_by_hand()
    rows = {"elbow, at rest": solution.rows["JointStability"]}
    write(replace(solution, rows=rows), tmp_path / "results")
    table = read_storage(tmp_path / "results" / "antagonists_status.sto")
    assert table.labels == ("status", "violation_elbow,_at_rest")


def test_the_status_file_has_no_gap_where_a_frame_has_no_iterate(tmp_path):
    solution = solution_by_hand(failed=(1,))
    rows = dict(solution.rows)
    value = rows["MomentEquilibrium"].value.copy()
    value[0], value[1] = -0.25, np.nan
    rows["MomentEquilibrium"] = replace(rows["MomentEquilibrium"], value=value)
    write(replace(solution, rows=rows), tmp_path / "results")
    table = read_storage(tmp_path / "results" / "antagonists_status.sto")
    assert table.column("violation_MomentEquilibrium")[:2].tolist() == [0.25, NO_ITERATE]


@pytest.mark.opensim
def test_opensim_reads_the_files_and_finds_the_same_numbers(tmp_path):
    solution = solution_by_hand(n_pairs=2)
    written = write(solution, tmp_path / "results")
    paths = [path for path in written if path.suffix in (".sto", ".xml")]
    answer = json.loads(opensim(READ_WITH_OPENSIM, *paths))
    for path in paths:
        found = answer[str(path)]
        if path.suffix == ".xml":
            activations = read_storage(str(path).replace("_controls.xml", "_activation.sto"))
            assert tuple(found[0]) == activations.labels
            # these are times of frames; OpenSim interpolates all the same, so round-off remains
            np.testing.assert_allclose(found[1], activations.values[[0, 1, 4]].T, rtol=0, atol=1e-16)
            continue
        ours = read_storage(path)
        title, labels, size, table_labels, values = found
        assert title == ours.name
        assert tuple(labels) == ("time", *ours.labels)
        assert tuple(table_labels) == ours.labels
        assert size == ours.n_frames
        np.testing.assert_allclose(values, ours.values, rtol=1e-15)


@pytest.mark.opensim
def test_headers_and_controls_equal_those_of_opensims_own_tool(tmp_path, shared_data):
    setup = shared_data / "arm26" / "arm26_millard_Setup_StaticOptimization.xml"
    opensim(RUN_ANALYZE_TOOL, setup, tmp_path / "opensim")
    write(solution_by_hand(), tmp_path / "ours")
    for kind in ("activation.sto", "force.sto"):
        theirs = header(tmp_path / "opensim" / f"arm26_millard_StaticOptimization_{kind}")
        ours = header(tmp_path / "ours" / f"antagonists_StaticOptimization_{kind}")

        def without_sizes(lines):
            return [re.sub(r"(nRows|nColumns)=\d+", r"\1", line) for line in lines]

        assert without_sizes(ours) == without_sizes(theirs)
    theirs = (tmp_path / "opensim" / "arm26_millard_StaticOptimization_controls.xml").read_text()
    ours = (tmp_path / "ours" / "antagonists_StaticOptimization_controls.xml").read_text()

    def skeleton(text):
        text = re.sub(r"(\t*<ControlLinearNode>.*?</ControlLinearNode>\n)+", "NODES\n", text, flags=re.S)
        text = re.sub(r'ControlLinear name="[^"]*"', "ControlLinear", text)
        return re.sub(r"(\t*<ControlLinear>.*?</ControlLinear>\n)(\1)*", r"\1", text, flags=re.S)

    assert skeleton(ours) == skeleton(theirs)
    node = (
        r"\t{5}<ControlLinearNode>\n\t{6}<t>[^<]*</t>\n\t{6}<value>[^<]*</value>\n\t{5}</ControlLinearNode>\n"
    )
    for text in (ours, theirs):
        assert len(re.findall(node, text)) == text.count("<ControlLinearNode>")
