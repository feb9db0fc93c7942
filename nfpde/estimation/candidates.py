"""The paper's two candidates for log p(o | xi), and the temperature of the first; on the device that has the losses."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from nfpde.sim import LOSS_LIMIT


def cai(losses: Tensor) -> Tensor:
    """Eq. 10 (control as inference): log p(o_i | xi_j) = -l_ij; losses (M, N) to (M, N).

    It follows the lower bound of Eq. 6, whose maximiser is a single point: kept for comparison. A sample that diverged
    counts as the worst of its transition that did not: `LOSS_LIMIT` is no size of an error, and Adam, which goes by the
    size of earlier gradients, would hardly move again after one.
    """
    fine = losses < LOSS_LIMIT
    worst = torch.where(fine, losses, 0.0).amax(0)
    return -torch.where(fine, losses, worst)


def softmax(losses: Tensor, beta: float) -> Tensor:
    """Eq. 11: exp(-l_ij / beta), normalised over the M samples; losses (M, N) to weights (M, N).

    The weights are the responsibilities of the samples for a transition, so that ascending Eq. 8 is a step of
    stochastic expectation-maximisation on the marginal likelihood, Eq. 5. A sample that diverged has the weight 0, as
    `LOSS_LIMIT` is no size of an error, and so has every sample of a transition of which all diverged.
    """
    fine = losses < LOSS_LIMIT
    weights = torch.exp(-(losses - losses.amin(0)) / beta) * fine
    return weights / weights.sum(0).clamp_min(torch.finfo(weights.dtype).tiny)


def sound(losses: Tensor) -> Tensor:
    """Transitions of which some sample did not diverge: only these tell anything; losses (M, N) to (N,)."""
    return (losses < LOSS_LIMIT).any(0)


def effective_samples(weights: Tensor) -> Tensor:
    """Effective sample size of normalised weights (M, N) for every transition, (N,)."""
    return 1.0 / (weights**2).sum(0)


def typical_effective(weights: Tensor) -> float:
    """The median over transitions of their effective samples, of normalised weights (M, N)."""
    return float(effective_samples(weights).quantile(0.5))


def next_beta(losses: Tensor, beta: float | None, channels: int, least_effective: float) -> float:
    """The temperature that the data ask for.

    exp(-l / beta) is a Gaussian likelihood with variance beta / 2 in each channel, and the maximisation step of EM
    for that variance is the responsibility-weighted mean squared error: beta = 2 E[l] / channels. It starts at the
    mean over all samples and shrinks as the samples come to explain the transitions. Where one sample explains a
    transition much better than all others it would not stop before that one had all the weight, so it is raised
    until half of the transitions have `least_effective` effective samples.

    Args:
        losses: of this batch, (M, N); of every transition one at least below `LOSS_LIMIT`.
        beta: the last temperature; None for the first batch.
        channels: numbers compared in one loss.
        least_effective: the floor of the median effective sample size.

    Returns:
        The next temperature, positive.
    """
    # a temperature without end takes all samples for equal, but for those that diverged
    weights = softmax(losses, math.inf if beta is None else beta)
    proposal = 2.0 * float((weights * losses).sum(0).mean()) / channels
    lowest = torch.finfo(torch.float64).tiny * 1e10
    proposal = max(proposal, lowest)
    # no temperature gives weight to samples that diverged
    least_effective = min(least_effective, float((losses < LOSS_LIMIT).sum(0).double().quantile(0.5)))
    if typical_effective(softmax(losses, proposal)) >= least_effective:
        return proposal
    low, high = math.log(proposal), math.log(max(float(losses[losses < LOSS_LIMIT].max()) * len(losses), proposal))
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        enough = typical_effective(softmax(losses, math.exp(middle))) >= least_effective
        low, high = (low, middle) if enough else (middle, high)
    return math.exp(high)
