"""Finding parameters that change nothing: simulate random motion at both of their bounds."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.effects import effect_names
from nfpde.errors import BadParameter
from nfpde.parameters import ParameterSpace
from nfpde.sim.simulator import Array, Simulator

STARTS = 8
"""Random motions each parameter is tried on."""

ROUNDING = 1e-12
"""Differences per physics step below which two simulations count as equal."""

LENGTHS = (5, 100, 1000)
"""Physics steps of the trials; only what changed nothing in a short one goes into the next."""


def refuse_inert(simulator: Simulator, model: mujoco.MjModel) -> None:
    """Raise unless every parameter changes some simulation by more than rounding.

    Of an effect with several parameters one is enough: a tilt of the base about one axis moves no planar robot. All
    other parameters are at random places in their bounds, because one may matter only through another; of several
    models every one is tried, because an element may matter in one of them only.

    Raises:
        BadParameter: naming the parameters without influence.
    """
    rng = np.random.default_rng(0)
    space = simulator.space
    silent = np.arange(len(space))
    ends = np.empty(0)
    for length in LENGTHS:
        windows = random_windows(model, STARTS, length, simulator.history_steps(model.opt.timestep), rng)
        for xi in _of_every_model(simulator, space.uniform(1, rng)):
            base = xi.repeat(2 * len(silent), axis=0)
            base[np.arange(len(silent)), silent] = space.low[silent]
            base[np.arange(len(silent)) + len(silent), silent] = space.high[silent]
            ends = simulator.predict(base, windows)
            low, high = np.split(ends, 2)
            same = np.isclose(low, high, rtol=ROUNDING * length, atol=ROUNDING * length, equal_nan=True)
            silent = silent[same.all(axis=(1, 2, 3))]
            if not len(silent) or not _wholly(space, silent):
                return
    names = ", ".join(f"{p.name} ({p.low:g} against {p.high:g})" for p in (space[i] for i in _wholly(space, silent)))
    if np.isnan(ends).all():
        raise BadParameter(f"{names}: every simulation within the bounds diverges; narrow the bounds")
    raise BadParameter(
        f"{names}: changes nothing in {STARTS} random motions of {LENGTHS[-1]} steps. Typical causes: a contact takes "
        "the larger friction of its two geoms; the element does not move or is overridden by another setting; only "
        "ratios of masses matter where nothing but weight acts. Take the parameter out, or pass check_influence=False "
        "if it matters only in states that random motion does not reach"
    )


def _wholly(space: ParameterSpace, silent: NDArray[np.intp]) -> list[int]:
    """Of parameters without influence those that no other parameter of the same effect excuses."""
    of = [(p.field.partition(".")[0], p.target) for p in space]
    heard = {of[i] for i in range(len(space)) if i not in silent}
    known = effect_names()
    return [int(i) for i in silent if of[i][0] not in known or of[i] not in heard]


def _of_every_model(simulator: Simulator, xi: Array) -> list[Array]:
    """Parameters (1, D) with each of the simulator's models, of which model k holds the values from k up to k + 1."""
    found = [xi]
    for column in simulator.jumps:
        models = np.arange(np.floor(simulator.space.low[column]), np.ceil(simulator.space.high[column]))
        found = [np.where(np.arange(len(simulator.space)) == column, k + 0.5, x) for x in found for k in models]
    return found


def random_windows(model: mujoco.MjModel, n: int, length: int, history: int, rng: np.random.Generator) -> Windows:
    """Windows of random commands from random states near the model's initial one; one physics step per command.

    Only the starts and commands are meaningful: the later states are copies of the start.
    """
    limited = model.actuator_ctrllimited.astype(bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -1.0)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], 1.0)
    velocity = rng.normal(size=(n, model.nv))
    position = np.tile(model.qpos0, (n, 1))
    for row in position:
        mujoco.mj_integratePos(model, row, 0.1 * rng.normal(size=model.nv), 1.0)
    start: Array = np.concatenate([position, velocity], axis=1)
    ctrl = low + (high - low) * rng.random((n, history + length, model.nu))
    return Windows(
        state=start[:, None].repeat(length + 1, axis=1),
        ctrl=ctrl[:, history:],
        history=ctrl[:, :history],
        control_dt=float(model.opt.timestep),
        nq=model.nq,
        nv=model.nv,
        episode=np.zeros(n, np.intp),
        row=np.zeros(n, np.intp),
    )
