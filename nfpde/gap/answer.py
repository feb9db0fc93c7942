"""From what was found to the report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset
from nfpde.effects import LINEAR, Effect, slides
from nfpde.elements import element_names
from nfpde.gap.acceptance import CLOSED
from nfpde.gap.accepted import Accepted, called, key
from nfpde.gap.certainty import INTERVAL, standard_errors
from nfpde.gap.distance import distance
from nfpde.gap.fit import Fit
from nfpde.gap.inertia import follows
from nfpde.gap.leftover import describe, leftover
from nfpde.gap.levels import FLOOR_ERROR, NEAR_FLOOR, Yardstick, rare, shrink_interval
from nfpde.gap.loud import noise_residuals
from nfpde.gap.noise import learn_scatter
from nfpde.gap.recordings import Recordings, blocks_of, joined
from nfpde.gap.report import Cause, Distance, Fitted, GapReport, Level, Rival, Trace, Verdict
from nfpde.gap.select import Selection
from nfpde.gap.separate import separating_experiment
from nfpde.gap.stage import Stage
from nfpde.gap.trial import Trial
from nfpde.gap.where import gap_map, needed_forces, places
from nfpde.gap.words import summary
from nfpde.sim import runs_on

Array = NDArray[np.float64]

ALARM = 0.005
"""Probability at which a few windows beyond all noise count as a gap."""

SPOTLESS = 1e-6
"""A gap below this share of the nominal model's is closed, whatever the noise."""

QUIET = 0.1
"""Share of what counts as a gap that counts as noise where the sensors have none."""

PART = 4
"""One of so many held-out windows is asked how well the values of effects that were told apart are known."""

TRACES = 6


