"""Sensor noise on recordings: every measured state is off by a share of what its channel moves."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from nfpde.dataset import Dataset, Episode
from nfpde.dataset.velocities import differentiated
from nfpde.sim import StateSpace

Array = NDArray[np.float64]


def with_noise(model: mujoco.MjModel, dataset: Dataset, share: float, seed: int) -> tuple[Dataset, Array]:
    """The recordings with white Gaussian noise on every measured state.

    A state is both the end of one transition and the start of the next, so that neither is exact. Rotations of free
    and ball joints are turned by a small rotation vector and stay unit quaternions.

    Args:
        model: of the robot.
        dataset: recordings without noise.
        share: standard deviation of the noise, in standard deviations of each channel over all recordings; 0 for none.
        seed: of the noise.

    Returns:
        The noisy recordings, and the standard deviation of the noise of every channel of a state difference,
        (2 nv,), positions first.
    """
    states = StateSpace.of_model(model)
    sigma = share * channel_spread(states, dataset)
    if share == 0:
        return dataset, sigma
    rng = np.random.default_rng([seed, 1])  # not the stream that the recordings were made with
    episodes = []
    for e in dataset:
        noise = sigma * rng.standard_normal((len(e), 2 * model.nv))
        rows = states.moved(np.hstack([e.qpos, e.qvel]), noise)
        episodes.append(Episode(e.name, e.time, rows[:, : model.nq], rows[:, model.nq :], e.ctrl, e.robot))
    return replace(dataset, episodes=episodes), sigma


def apart(dataset: Dataset) -> Dataset:
    """The same recordings with every transition as an episode of its own, of the same robot as before.

    Noise put on them afterwards is another one at the end of a transition and at the start of the next, as if every
    transition were measured anew.
    """
    pieces = []
    for e in dataset:
        for t in range(len(e) - 1):
            rows = slice(t, t + 2)
            name, robot = f"{e.name}.{t}", e.robot or e.name
            pieces.append(Episode(name, e.time[rows], e.qpos[rows], e.qvel[rows], e.ctrl[rows], robot))
    return replace(dataset, episodes=pieces)


def differenced(dataset: Dataset) -> Dataset:
    """The same positions with velocities taken from them, which the data set says; of robots without quaternions."""
    return differentiated(dataset)


def filtered(dataset: Dataset) -> Dataset:
    """The same positions with velocities as the firmware of many drives reports them; of robots without quaternions.

    Differences to the row before, through a low-pass of first order whose time constant is a control step. Nobody says
    so, and no digits tell.
    """
    weight, episodes = 1.0 - np.exp(-1.0), []
    for e in dataset:
        rates = np.diff(e.qpos, axis=0, prepend=e.qpos[:1]) / dataset.control_dt
        qvel = lfilter([weight], [1.0, weight - 1.0], rates, axis=0)
        episodes.append(replace(e, qvel=qvel))
    return replace(dataset, episodes=episodes)


def channel_spread(states: StateSpace, dataset: Dataset) -> Array:
    """Standard deviation of every channel over all rows of all recordings, (ndiff,)."""
    rows = np.concatenate([np.hstack([e.qpos, e.qvel]) for e in dataset])
    # the difference normalises the mean of the quaternions
    return states.difference(rows, rows.mean(0)).std(0)
