"""A small arm whose recordings carry faults written out by hand, for tests of the diagnosis."""

import mujoco
import numpy as np

from nfpde.dataset import Dataset, Episode

ARM = """
<mujoco><option timestep="0.005" integrator="implicitfast"/>
<worldbody>
  <body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="0.05"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="1.5"/>
    <body name="fore" pos="0 0 -.4"><joint name="elbow" axis="0 1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.35" size=".025" mass="1"/></body></body>
</worldbody>
<actuator><motor name="lift" joint="shoulder"/><motor name="bend" joint="elbow"/></actuator></mujoco>
"""


def nominal():
    return mujoco.MjModel.from_xml_string(ARM)


def record(change=lambda model: None, force=lambda data: 0.0, *, noise=0.0, episodes=6, rows=300, seed=0, let=1.0):
    """Episodes of a changed arm, with an extra torque on the elbow, driven by sums of sines.

    Speeds pass a filter of first order that lets so much of a new one through in every physics step.
    """
    rng = np.random.default_rng(seed)
    out = []
    for number in range(episodes):
        model = nominal()
        change(model)
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        mujoco.mj_resetData(model, data)
        data.qpos[:] = rng.normal(size=2) * 0.5
        slow = np.zeros(2)
        time = np.arange(rows) * 0.01
        rate, phase = rng.uniform(0.3, 2.5, (2, 4)), rng.uniform(0, 2 * np.pi, (2, 4))
        wave = np.sin(2 * np.pi * rate[..., None] * time + phase[..., None]).sum(1)
        ctrl = (np.array([2.0, 0.8])[:, None] * wave).T
        qpos, qvel = np.empty((rows, 2)), np.empty((rows, 2))
        for row in range(rows):
            qpos[row], qvel[row] = data.qpos, slow
            data.ctrl[:] = ctrl[row]
            for _ in range(2):
                data.qfrc_applied[1] = force(data)
                mujoco.mj_step(model, data)
                slow = slow + let * (data.qvel - slow)
        qpos += noise * np.array([0.5, 0.8]) * rng.normal(size=qpos.shape)
        qvel += noise * np.array([3.0, 8.0]) * rng.normal(size=qvel.shape)
        out.append(Episode(str(number), time, qpos, qvel, ctrl))
    return Dataset(out)
