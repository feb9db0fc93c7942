"""Recordings of real robots as models and data sets for a diagnosis, read from the folder beside the checkout."""

import json
import re
from pathlib import Path

import mujoco
import numpy as np

from nfpde.dataset import Dataset, Episode, resample_episode, split_episode_at_gaps

REAL = Path(__file__).parents[2] / "shared" / "realdata"

DOUBLE_PENDULUM = """
<mujoco><option timestep="0.002" integrator="implicitfast"/>
<worldbody>
  <body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 -1 0"/>
    <inertial pos="0 0 {z1}" mass="{m1}" diaginertia="{i1} {i1} 1e-4"/>
    <body name="lower" pos="0 0 {l1}"><joint name="elbow" axis="0 -1 0"/>
      <inertial pos="0 0 {z2}" mass="{m2}" diaginertia="{i2} {i2} 1e-4"/></body></body>
</worldbody>
<actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/></actuator></mujoco>"""

SINGLE_PENDULUM = """
<mujoco><option timestep="0.001" integrator="implicitfast"/>
<worldbody><body name="rod" pos="0 0 1"><joint name="pivot" axis="0 -1 0"/>
  <inertial pos="0 0 -.45" mass=".676" diaginertia=".0034 .0034 .0007"/></body></worldbody>
<actuator><motor name="motor" joint="pivot"/></actuator></mujoco>"""

SERVO = """
<mujoco><option timestep="0.001" integrator="implicitfast"/>
<worldbody><body name="arm" pos="0 0 1"><joint name="servo" axis="0 -1 0" armature="0.002"/>
  <inertial pos="0 0 -.1" mass=".49" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody>
<actuator><position name="servo" joint="servo" kp="{kp}" kv="{kv}" forcerange="-{most} {most}"/></actuator></mujoco>"""


def double_pendulum(build="A.0", control_dt=0.01):
    """Two links of published masses, without friction or rotors, and its ten-second runs in torque control."""
    m1, m2, l1, r1, r2, i1, i2 = {
        "A.0": (0.559, 0.604, 0.3, 0.3, 0.184, 0.0535, 0.0239),
        "C.0": (0.642, 0.564, 0.2, 0.2, 0.321, 0.0267, 0.0539),
    }[build]
    numbers = {"m1": m1, "m2": m2, "l1": -l1, "z1": -r1, "z2": -r2}
    # published about the joints; not below what a point mass leaves
    about = {"i1": max(i1 - m1 * r1**2, 1e-4), "i2": max(i2 - m2 * r2**2, 1e-4)}
    model = mujoco.MjModel.from_xml_string(DOUBLE_PENDULUM.format(**numbers, **about))
    episodes = []
    for path in sorted((REAL / "double_pendulum" / f"design_{build}").glob("*.npz")):
        if "friccomp" in path.name:
            continue
        with np.load(path) as file:
            columns, data, time = file["columns"].tolist(), file["data"].astype(float), file["time"]
        take = lambda *names: data[:, [columns.index(n) for n in names]]  # noqa: B023, E731
        mark = "_meas" if "pos_meas1" in columns else ""
        torque = take("tau1", "tau2") if not mark else take("tau_con1", "tau_con2") + take("tau_fric1", "tau_fric2")
        whole = Episode(path.stem, time, take(f"pos{mark}1", f"pos{mark}2"), take(f"vel{mark}1", f"vel{mark}2"), torque)
        pieces = split_episode_at_gaps(whole, max_gap=0.0055)
        episodes += [resample_episode(p, control_dt, max_gap=0.0055) for p in pieces if p.duration > 1.0]
    return model, Dataset(episodes)


def single_pendulum(*runs, control_dt=0.01):
    """A rod with half a kilogram at its end, of the published drawing, and runs of controllers in torque control."""
    episodes = []
    for run in runs:
        table = np.loadtxt(REAL / "simple_pendulum" / run, delimiter=",", skiprows=1)
        whole = Episode(run.replace("/", " "), table[:, 0], table[:, [1]], table[:, [2]], table[:, [3]])
        pieces = split_episode_at_gaps(whole, max_gap=0.03)
        episodes += [resample_episode(p, control_dt, max_gap=0.03) for p in pieces if p.duration > 1.0]
    return mujoco.MjModel.from_xml_string(SINGLE_PENDULUM), Dataset(episodes)


def servo(gain=400, control_dt=0.01):
    """A hobby servo that lifts half a kilogram, as a position servo of its published motor constants."""
    kt, resistance, volts = 0.4, 3.5, 7.4
    kp = kt * volts / resistance * gain * (4096 / (2 * np.pi)) / (256 * 885)
    most = kt * volts / resistance
    model = mujoco.MjModel.from_xml_string(SERVO.format(kp=kp, kv=kt**2 / resistance, most=most))
    episodes = []
    for path in sorted((REAL / "bam_xl330" / "raw").glob("*.json")):
        run = json.loads(path.read_text())
        # in the other runs the torque is switched off for a part of the time, which no command says
        if run["kp"] != gain or not all(e["torque_enable"] for e in run["entries"]):
            continue
        fields = ("timestamp", "position", "speed", "goal_position")
        time, *rest = (np.array([e[k] for e in run["entries"]]) for k in fields)
        q, v, goal = (x[:, None] for x in rest)
        whole = Episode(run["trajectory"], time, q, v, goal)
        episodes.append(resample_episode(whole, control_dt, max_gap=0.05))
    return model, Dataset(episodes)


def quadruped(control_dt=0.005, contacts=False):
    """Twelve joints of a robot held in the air, as servos of the published gains; speeds by differences."""
    text = (REAL / "go2_inair" / "go2_dls.xml").read_text()
    gone = r"<mesh [^>]*/>|<geom[^>]*\bmesh=[^>]*/>|<freejoint/>|<sensor>.*?</sensor>|<keyframe>.*?</keyframe>"
    text = re.sub(gone, "", text, flags=re.DOTALL)
    text = re.sub(r"<motor class=\"\w+\" (name=\"\w+\" joint=\"\w+\")/>", r'<position \1 kp="20" kv="1.5"/>', text)
    text = text.replace("<option ", '<option timestep="0.005" integrator="implicitfast" ')
    if not contacts:  # its hips overlap with its body, which ignores them only while it floats
        text = text.replace('<geom friction="0.6"', '<geom contype="0" conaffinity="0" friction="0.6"')
    with np.load(REAL / "go2_inair" / "go2_traj_0.npz") as file:
        time, q, wanted = (file[k].astype(float) for k in ("time", "dof_pos", "des_dof_pos"))
    whole = Episode("chirp", time, q, np.gradient(q, time, axis=0), wanted)
    return mujoco.MjModel.from_xml_string(text), Dataset([resample_episode(whole, control_dt)])
