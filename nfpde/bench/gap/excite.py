"""Motions that an experimenter commands: chirps, sums of sines, steps, filtered noise; open loop or tracked."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nfpde.bench.gap.robots import Robot

Array = NDArray[np.float64]
Controller = Callable[[int, Array, Array], Array]
"""From row, measured qpos (nq,) and qvel (nv,) to the command (nu,)."""


def chirp(n: int, dt: float, top: float, rng: np.random.Generator) -> Array:
    """A sine (n,) in [-1, 1] whose frequency rises from a tenth of `top` to `top` [Hz], or falls."""
    time = np.arange(n) * dt
    low, length = top / 10, n * dt
    phase = 2 * np.pi * (low * time + (top - low) * time**2 / (2 * length)) + rng.uniform(0, 2 * np.pi)
    wave = np.sin(phase)
    return wave[::-1] if rng.random() < 0.3 else wave


def sines(n: int, dt: float, top: float, rng: np.random.Generator) -> Array:
    """Three to five sines (n,) of random frequency and phase, scaled into [-1, 1]."""
    time, count = np.arange(n) * dt, int(rng.integers(3, 6))
    frequencies = top * np.exp(rng.uniform(np.log(0.08), 0, count))
    phases, weights = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.3, 1, count)
    wave = (weights[:, None] * np.sin(2 * np.pi * frequencies[:, None] * time + phases[:, None])).sum(0)
    return wave / np.abs(wave).max()


def steps(n: int, dt: float, top: float, rng: np.random.Generator) -> Array:
    """Random levels (n,) in [-1, 1], each held between half a period and three of the highest frequency."""
    wave, at = np.empty(n), 0
    while at < n:
        hold = max(int(rng.uniform(0.5, 3) / (top * dt)), 1)
        wave[at : at + hold] = rng.uniform(-1, 1)
        at += hold
    return wave


def noise(n: int, dt: float, top: float, rng: np.random.Generator) -> Array:
    """White noise through two low passes at `top` [Hz], (n,), scaled into [-1, 1]."""
    keep = np.exp(-2 * np.pi * top * dt)
    wave = rng.normal(size=n + 200)
    for _ in range(2):
        for i in range(1, len(wave)):
            wave[i] = keep * wave[i - 1] + (1 - keep) * wave[i]
    wave = wave[200:] - wave[200:].mean()
    return wave / np.abs(wave).max()


SIGNALS = (chirp, sines, steps, noise)


def controller(robot: Robot, low: Array, high: Array, n: int, rng: np.random.Generator) -> Controller:
    """The command of one episode.

    Args:
        robot: the robot.
        low: least command, (nu,).
        high: greatest command, (nu,).
        n: rows of the episode.
        rng: randomness of the motion.

    Returns:
        A function that gives the command of each row, within the bounds.
    """
    signal = SIGNALS[int(rng.integers(len(SIGNALS)))]
    nu = len(robot.reach)
    top = robot.frequency * rng.uniform(0.5, 1)
    wave = np.stack([signal(n, robot.control_dt, top * rng.uniform(0.6, 1), rng) for _ in range(nu)], 1)
    wave *= rng.uniform(0.4, 1) * rng.uniform(0.6, 1, nu)
    base = np.asarray(robot.base_command or (0.0,) * nu)
    if robot.kp and (not robot.open_torque or rng.random() < 0.6):
        return _tracking(robot, low, high, wave)
    plan = np.clip(base + wave * np.asarray(robot.open_torque or robot.reach), low, high)
    return lambda row, qpos, qvel: plan[row]


def _tracking(robot: Robot, low: Array, high: Array, wave: Array) -> Controller:
    """Track the reference with the measured state: the commands answer to the fault."""
    kp, kd = np.asarray(robot.kp), np.asarray(robot.kd)
    plan = np.asarray(robot.home)[list(robot.driven)] + wave * np.asarray(robot.reach)
    driven = list(robot.driven)

    def command(row: int, qpos: Array, qvel: Array) -> Array:
        return np.clip(kp * (plan[row] - qpos[driven]) - kd * qvel[driven], low, high)

    return command
