"""Both stages as one estimator: every robot by itself, then all of them together."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from nfpde.estimation.config import TrajectoryConfig
from nfpde.estimation.trajectory.estimator import TrajectoryEstimator
from nfpde.estimation.trajectory.informing import PopulationEstimator
from nfpde.estimation.trajectory.problem import Problem


@dataclass
class TwoStages:
    """Runs `TrajectoryEstimator` to its end and `PopulationEstimator` on what it found; `step` is a round of either.

    Args:
        problem: windows sorted by robot.
        config: settings.
        seed: of starting points and draws.
    """

    problem: Problem
    config: TrajectoryConfig
    seed: int
    iteration: int = 0
    history: list[dict[str, float]] = field(default_factory=list)
    together: PopulationEstimator | None = None

    def __post_init__(self) -> None:
        self.alone = TrajectoryEstimator(self.problem, self.config, self.seed)

    @property
    def title(self) -> str:
        """Shown with the progress."""
        return self.alone.title

    @property
    def total(self) -> int:
        """Rounds at most."""
        return self.alone.total + self.config.population_rounds

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return self.together is not None and self.together.done

    def step(self) -> dict[str, float]:
        """One round of the stage that is under way; returns its figures, which are also added to `history`."""
        if self.alone.done:
            together = self.together or self._gather()
            figures = {**together.step(), "iteration": float(self.iteration + 1)}
            self.together = together
        else:
            figures = self.alone.step()
        self.iteration += 1
        self.history.append({**figures, "iteration": self.iteration})
        return self.history[-1]

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Everything the next round depends on, as tensors and JSON."""
        tensors, alone = self.alone.state()
        info = {"iteration": self.iteration, "history": list(self.history), "alone": alone, "together": None}
        if self.together is not None:
            more, info["together"] = self.together.state()
            tensors = tensors | more
        return tensors, info

    def restore(self, tensors: dict[str, Tensor], info: dict[str, Any]) -> None:
        """Go on from a `state`; the robots' best parameters are simulated again, the draws are not."""
        self.iteration, self.history = info["iteration"], list(info["history"])
        self.alone.restore(tensors, info["alone"])
        if info["together"] is not None:
            self.together = self._gather()
            self.together.restore(tensors, info["together"])

    def _gather(self) -> PopulationEstimator:
        alone = self.alone
        return PopulationEstimator(alone.problem, alone.noise, alone.posteriors(), self.config, self.seed)
