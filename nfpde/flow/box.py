"""The sigmoid box: physical parameters xi inside their bounds, unconstrained parameters z in R^D, in torch.

`ParameterSpace` has the same maps in NumPy.
"""

import torch
from torch import Tensor, nn
from torch.nn.functional import logsigmoid

from nfpde.parameters import ParameterSpace


class Box(nn.Module):
    """The map xi = low + (high - low) * sigmoid(z) (Takano et al., IROS 2024, Eq. 12), in float64.

    Stable in both tails: close to either bound xi keeps the distance to that bound as well as float64 can hold it.

    Args:
        space: Its bounds are the box.

    Example:
        >>> from nfpde.parameters import Parameter
        >>> box = Box(ParameterSpace([Parameter("mass", low=2.0, high=6.0)]))
        >>> box.to_physical(torch.zeros(1, 1, dtype=torch.float64)).item()
        4.0
    """

    low: Tensor
    high: Tensor

    def __init__(self, space: ParameterSpace) -> None:
        super().__init__()
        self.register_buffer("low", torch.tensor(space.low, dtype=torch.float64), persistent=False)
        self.register_buffer("high", torch.tensor(space.high, dtype=torch.float64), persistent=False)

    def to_physical(self, z: Tensor) -> Tensor:
        """Map z (..., D) into the box, (..., D) in physical units."""
        width = self.high - self.low
        near_low = self.low + width * torch.sigmoid(z)
        return torch.where(z < 0, near_low, self.high - width * torch.sigmoid(-z))

    def to_unconstrained(self, xi: Tensor) -> Tensor:
        """Inverse of `to_physical`, (..., D); a value on a bound gives an infinite z, one beyond it NaN."""
        width = self.high - self.low
        return torch.log((xi - self.low) / width) - torch.log((self.high - xi) / width)

    def log_det_jacobian(self, z: Tensor) -> Tensor:
        """Log |det d xi / d z| at z (..., D), summed over the parameters: shape (...)."""
        return (torch.log(self.high - self.low) + logsigmoid(z) + logsigmoid(-z)).sum(-1)
