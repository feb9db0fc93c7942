"""Exported files of models that leave numbers to MuJoCo to work out, and values and paths that cannot be used."""

import mujoco
import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadInput, BadParameter
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator, export_mjcf
from tests.effect_checks import SERVO_ARM, same_as

ARM = """<mujoco>%s<worldbody><body name="arm"><joint name="j" axis="0 1 0" %s/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1"/></body></worldbody>
<actuator><position name="servo" joint="j" kp="50" %s/></actuator></mujoco>"""
DEFAULTS = """<default><joint springdamper="0.1 1"/><position dampratio="1"/></default>"""
SAID = [("", "", 'dampratio="1"'), ("", 'springdamper="0.1 1"', 'kv="1"'), (DEFAULTS, "", "")]
MASS = ParameterSpace([Parameter("body_mass", "arm", 0.5, 4.0)])


@pytest.mark.parametrize("said", SAID)
def test_ratios_stay_those_of_the_nominal_masses(tmp_path, said):
    """A heavier arm keeps the servo and the spring that its nominal mass gave it, as in the simulator."""
    (tmp_path / "arm.xml").write_text(ARM % said)
    old = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    out = export_mjcf(tmp_path / "arm.xml", [], [4.0], tmp_path / "heavy.xml", MASS)
    new = mujoco.MjModel.from_xml_path(str(out))
    assert new.body_mass[1] == pytest.approx(4.0)
    for name in ("actuator_gainprm", "actuator_biasprm", "dof_damping", "jnt_stiffness"):
        np.testing.assert_allclose(getattr(new, name), getattr(old, name), rtol=1e-5)  # files have six digits
    assert not np.allclose([old.actuator_biasprm[0, 2], old.dof_damping[0]], [0, 0])
    same_as(MujocoSimulator(tmp_path / "arm.xml", MASS), [4.0], new, atol=2e-4)


@pytest.mark.parametrize("said", SAID)
def test_effects_come_on_top_of_what_ratios_make(tmp_path, said):
    """Damping and gains that effects change are written once, as numbers."""
    (tmp_path / "arm.xml").write_text(ARM % said)
    chosen = [
        effect("viscous_damping", "j", damping=(0, 2)),
        effect("servo_gain", "servo", kp_scale=(0.1, 9), kv_scale=(0.1, 9)),
    ]
    values = [0.7, 2.0, 0.5]
    new = mujoco.MjModel.from_xml_path(str(export_mjcf(tmp_path / "arm.xml", chosen, values, tmp_path / "out.xml")))
    old = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    assert new.dof_damping[0] == pytest.approx(old.dof_damping[0] + 0.7, rel=1e-5)
    np.testing.assert_allclose(new.actuator_biasprm[0, 1:3], old.actuator_biasprm[0, 1:3] * [2.0, 0.5], rtol=1e-5)


@pytest.mark.parametrize("said", SAID[:2])
def test_what_would_come_along_is_refused(tmp_path, monkeypatch, said):
    """Numbers that nobody meant to change are compared as well: here ratios are left in the file."""
    (tmp_path / "arm.xml").write_text(ARM % said)
    monkeypatch.setattr("nfpde.sim.export._write_shorthands", lambda *_: None)
    with pytest.raises(BadParameter, match=r"heavy.xml: .* would change \w+ as well, .* give it there as a number"):
        export_mjcf(tmp_path / "arm.xml", [], [4.0], tmp_path / "heavy.xml", MASS)
    assert not (tmp_path / "heavy.xml").exists()


@pytest.mark.parametrize("values", [["heavy", 0.0], [[0.9, 1.0], [0.1]], "0.9", [[0.9, 0.0]], [np.inf, 0.0], None])
def test_values_that_are_no_row_of_numbers_are_refused(tmp_path, values):
    (tmp_path / "robot.xml").write_text(SERVO_ARM)
    space = ParameterSpace([Parameter("body_mass", "lower", 0.3, 1.5)])
    damped = [effect("viscous_damping", "elbow", damping=(0.1, 2))]
    with pytest.raises(BadParameter, match="export: expected 2 finite values, those of the space first, got"):
        export_mjcf(tmp_path / "robot.xml", damped, values, tmp_path / "out.xml", space)


def test_values_outside_their_bounds_are_refused(tmp_path):
    """Of the model's fields and of effects; an effect's neutral value does nothing, wherever its bounds are."""
    (tmp_path / "robot.xml").write_text(SERVO_ARM)
    space = ParameterSpace([Parameter("body_mass", "lower", 0.3, 1.5)])
    damped = [effect("viscous_damping", "elbow", damping=(0.1, 2))]
    robot, out = tmp_path / "robot.xml", tmp_path / "out.xml"
    with pytest.raises(BadParameter, match=r"export: body_mass:lower = 1.6 lies outside \[0.3, 1.5\]; give a value"):
        export_mjcf(robot, damped, [1.6, 0.2], out, space)
    with pytest.raises(BadParameter, match=r"viscous_damping.damping:elbow = 3 lies outside \[0.1, 2\], nor is it 0"):
        export_mjcf(robot, damped, [0.9, 3.0], out, space)
    assert not out.exists()
    assert export_mjcf(robot, damped, [0.9, 0.0], out, space) == out


def test_a_folder_is_no_file(tmp_path):
    (tmp_path / "robot.xml").write_text(SERVO_ARM)
    with pytest.raises(BadInput, match=r"that is a folder; give the name of the file to write, such as .*robot.xml"):
        export_mjcf(tmp_path / "robot.xml", [], [], tmp_path)
