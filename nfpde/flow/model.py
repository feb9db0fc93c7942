"""Normalizing flows over the unconstrained parameters; the only file that knows zuko."""

import math
from collections.abc import Callable, Sequence
from operator import index
from typing import Any, Literal, cast, get_args

import numpy as np
import torch
import zuko
from torch import Tensor, nn

from nfpde.errors import BadInput

FlowKind = Literal["realnvp", "nsf", "maf"]
INITIAL_SCALE = math.pi / math.sqrt(3.0)
"""Standard deviation of the standard logistic distribution (1.81).

A uniform xi has a logistic z. The normal distribution closest to that one has this scale, 0.014 nats away, so a
flow that starts with it covers the box almost evenly.
"""
_NETWORK_RANGE = 5.0


class Flow(nn.Module):
    """A normalizing flow p(z) over z in R^D, in float64: u = T((z - loc) / scale) is standard normal.

    T is zuko's; `loc` and `scale` are trained along with it and take over position and size, so that T works on
    numbers of order one (its splines act on [-5, 5] only). At the start T is within about a percent of the identity
    and `scale` is `INITIAL_SCALE`: the parameters then cover their box almost evenly, whatever the seed.
    The inputs of T's networks saturate (softly, at 5), so log densities stay finite and fall about
    quadratically far outside the data.
    A sheared flow divides by a lower triangular matrix in the place of `scale`, whose diagonal `scale` is: it can then
    begin as any Gaussian, its correlations included.

    Use `build_flow` to make one.

    Args:
        features: D.
        kind: `realnvp`, `nsf` or `maf`.
        hidden_features: Widths of the hidden layers of T's networks.
        transforms: Number of coupling or autoregressive layers.
        sheared: Whether there is a matrix in the place of `scale`.
    """

    shear: Tensor | None

    def __init__(
        self, features: int, kind: FlowKind, hidden_features: Sequence[int], transforms: int, sheared: bool = False
    ) -> None:
        super().__init__()
        self.features = features
        self.kind: FlowKind = kind
        self.hidden_features = tuple(hidden_features)
        self.transforms = transforms
        family: Callable[..., zuko.flows.Flow] = {
            "realnvp": zuko.flows.RealNVP,
            "nsf": zuko.flows.NSF,
            "maf": zuko.flows.MAF,
        }[kind]
        self.flow = family(features, transforms=transforms, hidden_features=self.hidden_features).double()
        self.loc = nn.Parameter(torch.zeros(features, dtype=torch.float64))
        self.log_scale = nn.Parameter(torch.full((features,), math.log(INITIAL_SCALE), dtype=torch.float64))
        # below the diagonal, in units of it
        self.shear = nn.Parameter(torch.zeros(features, features, dtype=torch.float64)) if sheared else None
        for layer in cast(zuko.lazy.LazyComposedTransform, self.flow.transform).transforms:
            _start_near_identity(layer)

    def log_prob(self, z: Tensor) -> Tensor:
        """Log density [nats] of z (..., D), shape (...); differentiable in z and in the weights."""
        u = (z - self.loc) * torch.exp(-self.log_scale)
        if self.shear is not None:
            lower = torch.tril(self.shear, -1)
            u = torch.linalg.solve_triangular(lower, u[..., None], upper=False, unitriangular=True)[..., 0]
        return self.flow().log_prob(u) - self.log_scale.sum()

    def rsample(self, n: int, generator: torch.Generator) -> Tensor:
        """Draw n points (n, D) that can be differentiated by the weights; only `generator` is used up."""
        noise = torch.randn(n, self.features, generator=generator, dtype=torch.float64, device=generator.device)
        return self.from_normal(noise.to(self.loc.device))

    def from_normal(self, noise: Tensor) -> Tensor:
        """The map from standard normal points (n, D) to the density's (n, D); differentiable in both."""
        u = self.flow().transform.inv(noise)
        if self.shear is not None:
            u = u + u @ torch.tril(self.shear, -1).mT
        return self.loc + torch.exp(self.log_scale) * u

    @torch.no_grad()
    def sample(self, n: int, generator: torch.Generator) -> Tensor:
        """Draw n points (n, D) without gradient; only `generator` is used up."""
        return self.rsample(n, generator)

    @torch.no_grad()
    def start_at(self, mean: Tensor, covariance: Tensor) -> None:
        """Set `loc`, `scale` and `shear` to those of a Gaussian, so that training starts there.

        Args:
            mean: (D,).
            covariance: (D, D), positive definite; a flow that is not sheared takes its diagonal alone.
        """
        self.loc.copy_(mean)
        if self.shear is None:
            self.log_scale.copy_(0.5 * torch.diagonal(covariance).log())
            return
        lower = torch.linalg.cholesky(covariance)
        scale = torch.diagonal(lower)
        self.log_scale.copy_(scale.log())
        self.shear.copy_(lower / scale[:, None] - torch.eye(self.features, dtype=lower.dtype))

    def config(self) -> dict[str, Any]:
        """Kind and sizes as JSON; `make_density` builds a flow of the same shape from it."""
        return {
            "kind": self.kind,
            "features": self.features,
            "hidden_features": list(self.hidden_features),
            "transforms": self.transforms,
            **({} if self.shear is None else {"sheared": True}),
        }


