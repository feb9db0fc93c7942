"""Kernels of drives beside each other, at joints with several actuators, and under commands beyond their range."""

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadModel
from nfpde.sim.warp import WarpSimulator
from tests.device import WARP
from tests.models import DOUBLE_PENDULUM, load, make_windows, with_arrays

# As in test_warp_effects: a few units after 20 physics steps in single precision, friction switching on the way
TOLERANCE = 5e-5

MOTORS = '<motor joint="shoulder" gear="3"/>\n    <motor name="elbow_motor" joint="elbow"/>'
RANGED = DOUBLE_PENDULUM.replace(
    MOTORS,
    '<position joint="shoulder" gear="2" kp="20" kv="1" ctrlrange="-0.5 0.5"/>'
    '<motor name="elbow_motor" joint="elbow" ctrlrange="-0.7 0.7"/>',
)
TOGETHER = DOUBLE_PENDULUM.replace('name="elbow" axis="0 1 0"', 'name="elbow" axis="0 1 0" actuatorfrcrange="-1 1"')
TOGETHER = TOGETHER.replace(
    MOTORS,
    '<motor joint="shoulder"/><motor joint="shoulder" group="3"/><motor name="elbow_motor" joint="elbow" gear="6"/>'
    '<motor joint="elbow" gear="-5"/>',
)
DISABLED = TOGETHER.replace('timestep="0.002"', 'timestep="0.002" actuatorgroupdisable="3"')
UNPOWERED = TOGETHER.replace(
    '<option timestep="0.002"/>', '<option timestep="0.002"><flag actuation="disable"/></option>'
)

LINE = effect("torque_speed", "*", no_load_speed=(0.5, 5.0), stall_torque=(0.2, 3.0))
LOAD = effect("load_friction", "*", base=(0.0, 0.3), share=(0.0, 0.9))
PLAY = effect("backlash", "*", width=(0.0, 0.1))
GEARED = effect("backlash_geared", "*", width=(0.0, 0.1))
ZONE = effect("dead_zone", "*", half_width=(0.0, 0.5))
STRIBECK = effect("stribeck_friction", "*", coulomb=(0.0, 0.5), static=(0.0, 1.0), speed=(0.05, 0.5))


def equals_its_twin(xml, *effects, size=1.0):
    """Predictions all over the bounds are those of plain MuJoCo, and differ from each other; returns them."""
    sim = WarpSimulator(load(xml), None, effects, device=WARP, check_influence=False)
    windows = make_windows(sim.model, 4, 5, nsub=4, history=sim.history_steps(4 * sim.model.opt.timestep))
    windows = with_arrays(windows, ctrl=size * windows.ctrl, history=size * windows.history)
    xi = np.vstack([sim.space.uniform(4, np.random.default_rng(0)), sim.space.low, sim.space.high])
    expected = sim.reference.predict(xi, windows)
    predicted = sim.predict(xi, windows)
    assert np.ptp(expected, axis=0).max() > 100 * TOLERANCE
    np.testing.assert_allclose(predicted, expected, atol=TOLERANCE)
    return sim, windows, xi, predicted


@pytest.mark.parametrize(
    "together",
    [(LOAD, LINE), (PLAY, LINE), (PLAY, ZONE), (GEARED, STRIBECK)],
    ids=lambda t: "-".join(e.name for e in t),
)
def test_the_order_in_the_list_does_not_matter(together):
    """Kernels run in the order of the effects' own, as their twins do; the same bits for any list."""
    _, windows, xi, predicted = equals_its_twin(RANGED, *together)
    first = len(together[0].parameters)
    other = WarpSimulator(load(RANGED), None, together[::-1], device=WARP, check_influence=False)
    turned = other.predict(np.hstack([xi[:, first:], xi[:, :first]]), windows)
    np.testing.assert_array_equal(turned, predicted)


@pytest.mark.parametrize(
    "given",
    [
        effect("actuation_delay", "*", delay=(0.0, 0.03)),
        effect("observation_delay", delay=(0.0, 0.03)),
        effect("actuator_lag", "*", time_constant=(0.0, 0.02)),
    ],
    ids=lambda e: e.name,
)
def test_commands_beyond_their_range_are_clamped_before(given):
    """Four times the range, through delays and lags, of actuators with different ranges."""
    equals_its_twin(RANGED, given, size=4.0)


@pytest.mark.parametrize("xml", [TOGETHER, UNPOWERED], ids=["limited together", "unpowered"])
def test_what_several_actuators_transmit_together(xml):
    """A limit of the joint is one of their sum, and what is disabled transmits nothing."""
    equals_its_twin(xml, LOAD)


def test_groups_that_are_switched_off_are_refused():
    """MuJoCo Warp would let their actuators act."""
    with pytest.raises(BadModel, match=r"actuatorgroupdisable switches off actuator #1.* use device='cpu'"):
        WarpSimulator(load(DISABLED), None, [LOAD], device=WARP, check_influence=False)
    others = DISABLED.replace('actuatorgroupdisable="3"', 'actuatorgroupdisable="4"')
    assert WarpSimulator(load(others), None, [LOAD], device=WARP, check_influence=False).space
