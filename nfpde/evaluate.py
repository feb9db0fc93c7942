"""Measure a distribution against the parameters that the robots really had (known for simulated recordings only)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.markup import escape
from rich.table import Table

from nfpde.corner import corner
from nfpde.distribution import ParameterDistribution
from nfpde.errors import BadInput
from nfpde.ot import emd
from nfpde.truth import Truth

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Distance:
    """Exact optimal transport cost, Euclidean, between two sets of parameter vectors.

    Args:
        physical: In the units of the parameters as they are, mixed where they differ; the paper's measure.
        box: With each parameter divided by the width of its bounds; all parameters count alike.
    """

    physical: float
    box: float


@dataclass(frozen=True, eq=False)
class Evaluation:
    """How close a distribution is to the truth.

    Episodes with the same true parameters are of one robot, which counts once however many it has, as in a fit.

    Both tables of distances hold the rows `estimate`, `initial` where one was given, `uniform` (draws from the box)
    and, where it is known, `population` (fresh draws from it): what an estimate equal to the true population gets.

    Args:
        to_episodes: Distance of samples of each to the true parameters of the robots that made the episodes.
        to_population: Distance of samples of each to fresh draws of the true population; empty where it is not known.
        names: Names of the parameters.
        coverage_50: Share of the robots' true parameters inside the central 50 % of the estimate, for each parameter.
        coverage_90: The same of the central 90 %.
        log_density_gain: Mean log density of the robots' true parameters under the estimate, less that under the
            uniform distribution over the box [nats]; -inf if a true parameter lies on a bound.
        episodes: Number of episodes.
        samples: Number of samples that every figure comes from.
        seed: Of the samples.
        xi: The samples of the estimate (samples, D), in physical units.
        truth: What it was measured against, over the estimate's space.
        recorded: The same as it came with the recordings.
    """

    to_episodes: Mapping[str, Distance]
    to_population: Mapping[str, Distance]
    names: list[str]
    coverage_50: list[float]
    coverage_90: list[float]
    log_density_gain: float
    episodes: int
    samples: int
    seed: int
    xi: Floats = field(repr=False)
    truth: Truth = field(repr=False)
    recorded: Truth = field(repr=False)

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values, without samples and truth; a gain of -inf becomes null."""
        gain = self.log_density_gain
        return {
            "optimal_transport": {
                "to_episodes": {k: vars(d) for k, d in self.to_episodes.items()},
                "to_population": {k: vars(d) for k, d in self.to_population.items()},
            },
            "coverage": {
                name: {"50": half, "90": most}
                for name, half, most in zip(self.names, self.coverage_50, self.coverage_90, strict=True)
            },
            "log_density_gain": gain if math.isfinite(gain) else None,
            "episodes": self.episodes,
            "samples": self.samples,
            "seed": self.seed,
        }

    def draw(self, path: Path | str, *, zoom: bool = False) -> Path:
        """Write a corner plot of the estimate with the true parameters, and the population where it is known.

        Of a population that was drawn in wider bounds only the part inside the estimate's is shown.
        """
        truth, space = self.truth, self.truth.space
        drawn = self.recorded.draw_population(max(self.samples, 2000), np.random.default_rng(self.seed), space)
        if drawn is not None:
            drawn = drawn[((drawn >= space.low) & (drawn <= space.high)).all(1)]
            drawn = drawn if len(drawn) > 1 else None
        return corner(self.xi, path, space=space, truth=truth.xi, population=drawn, zoom=zoom)

    def __rich__(self) -> Group:
        """The tables for a terminal."""
        distances = Table(title="Optimal transport", box=SIMPLE_HEAD)
        distances.add_column("from", no_wrap=True)
        targets = [("robots", self.to_episodes)]
        if self.to_population:
            targets.append(("population", self.to_population))
        for name, _ in targets:
            distances.add_column(f"to {name}", justify="right", no_wrap=True)
            distances.add_column("in boxes", justify="right", no_wrap=True)
        for row in self.to_episodes:
            cells = [f"{value:.4g}" for _, d in targets for value in (d[row].physical, d[row].box)]
            distances.add_row(row, *cells)
        covered = Table(title="True parameters inside the central", box=SIMPLE_HEAD)
        for name in ("parameter", "50 %", "90 %"):
            covered.add_column(name, justify="left" if name == "parameter" else "right")
        for name, half, most in zip(self.names, self.coverage_50, self.coverage_90, strict=True):
            covered.add_row(escape(name), f"{half:.0%}", f"{most:.0%}")
        covered.add_section()
        covered.add_row("mean", f"{np.mean(self.coverage_50):.0%}", f"{np.mean(self.coverage_90):.0%}")
        robots = len(self.truth.robots)
        return Group(
            distances,
            covered,
            f"Log density of the true parameters above uniform: {self.log_density_gain:.2f} nats",
            f"{self.episodes} episodes of {robots} different robot{'s' if robots > 1 else ''}, {self.samples} samples; "
            "in boxes: in units of the widths of the bounds",
        )