def build_flow(
    features: int,
    kind: FlowKind | Literal["auto"] = "auto",
    *,
    hidden_features: Sequence[int] = (64, 64),
    transforms: int | None = None,
    sheared: bool = False,
    seed: int = 0,
) -> Flow:
    """Build a flow over the unconstrained parameters; torch's global generator stays as it was.

    `realnvp`: affine coupling layers that keep every other feature in turn (Dinh et al., Density estimation using
    Real NVP, 2016); fast in both directions. `nsf`: autoregressive rational-quadratic splines (Durkan et al., Neural
    Spline Flows, 2019); separate peaks come out much sharper, sampling takes D passes. `maf`: autoregressive affine
    layers (Papamakarios et al., Masked Autoregressive Flow for Density Estimation, 2017); sampling takes D passes.
    With one feature the affine kinds could only be normal distributions and are refused.

    Args:
        features: D, the number of parameters.
        kind: `auto` is `realnvp`, and `nsf` for one feature.
        hidden_features: Widths of the hidden layers.
        transforms: Number of layers; None is 6, and 3 for `nsf`.
        sheared: Whether a triangular matrix takes over correlations, see `Flow`.
        seed: Of the first weights.

    Raises:
        BadInput: An unknown kind, a size below one, or an affine kind with one feature.

    Example:
        >>> flow = build_flow(2, seed=1)
        >>> flow.sample(5, torch.Generator().manual_seed(0)).shape
        torch.Size([5, 2])
    """
    if kind == "auto":
        kind = "nsf" if features == 1 else "realnvp"
    if kind not in get_args(FlowKind):
        raise BadInput(f"unknown flow kind {kind!r}; there are: auto, {', '.join(get_args(FlowKind))}")
    if transforms is None:
        transforms = 3 if kind == "nsf" else 6
    sizes = {"features": [features], "hidden_features": list(hidden_features), "transforms": [transforms]}
    for name, values in sizes.items():
        if not values or any(isinstance(v, bool) or not isinstance(v, int | np.integer) or v < 1 for v in values):
            raise BadInput(f"{name} must be made of integers of at least 1, got {values}")
    features, transforms, hidden_features = int(features), int(transforms), [int(v) for v in hidden_features]
    if features == 1 and kind != "nsf":
        raise BadInput(
            f"a {kind} flow of one parameter is an affine map of a normal distribution and nothing more; "
            "use 'nsf' (or 'auto')"
        )
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(index(seed))
        return Flow(features, kind, hidden_features, transforms, sheared)


def _start_near_identity(layer: nn.Module) -> None:
    """Shrink a layer's last parameters, and let its network saturate far from the data."""
    with torch.no_grad():
        network = getattr(layer, "hyper", None)
        if network is None:  # one feature: the layer's parameters come from no network
            for parameter in layer.parameters():
                parameter.mul_(0.01)
        else:
            for parameter in network[-1].parameters():
                parameter.mul_(0.01)
            network.register_forward_pre_hook(_saturate)


def _saturate(_: nn.Module, inputs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    return (_NETWORK_RANGE * torch.tanh(inputs[0] / _NETWORK_RANGE), *inputs[1:])
