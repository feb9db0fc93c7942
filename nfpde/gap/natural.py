"""Recordings as a model would have made them: states that it goes through by itself, then the noise of the sensors.

A state that noise has moved is none that a robot is in: a foot that is measured inside the floor is thrown out of it.
What a model does from there is not what noise is added to in recordings.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.grain import Encoders
from nfpde.gap.recordings import WINDOW_TIME
from nfpde.gap.replay import Replay
from nfpde.sim.simulator import steps_back
from nfpde.sim.states import StateSpace

Array = NDArray[np.float64]


def natural(replay: Replay, xi: Array, windows: Windows) -> Windows:
    """The windows as a model goes through them, begun a longest window's time earlier where as much is recorded.

    By then it has forgotten how its start was measured: what was pressed has settled, what was lifted has landed. The
    rows between, as far as they are the windows' past, are the model's too. Where it diverges, and in what is left of
    an episode's beginning, everything stays as it was recorded.

    Args:
        replay: The model.
        xi: Its free parameters (D,).
        windows: Of recordings.
    """
    spare = windows.nhistory - steps_back(replay.sim.memory_time, windows.control_dt)
    rows = min(round(WINDOW_TIME / windows.control_dt), windows.past.shape[1], spare)
    known = np.all(np.isfinite(windows.past[:, windows.past.shape[1] - max(rows, 0) :]), axis=2)
    back = known[:, ::-1].cumprod(1).sum(1)
    past, state = windows.past.copy(), windows.state.copy()
    for count in np.unique(back):
        some = np.flatnonzero(back == count)
        there = replay.predict(xi[None], begun_earlier(windows[some], int(count)))[0]
        sound = np.isfinite(there).all((1, 2))
        some, there = some[sound], there[sound]
        state[some, 1:] = there[:, count:]
        if count:
            state[some, 0] = there[:, count - 1]
            past[some, past.shape[1] - count + 1 :] = there[:, : count - 1]
    return replace(windows, state=state, past=past)


def begun_earlier(windows: Windows, rows: int) -> Windows:
    """Windows that begin so many control steps earlier, and end where they did.

    Args:
        windows: With as many rows of their past and commands from before their start.
        rows: Control steps.
    """
    if not rows:
        return windows
    known, before = windows.past.shape[1] - rows, windows.nhistory - rows
    return replace(
        windows,
        state=np.concatenate([windows.past[:, known:], windows.state], axis=1),
        ctrl=np.concatenate([windows.history[:, before:], windows.ctrl], axis=1),
        history=windows.history[:, :before],
        past=windows.past[:, :known],
        row=windows.row - rows,
    )


def measured(
    replay: Replay, truth: Windows, sigma: Array, recorded: Windows, encoders: Encoders, rng: np.random.Generator
) -> Windows:
    """Windows as the sensors would have recorded them, in all states, those of their past too.

    What encoders round is rounded, not blurred: at rest it errs by the same in every row, but for those in which the
    recordings show the next step. Velocities that nobody measured are computed from what positions read, as far as the
    rows around are there.

    Args:
        replay: The model.
        truth: What it goes through.
        sigma: Noise of the sensors, rounding included (2 nv,).
        recorded: Windows of the recordings, that show where the steps of encoders lie.
        encoders: Of the recordings.
        rng: Draws.
    """
    model = replay.sim.model
    grain, resting = encoders.grain(model), encoders.resting(model)
    states = np.concatenate([truth.past, truth.state], axis=1)
    known = np.all(np.isfinite(states), axis=2)
    own = np.sqrt(np.maximum(sigma**2 - grain**2 / 12.0, 0.0))
    own[: model.nv][resting & (grain[: model.nv] > 0)] = 0.0
    noise = own * rng.normal(size=(*states.shape[:2], len(sigma)))
    states[known] = replay.sim.states.moved(states[known], noise[known])
    for channel in np.flatnonzero(grain):
        joint = int(model.dof_jntid[channel % model.nv])
        column = int(model.jnt_qposadr[joint]) if channel < model.nv else model.nq + channel - model.nv
        step, zero = grain[channel], recorded.state[0, 0, column]
        read = zero + step * np.round((states[..., column] - zero) / step)
        if channel < model.nv and resting[channel]:
            up, down = encoders.flips[:, column]
            chance, rests = rng.random(read.shape), np.abs(read - encoders.rest[column]) < 0.5 * step
            read = read + step * (rests & (chance < up)) - step * (rests & (chance >= 1.0 - down))
        states[..., column] = read
    if encoders.computed is not None:
        _compute_velocities(states, replay.sim.states, encoders.computed / truth.control_dt)
    rows = truth.past.shape[1]
    return replace(truth, past=states[:, :rows], state=states[:, rows:])


def _compute_velocities(states: Array, space: StateSpace, weights: Array) -> None:
    """Velocities of all rows but the first and last of windows (N, R, nq+nv), from their positions.

    Args:
        states: What is changed.
        space: Of them.
        weights: What velocities take of the positions in the row before, the same and the next (nv, 3) [1/s]; zeros
            leave them as they are.
    """
    nv = len(weights)
    # weights sum to zero: a weighted sum of three positions is one of the two changes between them
    steps = space.difference(states[:, 1:], states[:, :-1])[..., :nv]
    velocity = steps[:, 1:] * weights[:, 2] - steps[:, :-1] * weights[:, 0]
    own = states[:, 1:-1, states.shape[2] - nv :]
    own[:] = np.where(weights.any(1) & np.isfinite(velocity), velocity, own)