@dataclass(frozen=True, eq=False)
class Outcome:
    """All that a diagnosis found.

    stage: the windows on which the gap is measured
    near: those on which it was explained: the same, or shorter ones
    final: parameters and effects fitted
    accepted: effects in the order of their acceptance, which is their order in `final`
    sigma: noise of the sensors (2 nv,); typical: generalized forces (nv,)
    computed: which velocities do not count and why, in words
    error: by how much joints at rest read too high (nv,); the recordings are without it
    by: windows of the joints that alone told what was found, where not all did: values are known by these
    """

    dataset: Dataset
    stage: Stage
    near: Stage
    final: Trial
    accepted: tuple[Accepted, ...]
    selection: Selection
    sigma: Array
    typical: Array
    seed: int
    computed: str
    error: Array
    by: Stage | None = None

    @property
    def recordings(self) -> Recordings:
        """The windows."""
        return self.stage.recordings

    @property
    def base(self) -> Trial:
        """Parameters fitted, without effects."""
        return self.stage.base

    @property
    def yardstick(self) -> Yardstick:
        """Measures the gap."""
        return self.stage.yardstick

    @cached_property
    def without(self) -> list[Trial]:
        """For each accepted effect, the best model without it."""
        if len(self.accepted) == 1:
            return [self.base]
        return [self.selection.without(self.final, i) for i in range(len(self.accepted))]

    def level(self, horizon: int | None) -> Level:
        """The ladder at one horizon (an index), or over all."""
        count = len(self.recordings.horizons)
        columns = slice(None) if horizon is None else slice(horizon, None, count)
        stages = [self.yardstick.squares(r) for r in (self.stage.nominal, self.base.held, self.final.held)]
        gaps = [float(squares[..., columns].mean()) for squares in (*stages, self.yardstick.floor)]
        unit = max(gaps[0], 1e-300)
        return Level(1.0, *(g / unit for g in gaps[1:]))

    def least_over_floor(self) -> float:
        """Gap that is left in noise floors, the lower end of its 95 % interval.

        Where contacts open and close, few windows hold most of the noise and of the gap, and their ratio is uncertain.
        A single joint may stand out all the same: where no effect was found, the joint with the largest ratio counts.
        """
        if self._exact:
            return 0.0
        floor = self.yardstick.floor.mean((1, 2))
        least = 1.0 - shrink_interval(floor, self.yardstick.gap(self.final.held), self.recordings.block, self.seed)[2]
        asked = self.selection.sigma is not None and not self.accepted
        return max(least, self.selection.beyond(self.final)) if asked else least

    def rare(self) -> float:
        """Probability of the windows with the largest gap of both halves, were there nothing but noise."""
        if self._exact:
            return 1.0
        halves = [self.final.held, self.final.fit.residuals]
        gap = np.concatenate([self.yardstick.gap(r) for r in halves])
        block = np.concatenate([self.recordings.block, -1 - blocks_of(self.recordings.fit)])
        noise = np.concatenate([self.yardstick.gap(draw) for draw in self.yardstick.noise])
        return rare(gap, NEAR_FLOOR * noise, block)

    @property
    def _exact(self) -> bool:
        """Whether no window shows anything beyond rounding, or beyond a trace of what there was."""
        halves = [self.final.held, self.final.fit.residuals]
        return max(float(self.yardstick.gap(r).max()) for r in halves) < FLOOR_ERROR

    def distance(self) -> Distance:
        """How far apart recorded and simulated states lie at the windows' ends."""
        base, final, held = self.base.fit, self.final.fit, self.recordings.held
        nominal = self.stage.court.nominal[None]
        at = [(base.replay, nominal), (base.replay, base.xi[None]), (final.replay, final.xi[None])]
        ends = [replay.predict(xi, held)[0, :, -1] for replay, xi in at]
        count = len(self.recordings.horizons)
        fitter = self.stage.court.held
        draw = noise_residuals(final.replay, final.xi, held, fitter.horizons, self.sigma, self.seed)[0]
        noise = np.concatenate([draw[..., i] for i in (count - 1, 2 * count - 1)], axis=1)
        return distance(base.replay.sim.states, held, ends, noise)

    @cached_property
    def explained(self) -> Trial:
        """What was found on the windows on which it was explained."""
        return self.final if self.near is self.stage else self.near.shown(self.final, refitted=False)

    @cached_property
    def errors(self) -> Array:
        """Standard errors of what was found (D,)."""
        court = self._by.court
        shown = self.explained if self.by is None else self.by.shown(self.final, refitted=False)
        return standard_errors(court, court.fitter.resolved(shown.fit))

    @property
    def _by(self) -> Stage:
        """The windows by which values are known."""
        return self.near if self.by is None else self.by

    def errors_of(self, trial: Trial) -> Array:
        """Standard errors of another model's parameters (D,), on the same windows: contacts tear long ones apart.

        For an effect that was told apart less will do: in smooth motion slopes, which tell them to within a factor of
        two; beside contacts a part of the windows, which know less than all.
        """
        effects = [key(e) for e in trial.fit.replay.effects]
        if effects == [key(e) for e in self.final.fit.replay.effects]:
            return self.errors
        court = self._by.court
        shown = court.fitter.resolved(self._by.shown(trial, refitted=False).fit)
        rivals = {key(t.effect) for a in self.accepted for t in a.rivals if t.effect is not None}
        if effects[-1] in rivals:
            return standard_errors(court, shown)
        if self.selection.sigma is None:
            return shown.standard_errors
        some = np.arange(0, len(court.held.windows), PART)
        return standard_errors(replace(court, held=court.held.some(some)), shown)

    def cause(self, effect: Effect, fit: Fit, errors: Array, before: Trial, after: Trial) -> Cause:
        """An effect as it stands in a fit; `before` and `after` are the models without and with it."""
        index = [key(e) for e in fit.replay.effects].index(key(effect))
        block = self.recordings.block
        gaps = [self.yardstick.gap(t.held) for t in (before, after)]
        shrink, low, high = shrink_interval(gaps[0], gaps[1], block, self.seed)
        gain, error, _ = self.selection.court.gain(after, before)
        columns = fit.replay.columns(index)
        values = _fitted(fit, errors, columns, [q.name for q in effect.quantities])
        if slides(self.selection.model, effect):
            values = {n: replace(v, unit=LINEAR.get(v.unit, v.unit)) for n, v in values.items()}
        name, target = called(effect)
        reading = effect.name if effect.says else ""
        return Cause(name, target, effect.sentence, values, shrink, low, high, gain, error, reading=reading)


