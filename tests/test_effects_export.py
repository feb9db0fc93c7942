"""Effects written into an MJCF file: plain MuJoCo then moves as the simulator does."""

from pathlib import Path
from typing import Any

import gymnasium.envs.mujoco as mujoco_envs
import mujoco
import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadEffect, BadModel, BadParameter
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator, export_mjcf, load_model
from tests.effect_checks import SERVO_ARM, make, same_as
from tests.models import BLOCK, FREE_BOX, load

SHIFT: dict[str, Any] = {f"shift_{axis}": (-0.5, 0.5) for axis in "xyz"}
PLACE: dict[str, Any] = {f"position_{axis}": (-1.0, 1.0) for axis in "xyz"}
WIND: dict[str, Any] = {f"velocity_{axis}": (-30.0, 30.0) for axis in "xyz"}

CASES = [
    (SERVO_ARM, "viscous_damping", "elbow", {"damping": (0, 2)}, [0.7]),
    (SERVO_ARM, "coulomb_friction", "*", {"torque": (0, 2)}, [0.2]),
    (SERVO_ARM, "armature", "elbow", {"inertia": (0, 2)}, [0.04]),
    (SERVO_ARM, "motor_strength", "shoulder_servo", {"scale": (0, 2)}, [0.7]),
    (SERVO_ARM, "servo_gain", "shoulder_servo", {"kp_scale": (0.1, 9), "kv_scale": (0.1, 9)}, [0.5, 2.0]),
    (SERVO_ARM, "torque_limit", "elbow_servo", {"limit": (0.1, 9)}, [0.8]),
    (SERVO_ARM, "payload", "hand", {"mass": (0, 3), **PLACE}, [0.8, 0.1, 0.05, -0.2]),
    (SERVO_ARM, "com_shift", "lower", SHIFT, [0.05, 0.02, -0.1]),
    (SERVO_ARM, "gravity_tilt", None, {"roll": (-1, 1), "pitch": (-1, 1)}, [0.2, -0.1]),
    (SERVO_ARM, "fluid_drag", None, {"density": (0, 1000), "viscosity": (0, 5)}, [300.0, 0.5]),
    (SERVO_ARM, "wind", None, WIND, [4.0, -7.0, 2.0]),
    (BLOCK, "ground_friction", None, {"sliding": (0.01, 3)}, [0.8]),
    (BLOCK, "contact_softness", None, {"time_constant": (0.004, 0.3), "damping_ratio": (0.05, 4)}, [0.06, 0.4]),
    (BLOCK, "ground_height", None, {"height": (-0.05, 0.05)}, [0.01]),
]


@pytest.mark.parametrize(("xml", "name", "target", "bounds", "values"), CASES)
def test_the_file_moves_as_the_simulator(tmp_path, xml, name, target, bounds, values):
    """Plain MuJoCo on the exported file, within its decimals, and visibly other than the nominal model."""
    (tmp_path / "robot.xml").write_text(xml)
    out = export_mjcf(tmp_path / "robot.xml", [effect(name, target, **bounds)], values, tmp_path / "changed.xml")
    sim = make(name, target, xml, **bounds)
    model = mujoco.MjModel.from_xml_path(str(out))
    # files have six digits
    same_as(sim, values, model, atol=2e-4, spread=0.01 if xml is BLOCK else 0.3)
    with pytest.raises(AssertionError):
        same_as(sim, values, xml, atol=2e-4, spread=0.01 if xml is BLOCK else 0.3)