def evaluate(
    distribution: ParameterDistribution,
    truth: Truth,
    *,
    initial: ParameterDistribution | None = None,
    samples: int = 2000,
    seed: int = 0,
) -> Evaluation:
    """Measure a distribution against the truth.

    Distances between finite samples never reach zero: read them beside the rows `uniform` and `population`.

    Args:
        distribution: The estimate.
        truth: True parameters of the recorded episodes, of which those with the same are of one robot, and the
            population they come from where it is known.
        initial: What the fit started from, measured alike.
        samples: Number of samples of each distribution.
        seed: Of all samples, from 0 to 2^63 - 1.

    Returns:
        Distances, coverage and log density.

    Raises:
        SpaceMismatch: A distribution and the truth are about different parameters; bounds and order may differ.
        BadInput: Fewer than 2 samples, a seed out of range, or true parameters outside of the distribution's bounds.
    """
    if isinstance(samples, bool) or not isinstance(samples, int | np.integer):
        raise BadInput(f"samples is {samples!r}; it must be an integer of at least 2")
    if samples < 2:
        raise BadInput(f"samples must be at least 2, got {samples}")
    samples = int(samples)
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
        raise BadInput(f"seed is {seed!r}; it must be an integer from 0 to {2**63 - 1}")
    seed = int(seed)
    space = distribution.space
    recorded, truth = truth, truth.over(space)
    rng = np.random.default_rng(seed)
    rows = {"estimate": distribution.sample(samples, seed)}
    if initial is not None:
        initial.space.check_same(space)
        rows["initial"] = initial.sample(samples, seed)
    rows["uniform"] = space.uniform(samples, rng)
    to_population = {}
    drawn, fresh = (recorded.draw_population(samples, rng, space) for _ in range(2))
    if drawn is not None and fresh is not None:
        rows["population"] = drawn
        to_population = {name: _distance(xi, fresh, space.width) for name, xi in rows.items()}
    robots = truth.robots
    half, most = (_coverage(rows["estimate"], robots, share) for share in (0.5, 0.9))
    # the uniform log density is -sum log width
    gain = float(distribution.log_prob(robots).mean() + np.log(space.width).sum())
    return Evaluation(
        to_episodes={name: _distance(xi, robots, space.width) for name, xi in rows.items()},
        to_population=to_population,
        names=list(space.names),
        coverage_50=half,
        coverage_90=most,
        log_density_gain=gain,
        episodes=len(truth.xi),
        samples=samples,
        seed=seed,
        xi=rows["estimate"],
        truth=truth,
        recorded=recorded,
    )


def _distance(x: Floats, y: Floats, width: Floats) -> Distance:
    return Distance(physical=emd(x, y).cost, box=emd(x / width, y / width).cost)


def _coverage(xi: Floats, true: Floats, share: float) -> list[float]:
    low, high = np.quantile(xi, [0.5 - share / 2, 0.5 + share / 2], axis=0)
    return ((true >= low) & (true <= high)).mean(0).tolist()
