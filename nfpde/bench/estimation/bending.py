"""How far a robot's motion is from linear within the noise of its states: where the bounds are out of reach."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.bench.estimation.bound import information, parameter_slopes, standard_errors, state_slopes
from nfpde.benchmarks.sensing import channel_spread
from nfpde.dataset import Dataset
from nfpde.sim import MujocoSimulator
from nfpde.truth import Truth

Array = NDArray[np.float64]

KNOWN = 0.1
"""Error of a state that is known far better than it was measured, in standard deviations of the noise."""


@dataclass(frozen=True, eq=False)
class Bending:
    """What a linear prediction from states that are off by `KNOWN` of their noise is wrong by.

    error: root mean square in standard deviations of the noise, of the median channel
    often: share of the transitions in which some channel is wrong by more than a standard deviation of the noise
    whole: the bound of whole episodes with that error counted as noise, in widths       (E, D)
    """

    error: float
    often: float
    whole: Array


def bending(simulator: MujocoSimulator, dataset: Dataset, truth: Truth, sigma: Array, seed: int) -> Bending:
    """The bound of whole episodes (see `information_bound`) is one of small noise: how small it would have to be.

    A contact that opens or closes within the error of a state makes the next state jump. What estimates the states
    linearises somewhere within their error, and is off by what is measured here even at the true parameters.

    Args:
        simulator: of the robot.
        dataset: recordings without noise, one episode for each robot.
        truth: true parameters of the episodes.
        sigma: standard deviation of the noise on every channel, (ndiff,), not all zero.
        seed: of the errors.
    """
    windows, states = dataset.transitions(), simulator.states
    members = [np.flatnonzero(windows.episode == e) for e in range(len(dataset))]
    every = np.arange(len(windows))
    error = KNOWN * sigma * np.random.default_rng(seed).standard_normal((len(windows), len(sigma)))
    state = windows.state.copy()
    state[:, 0] = states.moved(windows.start, error)
    moved = replace(windows, state=state)
    spread = channel_spread(states, dataset)
    there = state_slopes(simulator, moved, truth.xi, spread)
    ends = [simulator.rollout(truth.xi, w, w.episode, every)[:, 0] for w in (moved, windows)]
    wrong = states.difference(*ends) - np.einsum("ncd,nd->nc", there, error)
    scale = np.where(sigma > 0, sigma, np.inf)
    by_parameter = parameter_slopes(simulator, windows, truth.xi)
    by_state = state_slopes(simulator, windows, truth.xi, spread)
    process = np.diag((wrong**2).mean(0))
    whole = [
        standard_errors(information(by_parameter[m], by_state[m], sigma, joint=True, process=process)) for m in members
    ]
    sizes = np.sqrt((wrong**2).mean(0))[sigma > 0] / sigma[sigma > 0]
    return Bending(float(np.median(sizes)), float(((np.abs(wrong) / scale).max(1) > 1).mean()), np.array(whole))


def in_words(found: dict[str, Any] | None, whole: Array) -> list[str]:
    """What `bending` found, for the reason of a failure; `whole` is the bound of whole episodes (E, D), in widths."""
    if found is None:
        return []
    wider = float(np.sqrt((np.array(found["whole"]) ** 2).mean() / (whole**2).mean()))
    return [
        f"the bound of whole episodes is one of small noise: from states off by {KNOWN:g} of theirs a linear "
        f"prediction at the true parameters is wrong by {found['error']:.2g} of the noise (median channel), and in "
        f"{found['often']:.1%} of the transitions by more than all of it; with that counted as noise the bound is "
        f"{wider:.2g} x as wide"
    ]
