"""The learning of one iteration: Adam on the surrogate of Eq. 8, no farther than the samples can tell."""

from __future__ import annotations

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

    Args:
        ratio: p_theta(xi) / p_old(xi) of every sample, (M,).
        weight: log p(o | xi) of every sample in the sense of Eq. 10 or 11, averaged over transitions, (M,).
        clip: c of min(ratio x weight, clamp(ratio, 1 - c, 1 + c) x weight); 0 takes the plain ratio.
    """
    gain = ratio * weight
    if clip > 0:
        gain = torch.minimum(gain, ratio.clamp(1 - clip, 1 + clip) * weight)
    return gain.sum()


def divergence(log_ratio: Tensor) -> float:
    """KL(p_old || p_theta) [nats] from log(p_theta / p_old) at samples of p_old (M,): the mean of r - 1 - log r.

    E_old[r] = 1 makes it -E_old[log r] with less scatter, and no sample makes it negative.
    """
    with torch.no_grad():
        return float((torch.expm1(log_ratio) - log_ratio).mean())


def ascend(flow: Flow, optimizer: torch.optim.Optimizer, z: Tensor, weight: Tensor, clip: float, steps: int) -> bool:
    """Gradient steps on the surrogate, that end where the flow would leave what its samples tell.

    The mean weight is taken off all weights first. Eq. 8 does not change by it, as E_old[p_theta / p_old] = 1, but
    its finite sum does: of equal weights, which tell nothing, positive ones would be gained by a flow that narrows
    around its samples, and negative ones by a flow that leaves them.

    The step after which `divergence` exceeds `TRUST` is the last, and is halved until it no longer does (the line
    search of Schulman et al., Trust Region Policy Optimization, ICML 2015).

    Args:
        flow: p_theta, changed in place; at the start it is p_old.
        optimizer: of its weights.
        z: samples of p_old, (M, D).
        weight: of the samples, see `surrogate`, (M,).
        clip: see `surrogate`.
        steps: at most.

    Returns:
        Whether the flow is sound: False where no part of a step kept it near its samples.
    """
    weight = weight - weight.mean()
    weights = [p for group in optimizer.param_groups for p in group["params"]]
    log_density = flow.log_prob(z)
    old = log_density.detach()
    for _ in range(steps):
        before = [p.detach().clone() for p in weights]
        optimizer.zero_grad()
        (-surrogate(torch.exp(log_density - old), weight, clip)).backward()
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
