"""Adam without torch.optim."""

import math
from collections.abc import Iterable

import torch
from torch import Tensor, nn


class Adam:
    """The optimizer of Kingma and Ba (Adam: A method for stochastic optimization, ICLR 2015).

    It is `torch.optim.Adam` with that one's defaults, whose first use in a process imports torch's compiler: four
    seconds, longer than all training here.

    Args:
        parameters: to be trained, changed in place.
        rate: of learning.
    """

    def __init__(self, parameters: Iterable[nn.Parameter], rate: float) -> None:
        self.parameters = list(parameters)
        self.rate, self.steps = rate, 0
        self.mean = [torch.zeros_like(p) for p in self.parameters]
        self.square = [torch.zeros_like(p) for p in self.parameters]

    def step(self, loss: Tensor) -> None:
        """One step down the slope of the loss ()."""
        slopes = torch.autograd.grad(loss, self.parameters)
        self.steps += 1
        rate, root = self.rate / (1 - 0.9**self.steps), math.sqrt(1 - 0.999**self.steps)
        with torch.no_grad():
            for p, slope, mean, square in zip(self.parameters, slopes, self.mean, self.square, strict=True):
                mean.lerp_(slope, 0.1)
                square.mul_(0.999).addcmul_(slope, slope, value=0.001)
                p.addcdiv_(mean, square.sqrt().div_(root).add_(1e-8), value=-rate)
