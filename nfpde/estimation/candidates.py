"""The paper's two candidates for log p(o | xi), and the temperature of the first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cai(losses: Array) -> Array:
    """Eq. 10 (control as inference): log p(o_i | xi_j) = -l_ij; losses (M, N) to (M, N).

    It follows the lower bound of Eq. 6, whose maximiser is a single point: kept for comparison.
    """
    return -losses


def softmax(losses: Array, beta: float) -> Array:
    """Eq. 11: exp(-l_ij / beta), normalised over the M samples; losses (M, N) to weights (M, N).

    The weights are the responsibilities of the samples for a transition, so that ascending Eq. 8 is a step of
    stochastic expectation-maximisation on the marginal likelihood, Eq. 5.
    """
    with np.errstate(over="ignore"):  # a large loss over a tiny beta: the weight is 0
        weights = np.exp(-(losses - losses.min(0)) / beta)
    return weights / weights.sum(0)


def effective_samples(weights: Array) -> Array:
    """Effective sample size of normalised weights (M, N) for every transition, (N,)."""
    return 1.0 / (weights**2).sum(0)


def next_beta(losses: Array, beta: float | None, channels: int, least_effective: float) -> float:
    """The temperature that the data ask for.

    exp(-l / beta) is a Gaussian likelihood with variance beta / 2 in each channel, and the maximisation step of EM
    for that variance is the responsibility-weighted mean squared error: beta = 2 E[l] / channels. It starts at the
    mean over all samples and shrinks as the samples come to explain the transitions. Where one sample explains a
    transition much better than all others it would not stop before that one had all the weight, so it is raised
    until half of the transitions have `least_effective` effective samples.

    Args:
        losses: of this batch, (M, N).
        beta: the last temperature; None for the first batch.
        channels: numbers compared in one loss.
        least_effective: the floor of the median effective sample size.

    Returns:
        The next temperature, positive.
    """
    weights = np.full_like(losses, 1.0 / len(losses)) if beta is None else softmax(losses, beta)
    proposal = 2.0 * float((weights * losses).sum(0).mean()) / channels
    lowest = np.finfo(float).tiny * 1e10
    proposal = max(proposal, lowest)
    if np.median(effective_samples(softmax(losses, proposal))) >= least_effective:
        return proposal
    low, high = np.log(proposal), np.log(max(float(losses.max()) * len(losses), proposal))
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        enough = np.median(effective_samples(softmax(losses, float(np.exp(middle))))) >= least_effective
        low, high = (low, middle) if enough else (middle, high)
    return float(np.exp(high))
