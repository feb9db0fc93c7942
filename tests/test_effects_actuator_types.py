"""Actuators of every type that MuJoCo has: which effects may read and write their parameters, and what then happens."""

import mujoco
import numpy as np
import pytest

from nfpde.effects import DataScales, all_candidates, effect
from nfpde.effects.drive import is_servo
from nfpde.errors import BadEffect
from nfpde.sim import load_model
from tests.effect_checks import make
from tests.models import load, record

PLANT = """
<mujoco>
  {extension}
  <worldbody>
    <geom type="plane" size="1 1 1" pos="0 0 -0.1"/>
    <body>
      <joint name="hinge" axis="0 1 0" range="-60 60" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
      <body name="hand" pos="0.3 0 0"><joint name="ball" type="ball"/><geom size="0.12"/></body>
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""
"""A hinge and a ball joint; the hand touches the floor."""

EXTENSION = '<extension><plugin plugin="mujoco.pid"><instance name="own"/></plugin></extension>'

MUSCLE = '<general joint="hinge" gaintype="muscle" gainprm="0.7 1 {} {} 0.5 1.6 1.5 1.3 1.2" lengthrange="-1 1"'
SCALED = {
    "motor": '<motor joint="hinge" gear="3"/>',
    "position": '<position joint="hinge" kp="10" kv="1"/>',
    "velocity": '<velocity joint="hinge" kv="2"/>',
    "damper": '<damper joint="hinge" kv="1" ctrlrange="0 1"/>',
    "affine": '<general joint="hinge" gaintype="affine" gainprm="1 2 3" biastype="affine" biasprm="1 2 3"/>',
    "pid": '<pid joint="hinge" kp="10" kv="1"/>',
    "orientation": '<orientation joint="ball" kp="3" kv="0.2"/>',
    "adhesion": '<adhesion body="hand" gain="5" ctrlrange="0 1"/>',
    "muscle by force": MUSCLE.format(30, 200) + "/>",
    "muscle by scale": MUSCLE.format(-1, 150) + ' biastype="muscle" biasprm="0.7 1 -1 150 0.5 1.6 1.5 1.3 1.2"/>',
    "muscle and spring": MUSCLE.format(-1, 150) + ' biastype="affine" biasprm="1 2 3"/>',
}
REFUSED = {
    "dcmotor": '<dcmotor joint="hinge" motorconst="0.05" resistance="2"/>',
    "feedforward": '<pid joint="hinge" kp="10" kv="1" input="pos vel ff"/>',
    "user": '<general joint="hinge" gaintype="user"/>',
    "user bias": '<general joint="hinge" biastype="user"/>',
    "plugin": '<plugin joint="hinge" plugin="mujoco.pid" instance="own"/>',
}


def plant(actuator):
    return PLANT.format(actuator=actuator, extension=EXTENSION if "plugin" in actuator else "")


def force(model):
    """What the actuator gives in some state."""
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    data.qpos[0], data.qvel[:] = 0.1, rng.normal(size=model.nv)
    data.ctrl[:] = rng.uniform(0.2, 0.8, model.nu)
    mujoco.mj_forward(model, data)
    return data.actuator_force.copy()


@pytest.mark.parametrize("kind", SCALED)
@pytest.mark.parametrize("scale", [0.0, 0.7, 1.6])
def test_strength_scales_the_force_of_every_actuator_that_it_takes(kind, scale):
    """MuJoCo's own force, after it has derived its constants again, is the nominal one times the factor."""
    model = load_model(load(plant(SCALED[kind])))
    whole = force(model)
    assert np.abs(whole).min() > 0.01
    effect("motor_strength", "*", scale=(0, 2)).bind(model).write_model(model, np.array([scale]))
    mujoco.mj_setConst(model, mujoco.MjData(model))
    np.testing.assert_allclose(force(model), scale * whole, rtol=1e-12, atol=1e-14)  # products in another order


@pytest.mark.parametrize("kind", REFUSED)
def test_strength_refuses_actuators_whose_force_is_no_multiple_of_their_fields(kind):
    """By name it is an error that says so, and a diagnosis does not try it there."""
    model = load_model(load(plant(REFUSED[kind])))
    with pytest.raises(BadEffect, match=r"'#0': the force of actuator #0 is no multiple of its gainprm and biasprm"):
        effect("motor_strength", "#0", scale=(0, 2)).bind(model)
    if kind.startswith("user"):
        return  # nothing can be recorded without the function
    tried = {e.name for e in all_candidates(model, DataScales.of(model, record(model, 1, 20, 4)))}
    assert {"actuator_bias", "torque_limit"} <= tried
    assert "motor_strength" not in tried


def test_a_plugin_is_no_motor():
    """It has the fields of one and does not look at them: what reads a torque from them is refused."""
    text = "actuator #0 is no motor, position servo or velocity servo"
    for name, bounds in (("dead_zone", {"half_width": (0, 1)}), ("backlash", {"width": (0, 0.1)})):
        with pytest.raises(BadEffect, match=text):
            make(name, "#0", plant(REFUSED["plugin"]), **bounds)


def test_a_gain_that_depends_on_the_state_is_no_servos():
    """A servo gives kp (ctrl - position): with a gain that changes there is no one kp to scale, nor an error."""
    xml = plant(SCALED["affine"])
    with pytest.raises(BadEffect, match="it needs position or velocity servos"):
        make("servo_gain", "#0", xml, kp_scale=(0.2, 5), kv_scale=(0.2, 5))
    assert not is_servo(load(xml), 0)
    assert is_servo(load(plant(SCALED["position"])), 0)
