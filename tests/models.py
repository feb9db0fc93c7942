"""Small models with known physics, and the slow twin of the simulator: a plain loop over mj_step."""

import copy

import mujoco
import numpy as np

from nfpde.dataset import Dataset, Episode, Windows
from nfpde.sim import ModelWriter

PENDULUM = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="rod" pos="0 0 1">
      <joint name="hinge" axis="0 1 0" damping="0.1"/>
      <inertial pos="0 0 -0.5" mass="1.5" diaginertia="0.04 0.05 0.01"/>
      <geom name="bob" type="sphere" size="0.05" pos="0 0 -0.5" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" gear="2"/></actuator>
</mujoco>
"""
"""A rod under gravity with a motor."""

FLYWHEEL = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0" integrator="{integrator}"/>
  <worldbody>
    <body name="wheel">
      <joint name="axle" axis="0 0 1" frictionloss="{frictionloss}"/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.2"/>
    </body>
  </worldbody>
  <actuator><motor joint="axle"/></actuator>
</mujoco>
"""
"""A wheel that only its motor and friction act on; inertia 0.2 kg m²."""

DOUBLE_PENDULUM = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="upper" pos="0 0 2">
      <joint name="shoulder" axis="0 1 0" damping="0.2"/>
      <geom name="upper_arm" type="capsule" fromto="0 0 0 0 0 -0.6" size="0.04" mass="1.2"/>
      <body name="lower" pos="0 0 -0.6">
        <joint name="elbow" axis="0 1 0" damping="0.1" armature="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03" mass="0.7"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="shoulder" gear="3"/>
    <motor name="elbow_motor" joint="elbow"/>
  </actuator>
</mujoco>
"""
"""Two links with motors; one actuator without a name."""

BLOCK = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1" friction="0.2 0.005 0.0001"/>
    <body name="block" pos="0 0 0.1">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom name="box" type="box" size="0.1 0.1 0.1" mass="2" friction="0.5 0.005 0.0001"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="x"/></actuator>
</mujoco>
"""
"""A block on a floor; the contact takes the box's friction, which is the larger."""

FREE_BOX = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="box" pos="0 0 1">
      <freejoint name="root"/>
      <inertial pos="0.01 0 0" mass="1" diaginertia="0.01 0.02 0.025"/>
      <geom type="box" size="0.1 0.15 0.2"/>
    </body>
  </worldbody>
</mujoco>
"""
"""A box in free flight, above a floor."""

BALL = """
<mujoco>
  <worldbody>
    <body name="arm">
      <joint name="before" type="slide" axis="1 0 0"/>
      <geom size="0.1"/>
      <body name="hand" pos="0 0 -0.2">
        <joint name="ball" type="ball"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 -0.3" size="0.03"/>
        <body name="finger" pos="0.1 0 -0.3">
          <joint name="after" axis="1 0 0"/>
          <geom size="0.02" pos="0 0.1 0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
"""A slide, a ball joint and a hinge: the quaternion stands in the middle of qpos."""


def load(xml):
    return mujoco.MjModel.from_xml_string(xml)


def make_windows(model, n, horizon, *, nsub=1, history=0, seed=0, spread=0.3, speed=1.0):
    """Windows of random commands from random states around the model's initial one, targets included at random."""
    rng = np.random.default_rng(seed)
    state = np.empty((n, horizon + 1, model.nq + model.nv))
    for row in state.reshape(-1, state.shape[2]):
        qpos = model.qpos0.copy()
        mujoco.mj_integratePos(model, qpos, spread * rng.normal(size=model.nv), 1.0)
        row[:] = np.concatenate([qpos, speed * rng.normal(size=model.nv)])
    return Windows(
        state=state,
        ctrl=rng.uniform(-1, 1, (n, horizon, model.nu)),
        history=rng.uniform(-1, 1, (n, history, model.nu)),
        control_dt=nsub * model.opt.timestep,
        nq=model.nq,
        nv=model.nv,
        episode=np.zeros(n, int),
        row=np.arange(n),
    )


def with_arrays(windows, **arrays):
    """A copy with other states, commands or histories."""
    names = ("state", "ctrl", "history", "past", "control_dt", "nq", "nv", "episode", "row")
    old = {name: getattr(windows, name) for name in names}
    return Windows(**(old | arrays))


def parameterised(model, base, xi):
    """A fresh copy of the model with a parameter vector written into it."""
    changed = copy.copy(model)
    ModelWriter(model, base).write(changed, np.asarray(xi, float))
    return changed


def plain_rollout(model, start, ctrl, nsub, before_step=None):
    """States (H, nx) after each control step; ctrl is (H, nu), or (H nsub, nu) for a command per physics step."""
    data = mujoco.MjData(model)
    mujoco.mj_resetData(model, data)
    data.qpos[:], data.qvel[:] = start[: model.nq], start[model.nq :]
    out = []
    for row, command in enumerate(ctrl):
        data.ctrl[:] = command
        for _ in range(nsub):
            if before_step is not None:
                before_step(model, data)
            mujoco.mj_step(model, data)
        out.append(np.concatenate([data.qpos, data.qvel]))
        assert not any(w.number for w in data.warning), f"the plain loop diverged in step {row}"
    return np.array(out)


def record(model, episodes, steps, nsub, seed=0, amplitude=1.0):
    """A data set recorded from the model under random commands, as a logger on the robot would."""
    rng = np.random.default_rng(seed)
    found = []
    for e in range(episodes):
        qpos = model.qpos0.copy()
        mujoco.mj_integratePos(model, qpos, 0.05 * rng.normal(size=model.nv), 1.0)
        start = np.concatenate([qpos, 0.05 * rng.normal(size=model.nv)])
        ctrl = amplitude * rng.uniform(-1, 1, (steps + 1, model.nu))
        states = np.concatenate([start[None], plain_rollout(model, start, ctrl[:-1], nsub)])
        time = np.arange(steps + 1) * nsub * model.opt.timestep
        found.append(Episode(str(e), time=time, qpos=states[:, : model.nq], qvel=states[:, model.nq :], ctrl=ctrl))
    return Dataset(found)
