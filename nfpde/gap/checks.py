"""Recordings that cannot answer, or do not fit the model: wrong signs, order, units or rows, or nothing that moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from nfpde.dataset import Dataset, Windows
from nfpde.elements import element_names
from nfpde.errors import BadDataset, SimulationDiverged
from nfpde.gap.foresight import check_commands
from nfpde.gap.frames import check_frames
from nfpde.gap.mistakes import (
    Joint,
    Mistake,
    flips_and_swaps,
    in_degrees,
    in_other_units,
    joints_of,
    with_commands,
    with_other_zeros,
)
from nfpde.gap.outliers import check_spikes, check_wraps
from nfpde.gap.overlap import always_touching, bodies_of, without_contacts
from nfpde.gap.readings import CURED, Readings, check_columns
from nfpde.gap.recordings import Recordings
from nfpde.gap.replay import Replay

Array = NDArray[np.float64]
_Trial = tuple[float, str, Callable[[Windows], Windows]]
"""Error of the nominal model with a mistake undone, the mistake in words, and what undoes it."""

_WINDOWS, _FEW, _GO_ON, _LOOKS, _FEWEST = 60, 4, 40, 20_000, 5
"""Windows that are looked at. Of more mistakes than `_GO_ON`, one of so many windows tells which go on to all; fewer
still where that were more than so many looks, but for the fewest that tell anything."""

_DIVERGED = 1e6
"""Error of a window whose simulation diverges."""

_FITS = 0.01
"""A model whose error is below this share of the motion has the right signs and order: one wrong joint of forty would
make more."""

_MOST_SHIFT, _SHIFTS, _CLOSER = 1.5, 12, 20
"""Largest other zero tried, in what a change makes of a column in the mean; how many are, and how many near it."""

_PAIRS = 100
"""Pairs of geoms that overlap in every pose and are looked at."""

_LOOK = 1.0
"""How long the model may take to move a joint whose readings never change [s]."""


def check_readings(model: mujoco.MjModel, dataset: Dataset) -> None:
    """Refuse recordings that contradict themselves, whatever the model's numbers are.

    Args:
        model: Says which columns belong to which joint.
        dataset: Recordings in the model's order.

    Raises:
        BadDataset: Quaternions and velocities in another convention, angles that were wrapped, speeds that are not the
            changes of their positions, spikes: where, and what to do.
    """
    check_frames(model, dataset)
    readings = Readings.of(model, dataset)
    if readings.axes:
        check_wraps(readings)
        check_columns(readings)
        check_spikes(readings)


def check_fit(replay: Replay, dataset: Dataset, recordings: Recordings, xi: Array) -> None:
    """Refuse recordings that were written down in another way than the model takes them, or in which nothing moves.

    Args:
        replay: The nominal model.
        dataset: The recordings.
        recordings: The same in windows.
        xi: Nominal free parameters (D,).

    Raises:
        BadDataset: What looks wrong, and what to do.
        SimulationDiverged: Its simulation diverges.
    """
    windows = _some(recordings.fit)
    model = replay.sim.model
    joints = joints_of(model)
    if not _moves(windows):
        seldom = any(np.ptp(e.qpos, axis=0).any() or np.ptp(e.qvel, axis=0).any() for e in dataset)
        raise BadDataset(
            "nothing moves in nearly all of these recordings: cut away where the robot rests"
            if seldom
            else "nothing moves in these recordings, so no gap can be told from no gap: record the robot moving, every "
            "joint through a good part of its range, at several speeds"
        )
    _check_encoders(replay, dataset, xi)
    error = _error(replay, xi, windows)
    if error >= _DIVERGED:
        trials = _degrees(replay, xi, windows, joints, error)
        _refuse_best(replay, xi, windows, trials, error, CURED)
        raise SimulationDiverged(
            "the nominal model's simulation diverges from most recorded states within "
            f"{windows.horizon * windows.control_dt:.3g} s, so it predicts nothing: halve its timestep "
            f"({replay.sim.model.opt.timestep:g} s), try another integrator (implicitfast), and look for springs that "
            "push, gains too high, and tiny masses; recordings must be in rad and m"
        )
    _check_contacts(replay, xi, windows, error)
    check_commands(replay, dataset, xi)
    if error < _FITS:
        return
    trials = _tried(replay, xi, windows, flips_and_swaps(joints)) + _units(replay, xi, windows, error)
    trials += _degrees(replay, xi, windows, joints, error)
    _refuse_best(replay, xi, windows, trials, error, CURED * error)


def _moves(windows: Windows) -> bool:
    """Whether anything moves in any of the windows."""
    return bool((windows.state != windows.state[:, :1]).any())


def _tried(replay: Replay, xi: Array, windows: Windows, mistakes: list[Mistake]) -> list[_Trial]:
    """Errors with each mistake undone; of many only of those that look best on a few of the windows."""
    if len(mistakes) > _GO_ON:
        every = max(_FEW, -(-len(mistakes) * len(windows) // _LOOKS))
        few = windows[:: max(1, min(every, len(windows) // _FEWEST))]
        first = np.argsort([_error(replay, xi, undo(few)) for _, undo in mistakes], kind="stable")[:_GO_ON]
        mistakes = [mistakes[i] for i in np.sort(first)]
    return [(_error(replay, xi, undo(windows)), text, undo) for text, undo in mistakes]


def _refuse_best(replay: Replay, xi: Array, windows: Windows, trials: list[_Trial], error: float, below: float) -> None:
    """Refuse what comes nearest to the model after a change, where that brings the error below a bound.

    What another zero of the same columns does as well is no mistake in writing: a joint that rests beside its zero, and
    its reading with the other sign, differ by a constant, which may be an encoder's offset or where the floor lies.
    """
    for best, text, undo in sorted(trials, key=lambda trial: trial[:2]):
        if best >= below:
            return
        if best < CURED * _error_of_zeros(replay, xi, windows, undo(windows), best):
            raise BadDataset(
                f"the recordings do not fit the model: {text} (the nominal model's error is {error:.2g} times the "
                f"motion as recorded, {best:.2g} times so changed). Correct the recordings or the model; the model has "
                f"the joints {', '.join(element_names(replay.sim.model, 'joint'))}"
            )


def _error_of_zeros(replay: Replay, xi: Array, windows: Windows, changed: Windows, best: float) -> float:
    """The least error with other zeros of the columns that a change moves, or one that is as good as the change's.

    A joint that rests on a floor, rocks and hops a little is not off by what it is in the mean.
    """

    def error(share: float) -> float:
        return _error(replay, xi, with_other_zeros(windows, changed, share))

    step = _MOST_SHIFT / _SHIFTS
    errors = {share: error(share) for share in step * np.arange(1, _SHIFTS + 1)}
    near = min(errors, key=lambda share: errors[share])
    if CURED * errors[near] <= best:
        return errors[near]
    closer: Any = minimize_scalar(
        error, bounds=(near - step, near + step), method="bounded", options={"maxiter": _CLOSER}
    )
    return min(errors[near], float(closer.fun))


def _degrees(replay: Replay, xi: Array, windows: Windows, joints: list[Joint], error: float) -> list[_Trial]:
    """Errors with every hinge in degrees, with each alone, and with those together that are better off alone."""
    hinges = [j for j in joints if j.turns]
    if not hinges:
        return []
    single = [_tried(replay, xi, windows, in_degrees([j])) for j in hinges]
    better = [j for j, tried in zip(hinges, single, strict=True) if min(t[0] for t in tried) < error]
    groups = [g for g in (hinges, better) if len(g) > 1]
    together = [trial for g in groups for trial in _tried(replay, xi, windows, in_degrees(g))]
    return [*(trial for tried in single for trial in tried), *together]


def _units(replay: Replay, xi: Array, windows: Windows, error: float) -> list[_Trial]:
    """Errors with the commands in other units, where commands matter: one hundredth is next to none."""
    tried = _tried(replay, xi, windows, in_other_units()) if windows.nu else []
    if not tried or min(t[0] for t in tried) >= CURED * error:
        return []
    return tried if min(t[0] for t in tried) < CURED * _error(replay, xi, with_commands(windows, 0.0)) else []


def _check_encoders(replay: Replay, dataset: Dataset, xi: Array) -> None:
    """A joint whose readings never change, while the model moves it, has a dead encoder or cannot move."""
    model = replay.sim.model
    still = Readings.of(model, dataset).never_changing()
    if not still:
        return
    longest = max(len(e) for e in dataset) - 1
    dt, sim = dataset.control_dt, replay.sim
    steps = min(longest, max(1, round(_LOOK / dt)))
    windows = _some(dataset.windows(steps, history=sim.history_steps(dt), past=sim.past_steps(dt)))
    predicted = replay.predict(xi[None], windows)[0]
    for axis in still:
        least = np.pi / 180 * (1.0 if axis.turns else float(model.stat.extent))
        moves = np.abs(predicted[:, :, axis.q] - windows.state[:, :1, axis.q])
        moves = np.nan_to_num(moves, nan=0.0).max(1)
        unit = "rad" if axis.turns else "m"
        if np.median(moves) > least:
            raise BadDataset(
                f"{axis.name}: its readings never change, qpos {windows.state[0, 0, axis.q]:.4g} {unit} and qvel "
                f"{windows.state[0, 0, windows.nq + axis.v]:.4g} {unit}/s in every row, while the model moves it by "
                f"{np.median(moves):.2g} {unit} within {windows.horizon * windows.control_dt:.3g} s: a dead encoder, "
                f"or a joint that is locked. Repair the recordings, or weld the joint in the model (remove it, so that "
                f"its body is fixed to its parent, and its columns)"
            )


def _check_contacts(replay: Replay, xi: Array, windows: Windows, error: float) -> None:
    """Geoms that overlap in every recorded pose, and push the model where the robot was not, shall not collide."""
    model = replay.sim.model
    pairs = always_touching(model, windows.state[:, 0, : model.nq])

    def apart_from(pairs: Sequence[tuple[int, int]]) -> float:
        nthread = getattr(replay.sim, "nthread", 0)
        return _error(Replay(without_contacts(model, pairs), replay.space, [], nthread=nthread), xi, windows)

    # what a robot stands on touches it in every pose, too: without that the model is farther off, not nearer
    pairs = [pair for pair in pairs[:_PAIRS] if apart_from([pair]) < error]
    if not pairs:
        return
    apart = apart_from(pairs)
    if apart < CURED * error:
        raise BadDataset(
            f"the recordings do not fit the model: in every recorded pose its geoms overlap, and their contact drives "
            f"it away (the nominal model's error is {error:.2g} times the motion, {apart:.2g} times without these "
            f"contacts): {bodies_of(model, pairs)}. Exclude the contacts (<exclude body1= body2=> in <contact>; MuJoCo "
            f"ignores contacts of parent and child, but not with a parent that is fixed to the world), or correct the "
            f"zeros of the joints"
        )


def _error(replay: Replay, xi: Array, windows: Windows) -> float:
    """Median over windows of the squared error at the end, in units of the motion's spread."""
    states = replay.sim.states
    predicted = replay.predict(xi[None], windows)[0][:, -1]
    moved = states.difference(windows.target[:, -1], windows.state[:, 0])
    error = states.difference(predicted, windows.target[:, -1])
    ratio = error / _spread_of_motion(moved)
    return float(np.median(np.nan_to_num((ratio**2).mean(1), nan=_DIVERGED)))


def _spread_of_motion(moved: Array) -> Array:
    spread = np.sqrt((moved**2).mean(0))
    return np.maximum(spread, 1e-3 * spread.max(initial=0.0) + 1e-12)


def _some(windows: Windows) -> Windows:
    """A few windows from all over the recordings."""
    return windows[np.unique(np.linspace(0, len(windows) - 1, _WINDOWS).astype(int))]
