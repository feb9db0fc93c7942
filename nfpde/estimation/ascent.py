"""The learning of one iteration: Adam on Eq. 8, no farther than the samples can tell."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from nfpde.flow import Flow

TRUST = 0.3
"""Divergence [nats] of the flow from the one that was sampled, at which the steps of an iteration end.

The samples of an iteration tell the gradient only while the flow has its mass among them; once it is elsewhere all
ratios are near 0, the gradient vanishes, and Adam's momentum carries the flow on. Of a Gaussian 0.3 nats are three
quarters of a standard deviation of its mean, or a width of two thirds: the ratios of most samples are of order one.
"""

HALVINGS = 40
"""Of the last step at most: then it is a trillionth of itself, and only weights beyond all reason want less."""


def surrogate(ratio: Tensor, weight: Tensor, clip: float) -> Tensor:
    """Eq. 8 on M samples: the sum of ratio x weight, pessimistically clipped as in PPO (Schulman et al., 2017).

    A constant added to all weights does not change Eq. 8, as E_old[p_theta / p_old] = 1, but the finite sum: weights
    should have a mean of zero. Equal negative ones, which tell nothing, would be gained by a flow that leaves its
    samples.

    Args:
        ratio: p_theta(xi) / p_old(xi) of every sample, (M,).
        weight: log p(o | xi) of every sample in the sense of Eq. 10, averaged over transitions, (M,).
        clip: c of min(ratio x weight, clamp(ratio, 1 - c, 1 + c) x weight); 0 takes the plain ratio.
    """
    gain = ratio * weight
    if clip > 0:
        gain = torch.minimum(gain, ratio.clamp(1 - clip, 1 + clip) * weight)
    return gain.sum()


def responsibility(log_ratio: Tensor, weight: Tensor) -> Tensor:
    """Eq. 8 with Eq. 11 as the M-step of expectation-maximisation: the sum of weight x log p_theta, up to a constant.

    At p_old it has the gradient of Eq. 8. Farther on the ratio itself would be gained by any flow that narrows around
    its samples, equal weights or not; a likelihood is gained by a flow that has its mass where the weights are. Where
    they are equal, that is where the samples are.

    Args:
        log_ratio: log(p_theta / p_old) of every sample, (M,).
        weight: of every sample, averaged over transitions, of sum 1, (M,).
    """
    return (weight * log_ratio).sum()


def divergence(log_ratio: Tensor) -> float:
    """KL(p_old || p_theta) [nats] from log(p_theta / p_old) at samples of p_old (M,): the mean of r - 1 - log r.

    E_old[r] = 1 makes it -E_old[log r] with less scatter, and no sample makes it negative.
    """
    with torch.no_grad():
        return float((torch.expm1(log_ratio) - log_ratio).mean())


def ascend(
    flow: Flow, optimizer: torch.optim.Optimizer, z: Tensor, gain: Callable[[Tensor], Tensor], steps: int
) -> bool:
    """Gradient steps that end where the flow would leave what its samples tell.

    The step after which `divergence` exceeds `TRUST` is the last, and is halved until it no longer does (the line
    search of Schulman et al., Trust Region Policy Optimization, ICML 2015).

    Args:
        flow: p_theta, changed in place; at the start it is p_old.
        optimizer: of its weights.
        z: samples of p_old, (M, D).
        gain: what is ascended, of log(p_theta / p_old) at the samples, (M,).
        steps: at most.

    Returns:
        Whether the flow is sound: False where no part of a step kept it near its samples.
    """
    weights = [p for group in optimizer.param_groups for p in group["params"]]
    log_density = flow.log_prob(z)
    old = log_density.detach()
    for _ in range(steps):
        before = [p.detach().clone() for p in weights]
        optimizer.zero_grad()
        (-gain(log_density - old)).backward()
        optimizer.step()
        log_density = flow.log_prob(z)
        if not divergence(log_density - old) <= TRUST:
            return _shortened(flow, weights, before, z, old)
    return True


@torch.no_grad()
def _shortened(flow: Flow, weights: list[Tensor], before: list[Tensor], z: Tensor, old: Tensor) -> bool:
    for _ in range(HALVINGS):
        for now, then in zip(weights, before, strict=True):
            now.lerp_(then, 0.5)
        if divergence(flow.log_prob(z) - old) <= TRUST:
            return True
    return False
