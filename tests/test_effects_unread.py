"""What effects take from the nominal model and may not find there: servos of encoders, rotors, joint limits."""

import mujoco
import numpy as np
import pytest

from nfpde.effects import DataScales, all_candidates, effect
from nfpde.errors import BadEffect
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator
from tests.models import load, make_windows, record, with_arrays

ROD = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody><body>
    <joint name="j" axis="0 1 0" damping="1"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1"/>
    <body pos="0.3 0 0"><joint name="other" axis="0 1 0" damping="1"/><geom size="0.02" mass="0.1"/></body>
  </body></worldbody>
  <tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>
  <actuator>{}</actuator>
</mujoco>
"""
UNREAD = {
    "pid": '<pid joint="j" kp="50" kv="2" input="pos"/>',
    "affine gain": '<general joint="j" gaintype="affine" gainprm="50 0 -1" biastype="affine" biasprm="0 -50 -2"/>',
    "tendon": '<position tendon="t" kp="50" kv="2"/>',
    "beside a servo": '<position joint="j" kp="50"/><position tendon="t" kp="50" kv="2"/>',
}
READ = {
    "position": '<position joint="j" kp="50" kv="2"/>',
    "velocity": '<velocity joint="j" kv="2"/>',
    "motor": '<motor joint="j"/>',
    "motor on a tendon": '<motor tendon="t"/>',
    "pid elsewhere": '<pid joint="other" kp="50" kv="2" input="pos"/>',
}
WRONG = {"joint_offset": {"offset": (-1, 1)}, "sensor_scale": {"scale": (0.5, 2)}}


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("what", UNREAD)
def test_what_reads_the_encoder_in_an_unknown_way_is_refused(name, what):
    """The effect would otherwise be its reading of the log alone, which is there by name."""
    model = load(ROD.format(UNREAD[what]))
    found = f"{name} on 'j': actuator #{model.nactuator - 1} follows the position or speed .*Use {name}_logged"
    with pytest.raises(BadEffect, match=found):
        effect(name, "j", **WRONG[name]).bind(model)
    effect(f"{name}_logged", "j", **WRONG[name]).bind(model)
    effect(name, "other", **WRONG[name]).bind(model)


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("what", READ)
def test_what_reads_it_as_known_or_not_at_all_is_taken(name, what):
    effect(name, "j", **WRONG[name]).bind(load(ROD.format(READ[what])))


@pytest.mark.parametrize("what", UNREAD)
def test_a_diagnosis_tries_there_what_the_log_alone_has(what):
    """No candidate that cannot be bound, and one of the log where an encoder may be off."""
    model = load(ROD.format(UNREAD[what]))
    tried = [(e.name, e.target) for e in all_candidates(model, DataScales.of(model, record(model, 1, 20, 5)))]
    for name in WRONG:
        assert (name, "j") not in tried
        assert (f"{name}_logged", "j") in tried
        assert (name, "other") in tried


GEARED = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody><body><joint name="j" axis="0 0 1" {}/><inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.2"/></body>
  </worldbody>
  <actuator><motor name="m" joint="j" gear="3" {}/></actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("own", "what"),
    [
        ('armature="0.05"', "an armature"),
        ('damping="0.1"', "damping"),
        ('armature="0.05" damping="0.1"', "an armature and damping"),
    ],
)
@pytest.mark.parametrize("name", ["backlash", "backlash_geared"])
def test_a_rotor_that_the_model_gives_to_the_actuator_is_refused(name, own, what):
    """With what to write instead, which is the same robot; nor does a diagnosis try it."""
    model = load(GEARED.format("", own))
    text = rf"{name} on 'm': the model gives actuator #0 {what}, .*square of the gear \(3\)"
    with pytest.raises(BadEffect, match=text):
        effect(name, "m", width=(0, 0.3)).bind(model)
    same = load(GEARED.format('armature="0.45" damping="0.9"', ""))
    effect(name, "m", width=(0, 0.3)).bind(same)
    for plant, there in ((model, False), (same, True)):
        names = [e.name for e in all_candidates(plant, DataScales.of(plant, record(plant, 1, 20, 5)))]
        assert (name in names) == there
    both = load(GEARED.format("", 'armature="0.05" damping="0.1"'))
    assert both.dof_M0[0] == pytest.approx(same.dof_M0[0])  # what the text says is so


def test_no_sum_of_dampings_drives_a_joint():
    """What an effect takes away is at most what a parameter left, so that the joint coasts and never speeds up."""
    model = load(GEARED.format('damping="0.5"', ""))
    space = ParameterSpace([Parameter("dof_damping", "j", 0.0, 1.0)])
    less = effect("viscous_damping", "j", damping=(-0.5, 1.0))
    sim = MujocoSimulator(model, space, [less], check_influence=False)
    rows = np.array([[0.0, -0.5], [0.2, -0.5], [0.5, -0.3], [0.3, 0.4]])
    np.testing.assert_allclose(sim.writer.rows(rows)["dof_damping"][:, 0], [0.0, 0.0, 0.2, 0.7], atol=1e-15)
    windows = make_windows(model, 1, 50)
    windows = with_arrays(windows, state=np.ones_like(windows.state), ctrl=np.zeros_like(windows.ctrl))
    np.testing.assert_array_equal(sim.predict(rows[:2], windows)[:, 0, :, 1], 1.0)


ANTAGONISTS = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0" {}/>
  <worldbody><body><joint name="j" axis="0 0 1" {}/><inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.2"/></body>
  </worldbody>
  <actuator><motor joint="j"/><motor joint="j" group="3"/></actuator>
</mujoco>
"""


