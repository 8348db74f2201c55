"""Forces outside the ForceSet, models whose muscles all are, and contact forces with several shapes."""

import re
from pathlib import Path

import numpy as np
import pytest
from tiny_model import Tiny, ask_opensim

from scso_nlp.constraints.joint_stability import JointStability
from scso_nlp.exceptions import DataError, NameMismatchError
from scso_nlp.io.storage import read_storage
from scso_nlp.methods import stability_constrained_static_optimization, static_optimization
from scso_nlp.opensim.engine import load_motion
from scso_nlp.report.results import write_solution
from scso_nlp.solver import solve_framewise

pytestmark = pytest.mark.opensim

MUSCLES = ("flexor", "wrapped", "through_slider")


def _outside_the_force_set(tiny: Tiny, *names: str) -> None:
    """Move muscles from the ForceSet into the model itself, with rigid tendons: they then have one state."""
    text = tiny.model.read_text()
    components = ""
    for name in names:
        (found,) = re.findall(rf'<(\w+) name="{name}">', text)
        (component,) = re.findall(rf'<{found} name="{name}">.*?</{found}>', text, flags=re.DOTALL)
        text = text.replace(component, "")
        rigid = "<ignore_tendon_compliance>true</ignore_tendon_compliance><max_isometric_force>"
        components += component.replace("<max_isometric_force>", rigid)
    text = text.replace("<gravity>", f"<components>{components}</components><gravity>")
    tiny.model.write_text(text)


