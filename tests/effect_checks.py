"""What every effect is held to: the motion of plain MuJoCo with the mechanism in it, several values in one batch."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nfpde.dataset import Dataset, Episode, Windows
from nfpde.effects import effect
from nfpde.sim import MujocoSimulator, load_model
from tests.models import load, make_windows, plain_rollout

SERVO_ARM = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="upper" pos="0 0 2">
      <joint name="shoulder" axis="0 1 0" damping="0.2" armature="0.02"/>
      <geom name="upper_arm" type="capsule" fromto="0 0 0 0 0 -0.6" size="0.04" mass="1.2"/>
      <body name="lower" pos="0 0 -0.6">
        <joint name="elbow" axis="0 1 0" damping="0.1" armature="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03" mass="0.7"/>
        <body name="hand" pos="0 0 -0.5">
          <joint name="wrist" axis="1 0 0" damping="0.02" armature="0.005"/>
          <geom type="box" size="0.03 0.05 0.06" pos="0.01 0 -0.06" mass="0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder_servo" joint="shoulder" kp="40" kv="3"/>
    <velocity name="elbow_servo" joint="elbow" kv="1.5" gear="2"/>
    <motor name="wrist_motor" joint="wrist" gear="0.5"/>
  </actuator>
</mujoco>
"""
"""Three joints: a position servo, a velocity servo and a motor; the wrist turns across the other two."""


def make(name: str, target: Any = None, xml: str = SERVO_ARM, **bounds: Any) -> MujocoSimulator:
    """A simulator of a model with one effect."""
    return MujocoSimulator(load(xml), None, [effect(name, target, **bounds)], check_influence=False)


def predict(sim: MujocoSimulator, values: Sequence[ArrayLike], windows: Windows) -> np.ndarray:
    """Predictions (M, N, H, nx) of one batch; values may lie outside the bounds, as neutral ones do."""
    m, n = len(values), len(windows)
    rows = sim.rollout(np.array(values, float), windows, np.arange(m).repeat(n), np.tile(np.arange(n), m))
    return rows.reshape(m, n, windows.horizon, -1)


def neutral_does_nothing(sim: MujocoSimulator, others: Sequence[ArrayLike], xml: str = SERVO_ARM, **kwargs):
    """At its neutral values an effect leaves every bit of the motion alone, other rows of the batch active."""
    windows = make_windows(sim.model, 3, 10, nsub=4, history=sim.history_steps(0.008), **kwargs)
    model = load_model(load(xml))
    among = predict(sim, [sim.nominal(), *others, sim.nominal()], windows)
    for n in range(3):
        expected = plain_rollout(model, windows.start[n], windows.ctrl[n], 4)
        np.testing.assert_array_equal(among[0, n], expected)
        np.testing.assert_array_equal(among[-1, n], expected)


def rows_are_apart(sim: MujocoSimulator, values: Sequence[ArrayLike], **kwargs):
    """A batch of different values holds the same bits as each of them alone, and no two are equal."""
    windows = make_windows(sim.model, 3, 10, nsub=4, history=sim.history_steps(0.008), **kwargs)
    together = predict(sim, values, windows)
    for value, rows in zip(values, together, strict=True):
        np.testing.assert_array_equal(predict(sim, [value], windows)[0], rows)
    assert all(np.abs(a - b).max() > 1e-9 for i, a in enumerate(together) for b in together[:i])


def same_as(
    sim: MujocoSimulator,
    value: ArrayLike,
    xml_or_model,
    before_step: Callable | None = None,
    *,
    atol: float = 1e-11,
    horizon: int = 12,
    **kwargs,
):
    """The predictions of plain MuJoCo with the mechanism in the model, or written out by hand before each step."""
    windows = make_windows(sim.model, 4, horizon, nsub=4, history=sim.history_steps(0.008), **kwargs)
    model = load_model(load(xml_or_model) if isinstance(xml_or_model, str) else xml_or_model)
    predicted = predict(sim, [value], windows)[0]
    for n in range(4):
        expected = plain_rollout(model, windows.start[n], windows.ctrl[n], 4, before_step)
        # another order of the same sums: rounding, multiplied over the steps of a window
        np.testing.assert_allclose(predicted[n], expected, rtol=0, atol=atol)


def replaced(old: str, new: str, xml: str = SERVO_ARM) -> str:
    """MJCF with one text in it replaced, which must be there."""
    assert old in xml, old
    return xml.replace(old, new)


def recording(states: np.ndarray, ctrl: np.ndarray, model, control_dt: float) -> Dataset:
    """One episode from states (T, nx) and the commands that were sent (T, nu)."""
    time = np.arange(len(states)) * control_dt
    return Dataset([Episode("0", time=time, qpos=states[:, : model.nq], qvel=states[:, model.nq :], ctrl=ctrl)])
