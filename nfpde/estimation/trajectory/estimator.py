"""The episode-level estimator: one parameter vector per robot, noise learned from the data."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from nfpde.checkpoint import flatten_state, restore_state
from nfpde.errors import SimulationDiverged
from nfpde.estimation.config import TrajectoryConfig
from nfpde.estimation.trajectory.borrowing import anything_new, borrowed_from, standing_out
from nfpde.estimation.trajectory.cautions import check_noise
from nfpde.estimation.trajectory.chains import Chains
from nfpde.estimation.trajectory.foretold import foretold, surely_better
from nfpde.estimation.trajectory.freedom import Fitted
from nfpde.estimation.trajectory.levenberg import Candidates, improve, linearise, restart, reweigh, start
from nfpde.estimation.trajectory.modes import LocalPosterior, determined, distinct, local_posteriors, prior_information
from nfpde.estimation.trajectory.noise import Noise, Scatter
from nfpde.estimation.trajectory.places import better_over_decades, spread_over_width
from nfpde.estimation.trajectory.problem import Problem
from nfpde.estimation.trajectory.scatter import (
    learn_alike,
    learn_shared,
    sensors_alone,
    simulation_errs,
    smoothed,
)
from nfpde.estimation.trajectory.settling import STILL, Linear, Linearised, farthest, settle
from nfpde.estimation.trajectory.starts import start_slopes

Array = NDArray[np.float64]

BORROWING_ROUNDS = (1, 2, 3)
"""Rounds that also start from where other robots ended, at most: see `TrajectoryEstimator._borrow`."""

LOOSE = 1.0
"""Error of a velocity that tells next to nothing, in what it changes by over a window: far larger than any difference
of positions has, and small enough for double precision."""

_FLAGS = ("learned", "settled", "begun", "doubts", "reached", "hopeless", "borrowing_pays")
"""What a checkpoint has beside arrays."""

CAUGHT_UP = 1 / 4
"""Share of what a fresh begin is behind that a round must catch up for another one."""

FRESH_TURNS = 2
"""Turns of starts and parameters with the noise of the sensors alone, before it is learned anew."""


@dataclass
class TrajectoryEstimator:
    """Local posteriors of all robots; `step` is one round: Levenberg-Marquardt, then a new residual covariance.

    Noise and parameters hold each other: what wrong parameters leave over passes for errors of the simulation, in which
    a motion tells little, and they stay wrong. Where such errors are found, rounds begin once more from the sensors'
    alone, and the likelier answer counts; where they are found then, too, once more without belief in the velocities,
    and the answer counts that foretells the positions better, see `foretold`. The last round holds the noise, see
    `settle`.

    Args:
        problem: windows sorted by robot.
        config: settings.
        seed: of the starting points.
    """

    problem: Problem
    config: TrajectoryConfig
    seed: int
    iteration: int = 0
    converged: bool = False
    learned: bool = False
    loose: bool = False
    settled: bool = False
    begun: int = 0
    doubts: int = 0
    reached: float | None = None
    hopeless: bool = False
    history: list[dict[str, float]] = field(default_factory=list)
    candidates: Candidates | None = None

    def __post_init__(self) -> None:
        self.robots = len(self.problem.members)
        self.chains = Chains.of(self.problem.linked)
        self.noise = Noise.alike(Scatter.white(self.problem.channels), self.problem.members)
        self.measured = self.problem
        self.linear: Linear | None = None
        self.slopes: Array | None = None
        self.places: Array | None = None
        self.borrowing_pays = True
        self.rival: dict[str, Any] | None = None

    @property
    def title(self) -> str:
        """Shown with the progress."""
        return f"Fitting {self.robots} robot{'s' if self.robots > 1 else ''}"

    @property
    def total(self) -> int:
        """Rounds at most."""
        return 3 * (self.config.rounds + 1)

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return self.settled

    def step(self) -> dict[str, float]:
        """One round for all robots; returns its figures, which are also added to `history`."""
        started = time.perf_counter()
        if not (self.converged or self.hopeless) and self.iteration - self.begun < self.config.rounds:
            self._round()
            self._catch_up()
        else:
            self._choose()
            if self._in_doubt():
                self._begin_anew()
            else:
                self._settle()
        self.iteration += 1
        best, c = self._best(), self._found()
        figures = {
            "loss": _mean_square([c.residuals[k] for k in best]),
            "noise": float(np.exp(self.noise.log_scale)),
            "degrees": self.noise.scatter.degrees,
            "modes": len(c.robot) / self.robots,
        }
        seconds = time.perf_counter() - started
        self.history.append({"iteration": self.iteration, **figures, "seconds": seconds})
        return self.history[-1]

    def _round(self) -> None:
        if self.candidates is None:
            self._first()
        c = self._found()
        improve(self.problem, c, self.noise, self.config.steps)
        if self.iteration == 0:
            c = self._look_farther(c)
        if self.iteration in BORROWING_ROUNDS and self.robots > 1:
            c = self._borrow(c)
        # slopes to both sides are for those that are left
        c = distinct(c)
        every = np.arange(len(c.robot))
        linearise(self.problem, c, self.noise, every, careful=True, keep=c.best(self.robots))
        c = self.candidates = distinct(c)
        before, best = self.noise.log_scale, self._best()
        moved, self.places = self._moved(c.z[best], c.information[best]), c.z[best]
        self._learn_noise()
        self.learned = bool(abs(self.noise.log_scale - before) < 1e-2)
        self.converged = bool(self.learned and moved < STILL and self.iteration > (self.robots > 1))

    def _catch_up(self) -> None:
        """Give up a fresh begin that stays behind."""
        if self.rival is None:
            return
        worth = float(np.nanmean(self._worth(self.doubts - 1)))
        behind = float(np.nanmean(self.rival["worth"])) - worth
        if self.reached is not None and behind > 0:
            self.hopeless = worth - self.reached < CAUGHT_UP * behind
        self.reached = worth

    def _in_doubt(self) -> bool:
        """Whether errors of the simulation are found, and not everything has been tried."""
        if self.slopes is None or not simulation_errs(self.noise.scatter, self.slopes):
            return False
        return self.doubts == 0 or bool(self.doubts == 1 and (self.problem.velocities & ~self.problem.computed).any())

    def _begin_anew(self) -> None:
        """Keep what was found, and go on from where it leads if the sensors alone err, the second time only positions'.

        Velocities count next to nothing then.
        """
        c, slopes = self._found(), self.slopes
        if slopes is None:
            raise RuntimeError("no round has been made")
        self.rival = self._held() | {"worth": self._worth(self.doubts), "learned": self.learned}
        self.loose = self.doubts == 1
        scatter = sensors_alone(self.noise.scatter, slopes, (self._grain, self.problem.floor))
        for _ in range(FRESH_TURNS):
            best = self._best()
            residuals = np.concatenate([c.residuals[k] for k in best])
            weights, errors, left = smoothed(scatter, self.chains, slopes, residuals)
            linear = Linear(c.z[best], left, weights, errors)
            at = Linearised.at(self.measured, linear, scatter, self.chains)
            self._take(linear, at)
            slopes = at.slopes
            restart(self.problem, c, self.noise)
            improve(self.problem, c, self.noise, self.config.steps)
            c = self.candidates = distinct(c)
        reweigh(c, self.noise)
        self.doubts, self.begun = self.doubts + 1, self.iteration + 1
        self.learned = self.converged = self.hopeless = False
        self.reached = None

    def _choose(self) -> None:
        """Of what was found last and before, what is worth more."""
        if self.rival is not None:
            last, before = self._worth(self.doubts - 1), self.rival["worth"]
            if not (last > before if self.doubts == 1 else surely_better(last, before)):
                self._take_up(self.rival)
                self.learned = self.rival["learned"]
        self.rival = None

    def _worth(self, doubt: int) -> Any:
        """What two answers are told apart by: log likelihood where both believe the same sensors; else `foretold`."""
        best, c = self._best(), self._found()
        if doubt == 0:
            return 2 * self.noise.log_constant - float(c.cost[best].sum())
        if self.slopes is None:
            raise RuntimeError("no round has been made")
        residuals = np.concatenate([c.residuals[k] for k in best])
        return foretold(self.noise.scatter, self.chains, self.slopes, residuals, ~self.problem.velocities)

    @property
    def _grain(self) -> Array:
        """Error of a measured state below which no channel is believed, in units (ndiff,)."""
        p = self.problem
        unbelieved = p.velocities if self.loose else p.computed
        return np.where(unbelieved, np.maximum(p.grain, LOOSE), p.grain)

    def _settle(self) -> None:
        """Hold the noise until parameters and starts agree, whatever the rounds before were going around between."""
        c, linear, scatter = self._found(), self.linear, self.noise.scatter
        if linear is None:
            raise RuntimeError("no round has been made")
        begin = replace(linear, best=c.z[self._best()])
        found, at, still = settle(self.measured, begin, scatter, self.chains, self.config.steps)
        self.converged = self.learned and still
        self._take(found, at)
        restart(self.problem, c, self.noise)
        c = c.joined(at.places(found))
        linearise(self.problem, c, self.noise, np.arange(len(c.robot)), careful=True)
        c = self.candidates = distinct(c)
        # costs to the last digits as of one stack, which is how a checkpoint's are computed
        reweigh(c, self.noise)
        self.settled = True

    def posteriors(self) -> list[LocalPosterior]:
        """The robots' posteriors under the learned noise, in the order of `problem.names`.

        Raises:
            SimulationDiverged: every simulation of a robot's recordings did.
            BadDataset: the recordings cannot tell the noise, see `check_noise`.
        """
        c = self._found()
        for g, k in enumerate(self._best()):
            if not np.isfinite(c.residuals[k]).all(1).any():
                raise SimulationDiverged(
                    f"every simulation of the recordings of {self.problem.names[g]} diverged: leave it out, or check "
                    "its states (units, order of columns)"
                )
        check_noise(self.measured, self.noise.scatter)
        if not self.settled:  # then they have been linearised last of all, see `_settle`
            linearise(self.problem, c, self.noise, np.arange(len(c.robot)), careful=True)
        return local_posteriors(c, self.robots)

    def _first(self) -> None:
        """Quasi-random starts in the inner part of the box, the same for every robot; noise from their residuals."""
        space = self.problem.simulator.space
        n = self.config.starts
        z = np.tile(spread_over_width(space, n, self.seed), (self.robots, 1))
        c = start(self.problem, z, np.repeat(np.arange(self.robots), n), self.noise)
        if not any(np.isfinite(r).all(1).any() for r in c.residuals):
            raise SimulationDiverged(
                f"every simulation of the recordings diverged, from {n} starting points inside the bounds: check the "
                "recorded states (units, order of columns), the control step and the bounds"
            )
        self.noise = Noise.alike(learn_alike(c.residuals, 0, self.problem.floor), self.problem.members)
        reweigh(c, self.noise)
        self.candidates = c

    def _look_farther(self, c: Candidates) -> Candidates:
        """Also begin where bounds that span decades hold something better than what was found in their width."""
        better = better_over_decades(self.problem, c, self.noise, self.config.starts, self.seed)
        if better is None:
            return c
        improve(self.problem, better, self.noise, self.config.steps)
        return c.joined(better)

    def _borrow(self, c: Candidates) -> Candidates:
        """Let robots also try the best place of two others: all of them, as long as that finds anything new.

        Then only those that are explained worse than the others: no place explains the rest better.
        """
        best = c.best(self.robots)
        takers = np.arange(self.robots)
        if not self.borrowing_pays:
            white = [self.noise.whiten(g, c.residuals[k][None])[0] for g, k in enumerate(best)]
            sound = [np.isfinite(c.residuals[k]).all(1) for k in best]
            costs = [np.where(s, self.noise.whitening.cost(w), np.nan) for s, w in zip(sound, white, strict=True)]
            takers = standing_out(costs, c.z.shape[1])
        robot, other = borrowed_from(self.robots, takers, self.iteration)
        if not len(robot):
            return c
        joined = c.joined(start(self.problem, c.z[best[other]], robot, self.noise))
        improve(self.problem, joined, self.noise, self.config.steps)
        self.borrowing_pays = anything_new(joined, len(c.robot))
        return joined

    def _learn_noise(self) -> None:
        c, p, best = self._found(), self.measured, self._best()
        fitted, z = determined(c.take(best)), c.z[best]
        residuals = np.concatenate([c.residuals[k] for k in best])
        start = self.noise.scatter
        if self.slopes is None:
            start = learn_alike([residuals], fitted, p.floor)
            self.slopes = start_slopes(p, z, np.sqrt(np.diag(start.process)[-p.simulator.states.ndiff :]))
        told = Fitted.of([s for k in best if (s := c.slopes[k]) is not None], prior_information(z))
        c.slopes = [None] * len(c.slopes)  # they take memory, and the next round has others
        found = learn_shared(start, residuals, self.slopes, self.chains, told, (self._grain, p.floor))
        self._linearise(Linear(z, found.left, found.weights, found.errors), found.scatter)
        restart(self.problem, c, self.noise)

    def _linearise(self, linear: Linear, scatter: Scatter) -> None:
        """Start the windows where the smoother puts them, and linearise there."""
        self._take(linear, Linearised.at(self.measured, linear, scatter, self.chains))

    def _take(self, linear: Linear, at: Linearised) -> None:
        """Go on with windows that are linearised."""
        self.linear, self.slopes, self.problem, self.noise = linear, at.slopes, at.problem, at.noise

    def _moved(self, places: Array, information: Array) -> float:
        """The most that a robot has moved since the round before, in its own standard deviations."""
        return np.inf if self.places is None else farthest(places - self.places, information)

    def _found(self) -> Candidates:
        if self.candidates is None:
            raise RuntimeError("call step first")
        return self.candidates

    def _best(self) -> NDArray[np.intp]:
        """Index of every robot's best candidate, (G,)."""
        return self._found().best(self.robots)

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Everything the next round depends on, as tensors and JSON."""
        tensors, layout = flatten_state("trajectory", self._held())
        info = {"iteration": self.iteration, "converged": self.converged, "history": list(self.history)}
        info |= {name: getattr(self, name) for name in _FLAGS}
        info |= {"trajectory": layout, "rival": None}
        if self.rival is not None:
            more, info["rival"] = flatten_state("rival", self.rival)
            tensors = tensors | more
        return tensors, info

    def restore(self, tensors: dict[str, Tensor], info: dict[str, Any]) -> None:
        """Go on from a `state`; the candidates are simulated again."""
        self.iteration, self.converged, self.history = info["iteration"], info["converged"], info["history"]
        for name in _FLAGS:
            setattr(self, name, info[name])
        self._take_up(restore_state(info["trajectory"], tensors))
        self.rival = None if info["rival"] is None else restore_state(info["rival"], tensors)

    def _held(self) -> dict[str, Any]:
        """What `_take_up` makes the noise, the starts and the candidates of."""
        c = self.candidates
        saved: dict[str, Any] = {**vars(self.noise.scatter), "loose": self.loose}
        if self.linear is not None:
            saved |= vars(self.linear)
        if c is not None:
            saved |= {"robot": c.robot, "z": c.z.copy(), "damping": c.damping.copy(), "places": self.places}
            saved |= {"information": c.information.copy(), "data_information": c.data_information.copy()}
        return saved

    def _take_up(self, saved: dict[str, Any]) -> None:
        self.loose = saved["loose"]
        scatter = Scatter(*(saved[f.name] for f in fields(Scatter)))
        self.noise = Noise.alike(scatter, self.problem.members)
        if "best" in saved:
            self._linearise(Linear(*(saved[f.name] for f in fields(Linear))), scatter)
        if "z" in saved:
            c = start(self.problem, saved["z"], saved["robot"], self.noise)
            # the width of the next differences depends on the information, where they are in single precision
            c.damping, c.information, c.data_information = (
                saved[name] for name in ("damping", "information", "data_information")
            )
            self.candidates, self.places = c, saved["places"]


def _mean_square(residuals: list[Array]) -> float:
    """Of the windows that did not diverge, every robot counted the same."""
    sound = [r[np.isfinite(r).all(1)] for r in residuals]
    return float(np.mean([np.mean(r**2) for r in sound if len(r)]))