def answer(outcome: Outcome, seconds: float) -> GapReport:
    """Put the report together."""
    selection, recordings, final, base = outcome.selection, outcome.recordings, outcome.final, outcome.base
    model = selection.model
    near = outcome.near
    court = near.court
    left_over = outcome.explained
    # what noise alone leaves, so that a gap that remains does not hide itself
    noise = near.yardstick.noise.reshape(-1, *left_over.held.shape[1:])
    quiet = learn_scatter(noise, 0, QUIET * court.floor)
    halves = (court.fitter, court.held)
    # both halves: where the gap lies is no matter of proof, and an effect may show in few windows
    at_base = [needed_forces(near.base.fit, half, quiet, outcome.typical, noise).energy for half in halves]
    gap = outcome.level(None)
    effects = _causes(outcome)
    sound = any(not any(v.at_bound for v in cause.parameters.values()) for cause in effects)
    verdict = _verdict(gap, outcome.least_over_floor(), outcome.rare(), named=bool(effects), sound=sound)
    force = None
    if verdict == "unexplained":
        forces = [needed_forces(left_over.fit, half, quiet, outcome.typical, noise) for half in halves]
        left = leftover(near.recordings, forces[0], forces[1], quiet, left_over.held, model)
        force = describe(left, model, near.recordings.held)
    tried = sorted(_tried(outcome), key=lambda c: -c.shrink)
    best = {(c.effect, c.target): c for c in reversed(tried)}  # of the readings of an effect
    ranking = [c for c in tried if c is best[c.effect, c.target]]
    found = gap_map(model, joined(near.recordings.fit, near.recordings.held), np.concatenate(at_base), court.capped)
    where = places(found)
    reads = _reads(model, outcome.error)
    free = final.fit.replay.parameters[: final.fit.replay.nbase]
    parameters = _fitted(final.fit, outcome.errors, slice(0, len(free)), [p.name for p in free])
    for p in filter(follows, free):  # either end is as sound as what lies between
        parameters[p.name] = replace(parameters[p.name], at_bound=False)
    apart, ahead = outcome.distance(), recordings.horizons[-1] * outcome.dataset.control_dt
    for replay in {id(t.fit.replay): t.fit.replay for t in (base, final, *outcome.without)}.values():
        selection.steps += replay.sim.simulated_steps
    return GapReport(
        verdict=verdict,
        effects=effects,
        ranking=ranking,
        where=where,
        gap=gap,
        horizons={h: outcome.level(i) for i, h in enumerate(recordings.horizons)},
        distance=apart,
        base=parameters,
        ladder=_ladder(outcome, gap),
        summary=summary(
            verdict,
            gap,
            effects,
            where,
            parameters,
            force,
            apart,
            ahead,
            ranking[0] if ranking else None,
            outcome.computed,
            reads,
        ),
        gap_map=found,
        traces=_traces(outcome),
        residual_force=force,
        held_out_episodes=recordings.held_out,
        sensor_noise=dict(zip(final.fit.replay.sim.states.channels, outcome.sigma.tolist(), strict=True)),
        encoder_error=dict(zip(reads, outcome.error[outcome.error != 0].tolist(), strict=True)),
        control_dt=outcome.dataset.control_dt,
        seconds=seconds,
        simulated_steps=selection.steps,
        candidates=len(selection.candidates),
        seed=outcome.seed,
        device=runs_on(final.fit.replay.sim),
        model=model,
    )


def _verdict(gap: Level, over_floor: float, rare: float, *, named: bool, sound: bool = True) -> Verdict:
    """What is left beside the noise floor decides, and beside what there was to explain; or a few windows do.

    Effects that all lean on their bounds (not `sound`) are stretched beyond what any robot has, and explain nothing
    where they leave more than noise: units of the recordings that are wrong do that.
    """
    if rare > ALARM and (over_floor <= NEAR_FLOOR or gap.after_effects < SPOTLESS):
        return "effects" if named else "no_gap"
    beyond, left = (share - gap.noise_floor for share in (gap.after_parameters, gap.after_effects))
    return "effects" if named and sound and left <= (1 - CLOSED) * beyond else "unexplained"


def _causes(outcome: Outcome) -> list[Cause]:
    out = []
    for accepted, before in zip(outcome.accepted, outcome.without, strict=True):
        cause = outcome.cause(accepted.effect, outcome.final.fit, outcome.errors, before, outcome.final)
        own = called(accepted.effect)
        rivals, readings, text = dict[tuple[str, str], Fit](), list[str](), ""
        for trial in accepted.rivals:
            if trial.effect is not None and called(trial.effect) == own:
                readings.append(trial.effect.name)
            elif trial.effect is not None:
                rivals.setdefault(called(trial.effect), trial.fit)
        for name, fit in list(rivals.items())[:1]:
            names, held = (_called(own), _called(name)), outcome.recordings.held
            text = separating_experiment(accepted.trial.fit, fit, held, outcome.sigma, names)
        others = [Rival(*name) for name in rivals]
        cause = replace(cause, indistinguishable=others, separating_experiment=text, other_readings=readings)
        out.append(cause)
    return sorted(out, key=lambda c: -c.shrink)


