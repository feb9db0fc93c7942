"""`ParameterDistribution`: a density over z seen through the sigmoid box, in physical units."""

from __future__ import annotations

from collections.abc import Sequence
from operator import index
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from nfpde.distribution import files
from nfpde.distribution.summary import Summary, summarise
from nfpde.errors import BadInput
from nfpde.flow import Density
from nfpde.parameters import ParameterSpace

_CHUNK = 8192  # points evaluated at once: bounds the memory of mixtures with many components


class ParameterDistribution:
    """A distribution over the parameters of a space, inside its box.

    With z distributed as `density`, the parameters are xi = low + (high - low) * sigmoid(z) (Takano et al.,
    IROS 2024, Eq. 12).

    Args:
        space: The parameters.
        density: A flow or a Gaussian mixture over z, of as many features as the space has parameters.

    Raises:
        BadInput: The numbers of features and parameters differ.

    Example:
        >>> from nfpde.flow import build_flow
        >>> from nfpde.parameters import Parameter
        >>> space = ParameterSpace([Parameter("mass", low=2.0, high=6.0)])
        >>> xi = ParameterDistribution(space, build_flow(1)).sample(100, seed=1)
        >>> xi.shape, bool((xi > 2.0).all() and (xi < 6.0).all())
        ((100, 1), True)
    """

    def __init__(self, space: ParameterSpace, density: Density) -> None:
        if density.features != len(space):
            raise BadInput(
                f"the density has {density.features} features and the space {len(space)} parameters: {space}"
            )
        self.space = space
        self.density = density
        # the open box: the ends of float64's range inside the bounds
        self._first = np.nextafter(space.low, space.high)
        self._last = np.nextafter(space.high, space.low)

    def __repr__(self) -> str:
        return f"ParameterDistribution({self.density.config()['kind']} over {', '.join(self.space.names)})"

    def sample(self, n: int, seed: int = 0) -> NDArray[np.float64]:
        """Draw n parameter vectors, (n, D) in physical units, strictly inside the box.

        Equal seeds give equal samples; no global random state is touched.

        Args:
            n: How many, 0 or more.
            seed: From -2^63 to 2^64 - 1.

        Raises:
            BadInput: Another n or seed.
        """
        count = _integer("n", n, 0)
        generator = torch.Generator().manual_seed(_integer("seed", seed, -(2**63), 2**64 - 1))
        if not count:
            return np.empty((0, len(self.space)))
        z = self.density.sample(count, generator)
        return np.clip(self.space.to_physical(z.cpu().numpy()), self._first, self._last)

    def log_prob(self, xi: ArrayLike) -> NDArray[np.float64]:
        """Log density [nats] per product of the physical units, at xi (n, D) or (D,); shape (n,).

        On the bounds and outside of them it is -inf.

        Raises:
            BadInput: No numbers, wrong shape, or NaN.
        """
        try:
            xi = np.atleast_2d(np.asarray(xi, dtype=np.float64))
        except (TypeError, ValueError):
            raise BadInput(
                f"parameter vectors must be numbers in rows of one length, shape (n, {len(self.space)}), got {xi!r}: "
                f"{self.space}"
            ) from None
        if xi.ndim != 2 or xi.shape[1] != len(self.space):
            raise BadInput(f"parameter vectors must have shape (n, {len(self.space)}), got {xi.shape}: {self.space}")
        if np.isnan(xi).any():
            raise BadInput(f"parameter vector {int(np.argwhere(np.isnan(xi))[0, 0])} holds NaN")
        inside = ((xi > self.space.low) & (xi < self.space.high)).all(1)
        z = self.space.to_unconstrained(xi[inside])
        out = np.full(len(xi), -np.inf)
        out[inside] = self._log_prob_z(z) - self.space.log_det_jacobian(z)
        return out

    def mean(self, samples: int = 20_000, seed: int = 0) -> NDArray[np.float64]:
        """Mean (D,), from samples: its standard error is std / sqrt(samples)."""
        return self._some(samples, seed).mean(0)

    def std(self, samples: int = 20_000, seed: int = 0) -> NDArray[np.float64]:
        """Standard deviation (D,), from samples."""
        return self._some(samples, seed).std(0)

    def quantiles(self, q: float | Sequence[float], samples: int = 20_000, seed: int = 0) -> NDArray[np.float64]:
        """Quantiles of each parameter, from samples: (D,) for one q in [0, 1], (len(q), D) for several.

        Raises:
            BadInput: q that is no number from 0 to 1, or no list of such.
        """
        try:
            shares = np.asarray(q, dtype=np.float64)
        except (TypeError, ValueError):
            raise BadInput(f"q is {q!r}; it must be a number from 0 to 1, or a list of such") from None
        if shares.ndim > 1 or not ((shares >= 0) & (shares <= 1)).all():
            raise BadInput(f"q is {q!r}; it must be a number from 0 to 1, or a list of such")
        return np.quantile(self._some(samples, seed), shares, axis=0)

    def summary(self, nominal: ArrayLike | None = None, *, samples: int = 20_000, seed: int = 0) -> Summary:
        """A table with one row a parameter; `rich` prints it, `to_json` gives plain values.

        Args:
            nominal: The model's own values (D,), shown beside; NaN where there is none.
            samples: Number of samples that the figures come from, 1 or more.
            seed: Of the samples.

        Raises:
            BadInput: Fewer samples, or `nominal` of another shape.
        """
        return summarise(self.space, self._some(samples, seed), nominal)

    def _some(self, samples: int, seed: int) -> NDArray[np.float64]:
        """Samples of which figures are made, which need one at least."""
        return self.sample(_integer("samples", samples, 1), seed)

    def save(self, folder: Path | str) -> None:
        """Write `distribution.json` and `flow.safetensors` into `folder`, made where it is missing."""
        files.save(folder, self.space, self.density)

    @staticmethod
    def remove(folder: Path | str) -> None:
        """Take away what `save` wrote into `folder`, where there is any."""
        files.remove(folder)

    @classmethod
    def load(cls, folder: Path | str, space: ParameterSpace | None = None) -> ParameterDistribution:
        """Read what `save` wrote; samples and densities are equal to the last bit on the same machine.

        Args:
            folder: Where it was saved.
            space: What the space must be; None takes any.

        Raises:
            BadInput: A file is missing, damaged, of another schema, or its tensors do not fit.
            SpaceMismatch: The saved space differs from `space`; names the first difference.
        """
        return cls(*files.load(folder, space))

    @torch.no_grad()
    def _log_prob_z(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        device = next(iter(self.density.state_dict().values())).device
        parts = [
            self.density.log_prob(torch.from_numpy(z[i : i + _CHUNK]).to(device)).cpu().numpy()
            for i in range(0, len(z), _CHUNK)
        ]
        return np.concatenate([np.empty(0), *parts])


def _integer(name: str, value: int, least: int, most: int | None = None) -> int:
    """An integer in its range as a plain one, whatever kind it is of."""
    try:
        number = index(value)
    except TypeError:
        number = None
    if number is None or number < least or (most is not None and number > most):
        limits = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise BadInput(f"{name} is {value!r}; it must be an integer {limits}")
    return number
