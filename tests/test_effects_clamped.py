"""Commands beyond their range: clamped before anything remembers them, as MuJoCo clamps those of its own filters."""

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadParameter
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator
from tests.models import load, make_windows, plain_rollout, with_arrays

WHEEL = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0">{flag}</option>
  <worldbody>
    <body>
      <joint name="axle" axis="0 0 1" damping="0.1"/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.2"/>
    </body>
  </worldbody>
  <actuator><general name="drive" joint="axle" ctrlrange="-1 1" {more}/></actuator>
</mujoco>
"""
FREE = '<flag clampctrl="disable"/>'
LAG = ("actuator_lag", "drive", {"time_constant": (0, 0.1)})
DELAYS = [("actuation_delay", "drive", {"delay": (0, 0.02)}), ("observation_delay", None, {"delay": (0, 0.02)})]


def wheel(more="", flag=""):
    return load(WHEEL.format(more=more, flag=flag))


def moved(given, value, ctrl, flag=""):
    """Speeds (S,) of the wheel from rest under commands (S,) with an effect; before the start there were none."""
    name, target, bounds = given
    sim = MujocoSimulator(wheel(flag=flag), None, [effect(name, target, **bounds)], check_influence=False)
    windows = make_windows(sim.model, 1, len(ctrl), history=sim.history_steps(0.001))
    windows = with_arrays(
        windows, state=np.zeros_like(windows.state), ctrl=ctrl[None, :, None], history=np.zeros_like(windows.history)
    )
    return sim.predict([[value]], windows)[0, 0, :, 1]


@pytest.mark.parametrize("size", [1.0, 4.0])
def test_a_lag_winds_up_no_more_than_mujocos_filter(size):
    """Four times the range is the range, on the way up and on the way down again, within half a physics step."""
    ctrl = np.where(np.arange(400) < 100, size, 0.0)
    own = wheel(more='dyntype="filterexact" dynprm="0.05"')
    expected = plain_rollout(own, np.zeros(2), ctrl[:, None], 1)[:, 1]
    np.testing.assert_allclose(moved(LAG, 0.05, ctrl), expected, atol=1.1 * 0.001 / 0.2)


@pytest.mark.parametrize("given", [LAG, *DELAYS], ids=lambda e: e[0])
@pytest.mark.parametrize("flag", ["", FREE], ids=["clamped", "not clamped"])
def test_what_is_beyond_the_range_does_not_count(given, flag):
    """A command of 4 where 1 is the most is a command of 1, unless MuJoCo is told not to clamp."""
    value = 0.03 if given is LAG else 0.0105
    signs = np.sign(np.sin(np.arange(300) / 7))
    high, low = moved(given, value, 4.0 * signs, flag), moved(given, value, signs, flag)
    if flag:
        np.testing.assert_allclose(high, 4.0 * low, rtol=0, atol=1e-12)
        assert np.abs(low).max() > 1e-3
    else:
        np.testing.assert_array_equal(high, low)


@pytest.mark.parametrize("given", [LAG, *DELAYS], ids=lambda e: e[0])
def test_within_the_range_nothing_changes(given):
    """The bits of a model that has no range."""
    ctrl = np.random.default_rng(0).uniform(-1, 1, 200)
    value = 0.03 if given is LAG else 0.0105
    np.testing.assert_array_equal(moved(given, value, ctrl), moved(given, value, ctrl, FREE))


MODEL = """
<mujoco>
  <worldbody>
    <body><joint name="a" axis="0 1 0"/><geom size="0.1"/>
      <body pos="0 0 -0.5"><joint name="b" axis="0 1 0"/><geom size="0.1"/></body>
    </body>
  </worldbody>
  <actuator>
    <position name="first" joint="a" kp="5" ctrlrange="-1 1" armature="{armature}"/>
    <position name="second" joint="b" kp="5" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""
TAKES_THE_RANGE = [
    ("dead_zone", "first", {"half_width": (0, 1)}),
    ("dead_zone_gate", "first", {"half_width": (0, 1)}),
    ("backlash", "first", {"width": (0, 1)}),
    ("backlash_geared_outer", "first", {"width": (0, 1)}),
    ("backlash_command", "first", {"width": (0, 1)}),
    ("load_friction", "a", {"base": (0, 1), "share": (0, 1)}),
    ("actuation_delay", "*", {"delay": (0, 0.1)}),
    ("actuator_lag", "first", {"time_constant": (0, 0.1)}),
    ("observation_delay", None, {"delay": (0, 0.1)}),
]


@pytest.mark.parametrize("given", TAKES_THE_RANGE, ids=lambda e: e[0])
def test_a_range_that_is_to_be_found_is_refused_beside_what_would_not_see_it(given):
    """Of the actuator that the effect is about; another one's range may be free."""
    name, target, bounds = given
    model = load(MODEL.format(armature=0))

    def with_free(actuator):
        space = ParameterSpace([Parameter("actuator_ctrlrange", actuator, 0.5, 2.0, component=1)])
        return MujocoSimulator(model, space, [effect(name, target, **bounds)], check_influence=False)

    with pytest.raises(BadParameter, match=rf"actuator_ctrlrange:first\[1\]: the effect {name} on .* leave the param"):
        with_free("first")
    if target in ("first", "a"):
        assert len(with_free("second").space) == 1 + len(bounds)


def test_an_armature_that_is_to_be_found_is_the_joints_beside_a_play():
    """`actuator_armature` would stay at the joint while the rotor is free."""
    model = load(MODEL.format(armature=0))
    play = effect("backlash", "first", width=(0, 1))
    space = ParameterSpace([Parameter("actuator_armature", "first", 0.0, 1.0)])
    with pytest.raises(BadParameter, match="the effect backlash on first takes actuator_armature from the model"):
        MujocoSimulator(model, space, [play], check_influence=False)
    fine = ParameterSpace([Parameter("dof_armature", "a", 0.0, 1.0)])
    assert len(MujocoSimulator(model, fine, [play], check_influence=False).space) == 2