def _tried(outcome: Outcome) -> list[Cause]:
    """The candidates of the first round, each as it stands beside the parameters."""
    out, selection, own = [], outcome.selection, {id(outcome.base.fit.replay), id(outcome.final.fit.replay)}
    for trial in selection.ranking:
        if trial.effect is not None:
            sim = trial.fit.replay.sim
            begun = sim.simulated_steps
            out.append(outcome.cause(trial.effect, trial.fit, outcome.errors_of(trial), outcome.base, trial))
            if id(trial.fit.replay) not in own:  # those are counted in the end
                selection.steps += sim.simulated_steps - begun
    return out


def _reads(model: mujoco.MjModel, error: Array) -> dict[str, str]:
    """What joints at rest read too high or too low (nv,), in words, by their names."""
    names, said = element_names(model, "joint"), dict[str, str]()
    for dof in np.flatnonzero(error):
        joint = int(model.dof_jntid[dof])
        unit = "m" if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE else "rad"
        said[names[joint]] = f"{abs(error[dof]):.2g} {unit} too {'high' if error[dof] > 0 else 'low'}"
    return said


def _called(name_and_place: tuple[str, str]) -> str:
    name, target = name_and_place
    return f"{name} at {target}" if target else name


def _fitted(fit: Fit, errors: Array, columns: slice, names: list[str]) -> dict[str, Fitted]:
    replay, error = fit.replay, errors[columns]
    out = {}
    for i, (name, p) in enumerate(zip(names, replay.parameters[columns], strict=True)):
        value, low, high = float(fit.xi[columns][i]), p.low, p.high
        margin = 1e-3 * (high - low)
        span = INTERVAL * float(error[i])
        leans = value < low + margin or value > high - margin
        out[name] = Fitted(value, max(low, value - span), min(high, value + span), p.unit or "-", leans)
    return out


def _ladder(outcome: Outcome, gap: Level) -> list[tuple[str, float]]:
    rungs = [("nominal model", 1.0), ("+ parameters", gap.after_parameters)]
    unit = float(outcome.yardstick.squares(outcome.stage.nominal).mean())
    for i, accepted in enumerate(outcome.accepted[:-1]):
        trial = outcome.final
        for later in range(len(outcome.accepted) - 1, i, -1):
            trial = outcome.selection.without(trial, later)
        rungs.append((f"+ {_called(called(accepted.effect))}", float(outcome.yardstick.gap(trial.held).mean()) / unit))
    if outcome.accepted:
        rungs.append((f"+ {_called(called(outcome.accepted[-1].effect))}", gap.after_effects))
    return [*rungs, ("noise floor", gap.noise_floor)]


def _traces(outcome: Outcome) -> list[Trace]:
    """The held-out windows that the base predicts worst, one of each episode and channel first."""
    recordings, base, final = outcome.recordings, outcome.base.fit, outcome.final.fit
    windows, states = recordings.held, base.replay.sim.states
    gap = outcome.yardstick.gap(outcome.base.held)
    worst = np.argsort(-gap)[:TRACES]
    chosen = windows[worst]
    before, after = (f.replay.predict(f.xi[None], chosen)[0] for f in (base, final))
    scale = np.sqrt(np.nanmean(states.difference(chosen.target, chosen.state[:, :1]) ** 2, axis=(0, 1))) + 1e-12
    out = []
    for i in range(len(worst)):
        error = np.abs(np.nan_to_num(states.difference(before[i], chosen.target[i]))).max(0) / scale
        channel = int(error.argmax())
        reference = chosen.state[i, 0]
        moved = [
            states.difference(x, np.broadcast_to(reference, x.shape))[:, channel]
            for x in (chosen.target[i], before[i], after[i])
        ]
        measured, simulated, repaired = (np.concatenate([[0.0], m]) for m in moved)
        time = (chosen.row[i] + np.arange(chosen.horizon + 1)) * chosen.control_dt
        label = states.channels[channel]
        unit = (
            "rad or m, from the window's start" if label.startswith("qpos") else "rad/s or m/s, from the window's start"
        )
        episode = outcome.dataset.names[int(chosen.episode[i])]
        out.append(Trace(episode, label, unit, time, measured, simulated, repaired))
    return out