def test_parameters_and_effects_together(tmp_path):
    """A space of model fields comes first in the values."""
    (tmp_path / "robot.xml").write_text(SERVO_ARM)
    space = ParameterSpace([Parameter("body_mass", "lower", 0.3, 1.5)])
    chosen = [effect("viscous_damping", "elbow", damping=(0, 2)), effect("com_shift", "lower", **SHIFT)]
    out = export_mjcf(tmp_path / "robot.xml", chosen, [0.9, 0.3, 0.0, 0.02, 0.01], tmp_path / "changed.xml", space)
    old, new = load(SERVO_ARM), load_model(out)
    body, dof = old.body("lower").id, old.joint("elbow").dofadr[0]
    assert new.body_mass[body] == pytest.approx(0.9)
    np.testing.assert_allclose(new.body_ipos[body], old.body_ipos[body] + [0.0, 0.02, 0.01], atol=1e-6)
    np.testing.assert_allclose(np.sort(new.body_inertia[body]), np.sort(old.body_inertia[body]) * 0.9 / 0.7, rtol=1e-5)
    assert new.dof_damping[dof] == pytest.approx(0.4)


@pytest.mark.parametrize("robot", ["half_cheetah", "hopper", "ant"])
def test_files_that_take_inertias_from_geoms(tmp_path, robot):
    """Gymnasium's robots infer all inertias, and one rescales its masses: the payload is there, nothing else moves."""
    assets = Path(mujoco_envs.__file__).parent / "assets"
    load_it = effect("payload", "torso", mass=(0, 3), **PLACE)
    out = export_mjcf(assets / f"{robot}.xml", [load_it], [0.8, 0.1, 0.0, -0.1], tmp_path / "loaded.xml")
    old, new = load_model(assets / f"{robot}.xml"), load_model(out)
    torso = old.body("torso").id
    np.testing.assert_allclose(new.body_mass - old.body_mass, 0.8 * (np.arange(old.nbody) == torso), atol=1e-4)
    arm = np.array([0.1, 0.0, -0.1]) - old.body_ipos[torso]
    expected = old.body_ipos[torso] + arm * 0.8 / (old.body_mass[torso] + 0.8)
    np.testing.assert_allclose(new.body_ipos[torso], expected, atol=1e-5)


def test_effects_that_act_while_it_runs_are_refused(tmp_path):
    """With the way to use them; neutral ones are let through."""
    (tmp_path / "robot.xml").write_text(SERVO_ARM)
    late = effect("actuation_delay", "*", delay=(0, 0.1))
    with pytest.raises(BadEffect, match=r"actuation_delay on all: .*nfpde\.rl\.RandomizedParameters"):
        export_mjcf(tmp_path / "robot.xml", [late], [0.02], tmp_path / "out.xml")
    assert not (tmp_path / "out.xml").exists()
    assert export_mjcf(tmp_path / "robot.xml", [late], [0.0], tmp_path / "out.xml").exists()


BALANCED = FREE_BOX.replace('pos="0.01 0 0"', 'pos="0 0 0"')
"""MuJoCo compiles a free body that balances at its origin in a shorter way."""


@pytest.mark.parametrize(
    ("name", "bounds", "values"),
    [("com_shift", SHIFT, [0.05, 0.02, -0.1]), ("payload", {"mass": (0, 3), **PLACE}, [0.8, 0.1, 0.05, -0.2])],
)
def test_free_bodies_that_balance_at_their_origin(tmp_path, name, bounds, values):
    """The file moves as the simulator of the file's own model does, and needs no word on how to compile it."""
    (tmp_path / "box.xml").write_text(BALANCED)
    assert load(BALANCED).body_simple[1] == 1
    out = export_mjcf(tmp_path / "box.xml", [effect(name, "box", **bounds)], values, tmp_path / "changed.xml")
    assert "simple" not in out.read_text()  # a file for other programs says no more than the model's own
    sim = MujocoSimulator(tmp_path / "box.xml", None, [effect(name, "box", **bounds)])
    same_as(sim, values, mujoco.MjModel.from_xml_path(str(out)), atol=2e-4)  # files have six digits


def test_the_file_says_of_simple_bodies_what_the_model_says(tmp_path):
    """A body that was kept from the shorter way stays so."""
    (tmp_path / "box.xml").write_text(BALANCED.replace('name="box"', 'name="box" simple="false"'))
    out = export_mjcf(tmp_path / "box.xml", [], [], tmp_path / "same.xml")
    assert out.read_text().count('simple="false"') == 1


