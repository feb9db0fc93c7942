"""A hobby servo that lifts half a kilogram: Dynamixel XL330 of Rhoban's test bench (github.com/Rhoban/bam, Apache-2.0).

BAM: Duclusaud et al., "Extended friction models for the physics simulation of servo actuators", ICRA 2025.
"""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np

from nfpde.dataset import Dataset, Episode, resample_episode

_SERVO = """
<mujoco><option timestep="0.001" integrator="implicitfast"/>
<worldbody><body name="arm" pos="0 0 1"><joint name="servo" axis="0 -1 0" armature="0.002"/>
  <inertial pos="0 0 -.1" mass=".49" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody>
<actuator><position name="servo" joint="servo" kp="{kp}" kv="{kv}" forcerange="-{most} {most}"/></actuator></mujoco>"""

_TORQUE_CONSTANT, _RESISTANCE, _VOLTS = 0.4, 3.5, 7.4
"""Rough values of the motor behind its gear [Nm/A], [ohm], [V]."""


def servo(folder: Path, gain: int, control_dt: float = 0.01) -> tuple[mujoco.MjModel, Dataset]:
    """The servo as a voltage source behind a resistance, and the runs of one gain with the torque on all the time.

    Args:
        folder: of `raw`, with a .json a run.
        gain: proportional gain of the firmware: 100, 200, 400 or 800.
        control_dt: control step to resample to [s].
    """
    most = _TORQUE_CONSTANT * _VOLTS / _RESISTANCE
    kp = most * gain * (4096 / (2 * np.pi)) / (256 * 885)  # the firmware's units
    xml = _SERVO.format(kp=kp, kv=_TORQUE_CONSTANT**2 / _RESISTANCE, most=most)
    episodes = []
    for path in sorted((folder / "raw").glob("*.json")):
        run = json.loads(path.read_text(encoding="utf-8"))
        # in the other runs the torque is switched off for a part of the time, which no command says
        if run["kp"] != gain or not all(entry["torque_enable"] for entry in run["entries"]):
            continue
        fields = ("timestamp", "position", "speed", "goal_position")
        time, *rest = (np.array([entry[name] for entry in run["entries"]]) for name in fields)
        q, v, goal = (values[:, None] for values in rest)
        episodes.append(resample_episode(Episode(run["trajectory"], time, q, v, goal), control_dt, max_gap=0.05))
    return mujoco.MjModel.from_xml_string(xml), Dataset(episodes)
