"""NFPDE, Algorithm 1: a normalizing flow over the parameters, learned from single transitions."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nfpde.checkpoint import flatten_state, restore_state
from nfpde.errors import BadInput, SimulationDiverged
from nfpde.estimation.ascent import ascend, responsibility, surrogate
from nfpde.estimation.candidates import cai, next_beta, softmax, sound, typical_effective
from nfpde.estimation.config import NfpdeConfig
from nfpde.flow import Flow, build_flow
from nfpde.parameters import ParameterSpace
from nfpde.sim import LOSS_LIMIT, OnDevice

Array = NDArray[np.float64]

LossFunction = Callable[[Array, NDArray[np.intp]], OnDevice]
"""Losses (M, B) of parameter vectors (M, D) on the transitions with the given indices (B,), on any device."""


FEW = 8
"""Samples that are simulated on all transitions, where all samples diverge on those of an iteration."""

_ON_HOST = 1
"""DLPack's number of memory that any processor of the host reads."""


def as_tensor(losses: OnDevice) -> Tensor:
    """Losses for torch, where they are: what is made of them is computed there, and M weights come back.

    A copy on the host where torch has no CUDA: built without, or for a newer driver than the one that Warp runs on.
    """
    if losses.__dlpack_device__()[0] == _ON_HOST or torch.cuda.is_available():
        return torch.from_dlpack(losses)
    array: Any = losses
    return torch.from_numpy(array.numpy())


def _diverged(losses: Tensor) -> float:
    """Share of simulations that diverged."""
    return float((losses >= LOSS_LIMIT).double().mean())


@dataclass
class NfpdeTrainer:
    """One run of Algorithm 1; `step` is one iteration of it.

    It knows a loss function and not a simulator. After `restore(state())` it goes on to the same numbers.

    Args:
        losses: see `LossFunction`.
        count: number of transitions N.
        channels: numbers compared in one loss.
        space: the parameters.
        candidate: Eq. 10 or Eq. 11.
        config: settings.
        seed: of samples, minibatches and first weights.
    """

    losses: LossFunction
    count: int
    channels: int
    space: ParameterSpace
    candidate: Literal["softmax", "cai"]
    config: NfpdeConfig
    seed: int
    iteration: int = 0
    beta: float | None = None
    history: list[dict[str, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        c = self.config
        self.flow: Flow = build_flow(
            len(self.space), c.flow, hidden_features=(c.hidden, c.hidden), transforms=c.transforms, seed=self.seed
        )
        self.optimizer = torch.optim.Adam(self.flow.parameters(), lr=c.learning_rate)
        self.generator = torch.Generator().manual_seed(self.seed)
        self.rng = np.random.default_rng(self.seed)

    @property
    def title(self) -> str:
        """Shown with the progress."""
        return f"Fitting ({self.candidate})"

    @property
    def total(self) -> int:
        """Iterations in all."""
        return self.config.iterations

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return self.iteration >= self.total

    def step(self) -> dict[str, float]:
        """Draw, simulate, learn; returns the figures of the iteration, which are also added to `history`.

        Raises:
            SimulationDiverged: every simulation did, of all transitions.
        """
        started = time.perf_counter()
        z = self.flow.sample(self.config.samples, self.generator)
        batch = self.rng.permutation(self.count)[: self.config.transitions]
        losses = as_tensor(self.losses(self.space.to_physical(z.numpy()), batch))
        diverged = _diverged(losses)
        if diverged == 1.0:
            losses = losses.clone()  # the next call may write over them
            self._check_others(z[:FEW])
        figures = {"loss": LOSS_LIMIT}
        # a transition of which all samples diverge tells nothing of them
        losses = losses[:, sound(losses)]
        if losses.shape[1]:
            figures = self._learn(z, losses)
        self.iteration += 1
        seconds = time.perf_counter() - started
        self.history.append({"iteration": self.iteration, **figures, "diverged": diverged, "seconds": seconds})
        return self.history[-1]

    def _check_others(self, z: Tensor) -> None:
        """Refuse to go on where all transitions diverge, and not only those of a batch."""
        rest = as_tensor(self.losses(self.space.to_physical(z.numpy()), np.arange(self.count)))
        if _diverged(rest) == 1.0:
            raise SimulationDiverged(
                f"every simulation of the {self.count} transitions diverged, with all parameters that were tried in "
                f"iteration {self.iteration + 1}: check the recorded states (units, order of columns), the control "
                "step and the bounds"
            )

    def _learn(self, z: Tensor, losses: Tensor) -> dict[str, float]:
        """Weigh the samples z (M, D) by their losses (M, B) and ascend; returns the figures."""
        c = self.config
        if self.candidate == "softmax":
            self.beta = c.beta or next_beta(losses, self.beta, self.channels, c.least_effective)
            values = softmax(losses, self.beta)
            figures = {
                "loss": float((values * losses).sum(0).mean()),
                "beta": self.beta,
                "effective": typical_effective(values),
            }
            weight = values.mean(1).cpu()
        else:
            values = cai(losses)
            figures = {"loss": -float(values.mean())}
            weight = (values.mean(1) / len(values)).cpu()
            weight = weight - weight.mean()

        def gain(log_ratio: Tensor) -> Tensor:
            if self.candidate == "softmax":
                return responsibility(log_ratio, weight)
            return surrogate(torch.exp(log_ratio), weight, c.clip)

        for group in self.optimizer.param_groups:
            group["lr"] = c.learning_rate * (1 - 0.9 * min(1.0, self.iteration / c.iterations))
        if not ascend(self.flow, self.optimizer, z, gain, c.gradient_steps):
            raise BadInput(
                f"the flow's weights are no longer finite after iteration {self.iteration + 1}: the learning rate "
                f"{c.learning_rate:g} is too high; lower learning_rate"
            )
        return figures

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Everything the next iteration depends on, as tensors and JSON."""
        tensors, layout = flatten_state("optimizer", self.optimizer.state_dict())
        tensors |= {f"flow.{k}": v.clone() for k, v in self.flow.state_dict().items()}
        tensors["generator"] = self.generator.get_state()
        _, rng = flatten_state("rng", self.rng.bit_generator.state)
        info = {"iteration": self.iteration, "beta": self.beta, "history": list(self.history)}
        return tensors, info | {"optimizer": layout, "rng": rng}

    def restore(self, tensors: dict[str, Tensor], info: dict[str, Any]) -> None:
        """Go on from a `state`."""
        prefix = "flow."
        self.flow.load_state_dict({k[len(prefix) :]: v for k, v in tensors.items() if k.startswith(prefix)})
        self.optimizer.load_state_dict(restore_state(info["optimizer"], tensors))
        self.generator.set_state(tensors["generator"])
        self.rng.bit_generator.state = restore_state(info["rng"], {})
        self.iteration, self.beta, self.history = info["iteration"], info["beta"], list(info["history"])
