"""Build a density of a given kind and size, ready to take over saved tensors."""

from collections.abc import Mapping
from typing import Any, get_args

import torch

from nfpde.errors import BadInput
from nfpde.flow.density import Density
from nfpde.flow.mixture import GaussianMixture
from nfpde.flow.model import FlowKind, build_flow


def make_density(config: Mapping[str, Any]) -> Density:
    """Build a density of the kind and sizes that `Density.config` gave; its numbers are still to be loaded.

    Raises:
        BadInput: An unknown kind, or sizes that are missing, unknown or wrong.
    """
    sizes = dict(config)
    kind = sizes.pop("kind", None)
    kinds = ("gaussian_mixture", *get_args(FlowKind))
    if kind not in kinds:
        raise BadInput(f"unknown density kind {kind!r}; there are: {', '.join(kinds)}")
    try:
        return _mixture(**sizes) if kind == "gaussian_mixture" else build_flow(kind=kind, **sizes)
    except TypeError as error:
        raise BadInput(f"the sizes of a {kind} density cannot be read: {error}; got {sizes}") from None


def _mixture(features: int, components: int) -> GaussianMixture:
    if not all(isinstance(v, int) and v >= 1 for v in (features, components)):
        raise BadInput(f"features and components must be integers of at least 1, got {features!r} and {components!r}")
    return GaussianMixture(
        torch.ones(components),
        torch.zeros(components, features),
        torch.eye(features).repeat(components, 1, 1),
    )