def test_a_refused_export_leaves_files_alone(tmp_path):
    """What MJCF cannot hold is found before anything is written, over the model's own file too."""
    path, other = tmp_path / "robot.xml", tmp_path / "other.xml"
    path.write_text(SERVO_ARM)
    other.write_text("something else")
    space = ParameterSpace([Parameter("geom_solimp", "upper_arm", 0.1, 0.8)])
    for out, content in ((path, SERVO_ARM), (other, "something else")):
        with pytest.raises(BadParameter, match="cannot hold the changed field geom_solimp"):
            export_mjcf(path, [], [0.5], out, space)
        assert out.read_text() == content
    assert sorted(tmp_path.iterdir()) == [other, path]
    damped = export_mjcf(path, [effect("viscous_damping", "elbow", damping=(0, 2))], [0.7], path)
    assert load_model(damped).dof_damping[1] == pytest.approx(0.8)


def test_wrong_calls_are_refused(tmp_path):
    """A missing file, and values that are too few."""
    with pytest.raises(BadModel, match="no such file"):
        export_mjcf(tmp_path / "none.xml", [], [], tmp_path / "out.xml")
    (tmp_path / "box.xml").write_text(FREE_BOX)
    with pytest.raises(BadParameter, match="expected 3 finite values"):
        export_mjcf(tmp_path / "box.xml", [effect("wind", **WIND)], [1.0], tmp_path / "out.xml")


TRIANGLE = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
GRIPPER = """<mujoco><compiler meshdir="meshes"/><asset><mesh name="jaw" file="jaw.obj"/></asset>
<worldbody><body name="jaw"><joint name="opens" axis="0 1 0"/><geom type="mesh" mesh="jaw"/></body></worldbody>
</mujoco>"""
CARRIER = """<mujoco><asset><model name="gripper" file="gripper/gripper.xml"/></asset><worldbody><body name="hand">
<joint name="turns" axis="0 0 1"/><geom size=".1"/><attach model="gripper" body="jaw" prefix="g_"/></body></worldbody>
</mujoco>"""


@pytest.mark.parametrize("where", ["gripper", "../gripper"])
def test_meshes_of_attached_models_are_found(tmp_path, where):
    """The file can be read from anywhere; MuJoCo itself says of a mesh its name alone."""
    folder = tmp_path / "robot"
    folder.mkdir()
    (folder / where / "meshes").mkdir(parents=True)
    (folder / where / "meshes" / "jaw.obj").write_text(TRIANGLE)
    (folder / where / "gripper.xml").write_text(GRIPPER)
    (folder / "carrier.xml").write_text(CARRIER.replace("gripper/gripper.xml", f"{where}/gripper.xml"))
    greasy = [effect("viscous_damping", "g_opens", damping=(0, 1))]
    out = export_mjcf(folder / "carrier.xml", greasy, [0.3], tmp_path / "new" / "folder" / "greasy.xml")
    model = mujoco.MjModel.from_xml_path(str(out))
    assert model.nmesh == 1
    assert model.dof_damping.tolist() == [0.0, 0.3]


def test_meshes_of_one_name_are_refused(tmp_path):
    """Of the carrier and of what it carries, and of two that it carries: no other robot is written in silence."""
    for name, size in (("gripper", 1.0), ("other", 3.0), (".", 5.0)):
        (tmp_path / name / "meshes").mkdir(parents=True)
        mesh = TRIANGLE.replace(".1", str(0.1 * size))
        (tmp_path / name / "meshes" / "jaw.obj").write_text(mesh)
        (tmp_path / name / "gripper.xml").write_text(GRIPPER)
    own = CARRIER.replace("<mujoco>", '<mujoco><compiler meshdir="meshes"/>')
    more = CARRIER.replace("<asset>", '<asset><model name="other" file="other/gripper.xml"/>')
    more = more.replace("<attach", '<attach model="other" body="jaw" prefix="o_"/><attach')
    for xml, words in ((own, "has other meshes"), (more, r"'jaw.obj' of '._jaw' is in 2 folders")):
        (tmp_path / "carrier.xml").write_text(xml)
        with pytest.raises(BadModel, match=words):
            export_mjcf(tmp_path / "carrier.xml", [], [], tmp_path / "out.xml")
        assert not (tmp_path / "out.xml").exists()


