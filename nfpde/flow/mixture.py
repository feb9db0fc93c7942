"""Mixtures of Gaussians over the unconstrained parameters."""

import math
from typing import Any

import torch
from torch import Tensor, nn

from nfpde.errors import BadInput


class GaussianMixture(nn.Module):
    """A weighted mixture of K Gaussians over z in R^D, in float64; what a set of local posteriors is.

    Its tensors are buffers: fixed numbers that are saved, not trained.

    Args:
        weights: (K,), non-negative, with a positive sum; scaled to one.
        means: (K, D).
        covariances: (K, D, D), symmetric and positive definite.

    Raises:
        BadInput: Shapes that do not fit, a number that is not finite, negative weights or a covariance that is not
            positive definite; the text names the component.

    Example:
        >>> mixture = GaussianMixture(torch.ones(1), torch.zeros(1, 2), torch.eye(2)[None])
        >>> round(mixture.log_prob(torch.zeros(2, dtype=torch.float64)).exp().item(), 4)
        0.1592
    """

    log_weights: Tensor
    means: Tensor
    scale_tril: Tensor

    def __init__(self, weights: Tensor, means: Tensor, covariances: Tensor) -> None:
        super().__init__()
        weights, means, covariances = (
            torch.as_tensor(t, dtype=torch.float64).detach() for t in (weights, means, covariances)
        )
        _check_mixture(weights, means, covariances)
        scale_tril, failed = torch.linalg.cholesky_ex(covariances)
        if failed.any():
            k = int(failed.nonzero()[0])
            smallest = float(torch.linalg.eigvalsh(covariances[k])[0])
            raise BadInput(
                f"covariances[{k}] is not positive definite (smallest eigenvalue {smallest:g}); every direction needs "
                "some width"
            )
        self.register_buffer("log_weights", torch.log(weights / weights.sum()))
        self.register_buffer("means", means.clone())
        self.register_buffer("scale_tril", scale_tril)

    @property
    def features(self) -> int:
        """D, the number of parameters."""
        return self.means.shape[1]

    @property
    def components(self) -> int:
        """K, the number of Gaussians."""
        return self.means.shape[0]

    def log_prob(self, z: Tensor) -> Tensor:
        """Log density [nats] of z (..., D), shape (...)."""
        flat = z.reshape(-1, self.features)
        # (K, D, n): one triangular solve for each component
        white = torch.linalg.solve_triangular(self.scale_tril, (flat[None] - self.means[:, None]).mT, upper=False)
        log_det = torch.diagonal(self.scale_tril, dim1=-2, dim2=-1).log().sum(-1)
        constant = self.log_weights - log_det - 0.5 * self.features * math.log(2.0 * math.pi)
        return torch.logsumexp(constant[:, None] - 0.5 * (white**2).sum(1), 0).reshape(z.shape[:-1])

    @torch.no_grad()
    def sample(self, n: int, generator: torch.Generator) -> Tensor:
        """Draw n points (n, D) without gradient; only `generator` is used up.

        The draw is stratified: every component gets its share of the n points to within one, in random order.
        """
        device = generator.device
        ends = torch.cumsum(self.log_weights.exp(), 0).to(device)
        offset = torch.rand(1, generator=generator, dtype=torch.float64, device=device)
        order = torch.randperm(n, generator=generator, device=device)
        uniform = (order + offset) / n * ends[-1]
        k = torch.searchsorted(ends, uniform, right=True).clamp_max(self.components - 1).to(self.means.device)
        noise = torch.randn(n, self.features, generator=generator, dtype=torch.float64, device=device)
        z, noise = self.means[k], noise.to(self.means.device)
        for component, factor in enumerate(self.scale_tril):
            rows = k == component
            z[rows] += noise[rows] @ factor.mT
        return z

    def config(self) -> dict[str, Any]:
        """Kind and sizes as JSON; `make_density` builds a mixture of the same shape from it."""
        return {"kind": "gaussian_mixture", "features": self.features, "components": self.components}


def _check_mixture(weights: Tensor, means: Tensor, covariances: Tensor) -> None:
    if weights.ndim != 1 or means.ndim != 2 or not len(weights) or not means.shape[1]:
        raise BadInput(f"weights must be (K,) and means (K, D), got {tuple(weights.shape)} and {tuple(means.shape)}")
    k, d = means.shape
    if len(weights) != k or covariances.shape != (k, d, d):
        raise BadInput(
            f"weights {tuple(weights.shape)} and covariances {tuple(covariances.shape)} do not fit means {(k, d)}: "
            f"they must be {(k,)} and {(k, d, d)}"
        )
    for name, values in (("weights", weights), ("means", means), ("covariances", covariances)):
        bad = ~torch.isfinite(values)
        if bad.any():
            raise BadInput(f"{name}[{int(bad.nonzero()[0, 0])}] holds a number that is not finite")
    if (weights < 0).any() or weights.sum() <= 0:
        raise BadInput(f"weights must be non-negative with a positive sum, got {weights.tolist()}")
    skew = (covariances - covariances.mT).abs().amax((1, 2)) > 1e-8 * covariances.abs().amax((1, 2))
    if skew.any():
        raise BadInput(f"covariances[{int(skew.nonzero()[0])}] is not symmetric")
