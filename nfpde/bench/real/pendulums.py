"""Pendulums in torque control of DFKI's Underactuated Lab, as their published drawings have them.

One of one link (github.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum) and two builds of one of two
links (github.com/dfki-ric-underactuated-lab/double_pendulum), both BSD-3-Clause.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from nfpde.dataset import Dataset, Episode, resample_episode, split_episode_at_gaps

CONTROL_DT = 0.01
"""Of what is diagnosed [s]; recorded every 1 to 20 ms, unevenly."""

_SIMPLE = """
<mujoco><option timestep="0.001" integrator="implicitfast"/>
<worldbody><body name="rod" pos="0 0 1"><joint name="pivot" axis="0 -1 0"/>
  <inertial pos="0 0 -.45" mass=".676" diaginertia=".0034 .0034 .0007"/></body></worldbody>
<actuator><motor name="motor" joint="pivot"/></actuator></mujoco>"""

_DOUBLE = """
<mujoco><option timestep="0.002" integrator="implicitfast"/>
<worldbody>
  <body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 -1 0"/>
    <inertial pos="0 0 {z1}" mass="{m1}" diaginertia="{i1} {i1} 1e-4"/>
    <body name="lower" pos="0 0 {l1}"><joint name="elbow" axis="0 -1 0"/>
      <inertial pos="0 0 {z2}" mass="{m2}" diaginertia="{i2} {i2} 1e-4"/></body></body>
</worldbody>
<actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/></actuator></mujoco>"""

_BUILDS = {
    "A.0": {"m1": 0.559, "m2": 0.604, "l1": 0.3, "r1": 0.3, "r2": 0.184, "i1": 0.0535, "i2": 0.0239},
    "C.0": {"m1": 0.642, "m2": 0.564, "l1": 0.2, "r1": 0.2, "r2": 0.321, "i1": 0.0267, "i2": 0.0539},
}
"""Published masses [kg], lengths and centres of mass [m], inertias about the joints [kg m2]."""


def simple_pendulum(folder: Path, *runs: str, control_dt: float = CONTROL_DT) -> tuple[mujoco.MjModel, Dataset]:
    """A rod with half a kilogram at its end, without friction, and runs of its controllers.

    Args:
        folder: of one folder a run, with tables of time, position, speed and torque.
        runs: tables in it.
        control_dt: control step to resample to [s].
    """
    episodes = []
    for run in runs:
        table = np.loadtxt(folder / run, delimiter=",", skiprows=1)
        whole = Episode(run.replace("/", " "), table[:, 0], table[:, [1]], table[:, [2]], table[:, [3]])
        episodes += _even(whole, 0.03, control_dt)
    return mujoco.MjModel.from_xml_string(_SIMPLE), Dataset(episodes)


def double_pendulum(folder: Path, build: str, control_dt: float = CONTROL_DT) -> tuple[mujoco.MjModel, Dataset]:
    """Two links, without friction or rotors, and the runs without compensation of friction of ten seconds each.

    Args:
        folder: of `design_<build>`, with an .npz a run: `time`, and `data` with the names of its `columns`.
        build: "A.0" or "C.0", whose links have changed places.
        control_dt: control step to resample to [s].
    """
    p = _BUILDS[build]
    numbers = {"m1": p["m1"], "m2": p["m2"], "l1": -p["l1"], "z1": -p["r1"], "z2": -p["r2"]}
    # published about the joints; about a centre of mass not below what a point has
    about = {f"i{k}": max(p[f"i{k}"] - p[f"m{k}"] * p[f"r{k}"] ** 2, 1e-4) for k in (1, 2)}
    model = mujoco.MjModel.from_xml_string(_DOUBLE.format(**numbers, **about))
    paths = sorted((folder / f"design_{build}").glob("*.npz"))
    runs = [_double_run(path) for path in paths if "friccomp" not in path.name]
    return model, Dataset([piece for run in runs for piece in _even(run, 0.0055, control_dt)])


def _double_run(path: Path) -> Episode:
    with np.load(path) as file:
        columns, data, time = file["columns"].tolist(), file["data"].astype(float), file["time"]

    def take(*names: str) -> np.ndarray:
        return data[:, [columns.index(name) for name in names]]

    mark = "_meas" if "pos_meas1" in columns else ""
    # what the motors were told: the controller's torque and the friction compensation that it adds
    torque = take("tau_con1", "tau_con2") + take("tau_fric1", "tau_fric2") if mark else take("tau1", "tau2")
    return Episode(path.stem, time, take(f"pos{mark}1", f"pos{mark}2"), take(f"vel{mark}1", f"vel{mark}2"), torque)


def _even(run: Episode, max_gap: float, control_dt: float) -> list[Episode]:
    """Pieces of more than a second between gaps, at an even control step."""
    pieces = split_episode_at_gaps(run, max_gap=max_gap)
    return [resample_episode(piece, control_dt, max_gap=max_gap) for piece in pieces if piece.duration > 1.0]
