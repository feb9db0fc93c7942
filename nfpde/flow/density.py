"""What a density over the unconstrained parameters must offer to be fitted, saved and sampled."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor


@runtime_checkable
class Density(Protocol):
    """A density over z in R^D, in float64. `Flow` and `GaussianMixture` are the two there are.

    A torch module with `log_prob`, `sample` and `config` is one. `make_density(density.config())` builds one of
    the same kind and sizes, and `load_state_dict` then makes it equal.
    """

    @property
    def features(self) -> int:
        """D, the number of parameters."""
        ...

    def log_prob(self, z: Tensor) -> Tensor:
        """Log density [nats] of z (..., D), shape (...)."""
        ...

    def sample(self, n: int, generator: torch.Generator) -> Tensor:
        """Draw n points (n, D) without gradient; only `generator` is used up."""
        ...

    def config(self) -> dict[str, Any]:
        """Kind and sizes as JSON, enough to build one of the same shape."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """All tensors by name."""
        ...

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> Any:
        """Take over the tensors of another of the same shape."""
        ...