def test_a_muscle_outside_the_force_set_is_not_optimized_but_acts(
    tiny: Tiny, caplog: pytest.LogCaptureFixture
) -> None:
    within = load_motion(tiny.setup, step_interval=10).trajectory
    _outside_the_force_set(tiny, "flexor")
    outside = load_motion(tiny.setup, step_interval=10).trajectory
    (note,) = (record for record in caplog.records if "ForceSet" in record.message)
    assert note.levelname == "WARNING"
    assert "outside the model's ForceSet act in their default state and are not optimized" in note.message
    assert note.message.endswith(": /flexor")
    assert outside.muscles == ("wrapped", "through_slider")
    force = outside.other_forces[:, outside.other_force_labels.index("flexor")]
    assert (force > 1.0).all()
    m = within.muscles.index("flexor")
    moment = within.moment_arms[:, :, m] * force[:, None]
    np.testing.assert_allclose(
        outside.passive_generalized_forces, within.passive_generalized_forces + moment, rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(
        outside.generalized_forces, within.generalized_forces - moment, rtol=0, atol=1e-12
    )
    results = tiny.folder / "results"
    ask_opensim(tiny.folder, kind="static optimization", setup=tiny.setup, results=results)
    opensims = read_storage(next(results.glob("*_force.sto")))
    assert opensims.labels == outside.force_columns
    rows = np.abs(opensims.time[:, None] - outside.time).argmin(axis=0)
    # times are printed with 8 decimals, and passive force rises steeply
    np.testing.assert_allclose(opensims.column("flexor")[rows], force, rtol=1e-8)
    others = [within.muscles.index(name) for name in outside.muscles]
    np.testing.assert_array_equal(outside.moment_arms, within.moment_arms[:, :, others])


def test_a_muscle_outside_the_force_set_may_share_its_name_with_one_inside(tiny: Tiny) -> None:
    _outside_the_force_set(tiny, "flexor")
    text = tiny.model.read_text()
    tiny.model.write_text(text.replace('Muscle name="through_slider"', 'Muscle name="flexor"'))
    trajectory = load_motion(tiny.setup, step_interval=50).trajectory
    assert trajectory.muscles == ("wrapped", "flexor")
    assert trajectory.force_columns[:3] == ("flexor.flexor", "wrapped", "flexor")


@pytest.mark.parametrize("chosen", ["flexor", "/flexor", "all"])
def test_a_muscle_outside_the_force_set_is_optimized_where_it_is_named(chosen: str, tiny: Tiny) -> None:
    axes = (("elbow", "z"),)
    within = load_motion(tiny.setup, step_interval=20, stability_axes=axes)
    _outside_the_force_set(tiny, "flexor")
    motion = load_motion(tiny.setup, step_interval=20, stability_axes=axes, outside_force_set=chosen)
    found, expected = motion.trajectory, within.trajectory
    assert sorted(found.muscles) == sorted(expected.muscles)
    order = [found.muscles.index(name) for name in expected.muscles]
    assert found.skeleton is not None
    assert expected.skeleton is not None
    for name in ("moment_arms", "muscle_tendon_length", "active_force_capacity"):
        np.testing.assert_allclose(
            getattr(found, name)[..., order], getattr(expected, name), rtol=0, atol=1e-9, err_msg=name
        )
    for name in ("generalized_forces", "passive_generalized_forces", "other_forces"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=0, atol=1e-12)
    ours, theirs = (one.skeleton.virtual_moment_arms for one in (found, expected))
    np.testing.assert_allclose(ours[..., order], theirs, rtol=0, atol=1e-12)
    ours, theirs = (solve_framewise(static_optimization(one)).activation for one in (motion, within))
    np.testing.assert_allclose(ours[:, order], theirs, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("chosen", "rename", "message"),
    [
        ("wrapped", "", r"unknown .* 'wrapped' in outside_force_set \(outside the ForceSet: /flexor\)"),
        ("flexor", "flexor", r"/flexor, named in outside_force_set, shares its name .* rename one of them$"),
    ],
)
def test_names_outside_the_force_set_are_checked(chosen: str, rename: str, message: str, tiny: Tiny) -> None:
    _outside_the_force_set(tiny, "flexor")
    if rename:
        text = tiny.model.read_text()
        tiny.model.write_text(text.replace('Muscle name="through_slider"', f'Muscle name="{rename}"'))
    with pytest.raises(NameMismatchError, match=message) as failure:
        load_motion(tiny.setup, outside_force_set=chosen)
    assert "\n" not in str(failure.value)


def test_virtual_rotations_work_on_the_muscles_of_the_force_set(tiny: Tiny) -> None:
    axes = (("elbow", "z"),)
    within = load_motion(tiny.setup, step_interval=20, stability_axes=axes).trajectory
    _outside_the_force_set(tiny, "flexor")
    outside = load_motion(tiny.setup, step_interval=20, stability_axes=axes).trajectory
    assert within.skeleton is not None
    assert outside.skeleton is not None
    np.testing.assert_allclose(
        outside.skeleton.virtual_moment_arms[:, :, outside.muscles.index("wrapped")],
        within.skeleton.virtual_moment_arms[:, :, within.muscles.index("wrapped")],
        rtol=0,
        atol=1e-12,
    )


def test_a_model_without_muscles_in_its_force_set_is_driven_by_its_actuators(
    tiny: Tiny, tmp_path: Path
) -> None:
    # OpenSim itself refuses paths that wrap outside the ForceSet
    wrap = r'<PathWrapSet name="wraps">.*?</PathWrapSet>'
    tiny.model.write_text(re.sub(wrap, "", tiny.model.read_text(), flags=re.DOTALL))
    _outside_the_force_set(tiny, *MUSCLES)
    text = tiny.actuators.read_text()
    (elbow,) = re.findall(r"<CoordinateActuator.*?</CoordinateActuator>", text, flags=re.DOTALL)
    tiny.actuators.write_text(text.replace(elbow, elbow + elbow.replace("elbow", "shoulder")))
    axes = (("shoulder", "z"),)
    chosen = ("elbow_flexion",)
    motion = load_motion(tiny.setup, step_interval=20, stability_axes=axes, curvature_coordinates=chosen)
    trajectory = motion.trajectory
    assert trajectory.muscles == ()
    assert trajectory.curvature is not None
    assert trajectory.curvature.load_stiffness.shape == (trajectory.n_frames, 1, 1)
    stability = JointStability(joints=("shoulder",), axes="z", level=-1e4)
    problem = stability_constrained_static_optimization(motion, stability=stability)
    solution = solve_framewise(problem)
    produced = np.einsum("kca,ka->kc", trajectory.actuator_generalized_forces, solution.control)
    np.testing.assert_allclose(produced, trajectory.generalized_forces, rtol=0, atol=1e-6)
    write_solution(solution, tmp_path / "results")
    with pytest.raises(DataError, match=r"but no muscle acts on any: name coordinates \(free: shoulder_fl"):
        load_motion(tiny.setup, curvature_coordinates="all")


CONTACT = """<HuntCrossleyForce name="{name}">
  <HuntCrossleyForce::ContactParametersSet name="contact_parameters"><objects>
  <HuntCrossleyForce::ContactParameters><geometry>{shapes}</geometry><stiffness>20000</stiffness>
  <dissipation>0.5</dissipation></HuntCrossleyForce::ContactParameters></objects>
  </HuntCrossleyForce::ContactParametersSet></HuntCrossleyForce>"""
SHAPES = """<ContactGeometrySet name="shapes"><objects>
  <ContactHalfSpace name="floor"><socket_frame>/ground</socket_frame><location>0 0.55 0</location>
    <orientation>0 0 -1.5707963267948966</orientation></ContactHalfSpace>
  <ContactSphere name="heel"><socket_frame>/bodyset/lower</socket_frame><location>0 -0.2 0</location>
    <radius>0.03</radius></ContactSphere>
  <ContactSphere name="toe"><socket_frame>/bodyset/lower</socket_frame><location>0.05 -0.2 0</location>
    <radius>0.03</radius></ContactSphere></objects></ContactGeometrySet></Model>"""


def test_a_contact_force_with_two_shapes_on_one_body_acts_as_two_contact_forces(tiny: Tiny) -> None:
    text = tiny.model.read_text().replace("</Model>", SHAPES)
    text = re.sub(r">\s+</objects>", "></objects>", text)
    text = re.sub(r"</objects>\s+</ForceSet>", "</objects></ForceSet>", text)
    found = []
    for contacts in ((("contact", "floor heel toe"),), (("one", "floor heel"), ("two", "floor toe"))):
        forces = "".join(CONTACT.format(name=name, shapes=shapes) for name, shapes in contacts)
        head, end, tail = text.rpartition("</objects></ForceSet>")
        tiny.model.write_text(head + forces + end + tail)
        found.append(load_motion(tiny.setup, step_interval=10).trajectory)
    both, apart = found
    labels = both.other_force_labels
    assert len(set(labels)) == len(labels)
    assert "contact.lower.force.X" in labels
    assert "contact.lower.force.X_2" in labels
    assert np.abs(both.passive_generalized_forces).max() > 1.0
    np.testing.assert_allclose(
        both.passive_generalized_forces, apart.passive_generalized_forces, rtol=0, atol=1e-9
    )