def test_paths_that_the_file_says_to_strip(tmp_path):
    """MuJoCo then takes the names alone; where a mesh was once does not matter."""
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "jaw.obj").write_text(TRIANGLE)
    for said in ("a/b/jaw.obj", "/nowhere/jaw.obj"):
        xml = GRIPPER.replace('meshdir="meshes"', 'meshdir="meshes" strippath="true"').replace("jaw.obj", said)
        (tmp_path / "gripper.xml").write_text(xml)
        out = export_mjcf(tmp_path / "gripper.xml", [], [], tmp_path / "else" / "where.xml")
        assert mujoco.MjModel.from_xml_path(str(out)).nmesh == 1


def test_values_with_which_nothing_compiles_are_refused(tmp_path):
    (tmp_path / "robot.xml").write_text(SERVO_ARM)
    space = ParameterSpace([Parameter("body_inertia", "lower", 1e-3, 9.0)])  # the other two moments stay small
    with pytest.raises(BadParameter, match=r"out.xml: MuJoCo cannot compile the model with these values: .*inertia"):
        export_mjcf(tmp_path / "robot.xml", [], [5.0], tmp_path / "out.xml", space)
    assert not (tmp_path / "out.xml").exists()


def test_inertias_that_a_file_takes_from_geoms_alone(tmp_path):
    """What bodies say of themselves is ignored there, and stays so in those that do not change."""
    xml = SERVO_ARM.replace("<option", '<compiler inertiafromgeom="true"/><option', 1)
    at = xml.index(">", xml.index('<body name="hand"')) + 1
    lies = xml[:at] + '<inertial pos="0 0 1" mass="50" diaginertia="9 9 9"/>' + xml[at:]
    (tmp_path / "robot.xml").write_text(lies)
    space = ParameterSpace([Parameter("body_mass", "lower", 0.3, 1.5)])
    out = export_mjcf(tmp_path / "robot.xml", [], [0.9], tmp_path / "changed.xml", space)
    old, new = load_model(tmp_path / "robot.xml"), load_model(out)
    lower = old.body("lower").id
    assert old.body("hand").mass[0] < 50
    np.testing.assert_allclose(new.body_mass, np.where(np.arange(old.nbody) == lower, 0.9, old.body_mass), rtol=1e-5)
    np.testing.assert_allclose(new.body_ipos, old.body_ipos, atol=1e-6)


def test_the_space_of_a_fit_may_hold_effects(tmp_path):
    """Its effects are written as those that are given, after the model's fields."""
    (tmp_path / "robot.xml").write_text(SERVO_ARM)
    damped = effect("viscous_damping", "elbow", damping=(0, 2))
    base = ParameterSpace([Parameter("body_mass", "lower", 0.3, 1.5)])
    shifted = effect("com_shift", "lower", **SHIFT)
    values = [0.9, 0.3, 0.0, 0.02, 0.01]
    one, other = tmp_path / "one.xml", tmp_path / "other.xml"
    export_mjcf(tmp_path / "robot.xml", [damped, shifted], values, one, base)
    export_mjcf(tmp_path / "robot.xml", [shifted], values, other, base + damped.parameters)
    assert one.read_text() == other.read_text()
    with pytest.raises(BadParameter, match="expected 5 finite values"):
        export_mjcf(tmp_path / "robot.xml", [shifted], values[:-1], other, base + damped.parameters)