def loaded(option, joint, ctrl, share=0.5):
    """Speed of a wheel after 10 ms under two motors and friction of a share of what they transmit, from 1 rad/s."""
    friction = effect("load_friction", "j", base=(0, 1), share=(0, 1))
    sim = MujocoSimulator(load(ANTAGONISTS.format(option, joint)), None, [friction], check_influence=False)
    windows = make_windows(sim.model, 1, 10)
    state = np.broadcast_to([0.0, 1.0], windows.state.shape)
    windows = with_arrays(windows, state=state, ctrl=np.zeros_like(windows.ctrl) + ctrl)
    return sim.predict([[0.0, share]], windows)[0, 0, -1, 1]


def test_a_joints_limit_is_one_of_the_sum():
    """Motors of 100 and -90 Nm give 10 Nm, far below a limit of 20; half of it is rubbed off."""
    expected = 1.0 + (10.0 - 5.0) / 0.2 * 0.01
    for joint in ("", 'actuatorfrcrange="-20 20"'):
        assert loaded("", joint, [100.0, -90.0]) == pytest.approx(expected, rel=1e-3)
    limited = 1.0 + (4.0 - 2.0) / 0.2 * 0.01
    assert loaded("", 'actuatorfrcrange="-4 4"', [100.0, -90.0]) == pytest.approx(limited, rel=1e-3)


def test_a_disabled_actuator_transmits_nothing():
    """Its group is switched off, or all actuators are: no torque, and no friction of one."""
    only_first = 1.0 + (2.0 - 1.0) / 0.2 * 0.01
    assert loaded('actuatorgroupdisable="3"', "", [2.0, 50.0]) == pytest.approx(only_first, rel=1e-3)
    xml = ANTAGONISTS.format("", "").replace("/>", '><flag actuation="disable"/></option>', 1)
    model = load(xml)
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION
    friction = effect("load_friction", "j", base=(0, 1), share=(0, 1))
    sim = MujocoSimulator(model, None, [friction], check_influence=False)
    windows = make_windows(model, 2, 20)
    predicted = sim.predict([[0.0, 0.9]], windows)[0]
    np.testing.assert_array_equal(predicted[..., 1], np.broadcast_to(windows.start[:, None, 1], (2, 20)))
