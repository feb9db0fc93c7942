"""From what was found to the report."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.elements import element_names
from nfpde.gap.acceptance import CLOSED
from nfpde.gap.accepted import beside, called
from nfpde.gap.fit import Fit
from nfpde.gap.inertia import follows
from nfpde.gap.leftover import describe, leftover
from nfpde.gap.levels import NEAR_FLOOR
from nfpde.gap.lone import spoken
from nfpde.gap.noise import learn_scatter
from nfpde.gap.outcome import Outcome as Outcome
from nfpde.gap.recordings import joined
from nfpde.gap.report import Cause, GapReport, Level, Rival, Verdict
from nfpde.gap.separate import separating_experiment
from nfpde.gap.traces import TRACES, traces
from nfpde.gap.trial import Trial
from nfpde.gap.values import fitted_values
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
    over_floor, rare = outcome.least_over_floor(), outcome.rare()
    verdict = _verdict(gap, over_floor, rare, named=bool(effects), sound=sound)
    alone = verdict == "unexplained" and rare <= ALARM and _in_noise(gap, over_floor)
    lone = outcome.lone() if alone else recordings.held[:0]
    force = None
    if verdict == "unexplained":
        forces = [needed_forces(left_over.fit, half, quiet, outcome.typical, noise) for half in halves]
        left = leftover(near.recordings, forces[0], forces[1], quiet, left_over.held, noise, model)
        force = describe(left, model, near.recordings.held)
    tried = sorted(_tried(outcome), key=lambda c: -c.shrink)
    best = {(c.effect, c.target): c for c in reversed(tried)}  # of the readings of an effect
    ranking = [c for c in tried if c is best[c.effect, c.target]]
    found = gap_map(model, joined(near.recordings.fit, near.recordings.held), np.concatenate(at_base), court.capped)
    where = places(found)
    reads = _reads(model, outcome.error)
    free = final.fit.replay.parameters[: final.fit.replay.nbase]
    parameters = fitted_values(final.fit, outcome.errors, slice(0, len(free)), [p.name for p in free])
    for p in filter(follows, free):  # either end is as sound as what lies between
        parameters[p.name] = replace(parameters[p.name], at_bound=False)
    worst = _worst(outcome, TRACES - min(len(lone), TRACES))
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
            (len(lone), spoken(lone, outcome.dataset.names)),
        ),
        gap_map=found,
        traces=traces(joined(lone[:TRACES], worst), base.fit, final.fit, outcome.dataset.names),
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
    if rare > ALARM and _in_noise(gap, over_floor):
        return "effects" if named else "no_gap"
    beyond, left = (share - gap.noise_floor for share in (gap.after_parameters, gap.after_effects))
    return "effects" if named and sound and left <= (1 - CLOSED) * beyond else "unexplained"


def _in_noise(gap: Level, over_floor: float) -> bool:
    """Whether what is left is no more than noise in the mean."""
    return over_floor <= NEAR_FLOOR or gap.after_effects < SPOTLESS


def _worst(outcome: Outcome, count: int) -> Windows:
    """The held-out windows that the base predicts worst."""
    worst = np.argsort(-outcome.yardstick.gap(outcome.base.held), kind="stable")
    return outcome.recordings.held[worst[:count]]


def _causes(outcome: Outcome) -> list[Cause]:
    out = []
    for index, (accepted, before) in enumerate(zip(outcome.accepted, outcome.without, strict=True)):
        cause = outcome.cause(accepted.effect, outcome.final.fit, outcome.errors, before, outcome.final)
        own = called(accepted.effect)
        rivals, readings, text = dict[tuple[str, str], Trial](), list[str](), ""
        for trial in accepted.rivals:
            if trial.effect is not None and called(trial.effect) == own:
                readings.append(trial.effect.name)
            elif trial.effect is not None:
                rivals.setdefault(called(trial.effect), trial)
        for name, rival in list(rivals.items())[:1]:
            names, held = (_called(own), _called(name)), outcome.recordings.held
            fits = _beside_the_same(outcome, index, rival)
            text = separating_experiment(*fits, held, outcome.sigma, names)
        others = [Rival(*name) for name in rivals]
        cause = replace(cause, indistinguishable=others, separating_experiment=text, other_readings=readings)
        out.append(cause)
    return sorted(out, key=lambda c: -c.shrink)


def _beside_the_same(outcome: Outcome, index: int, rival: Trial) -> tuple[Fit, Fit]:
    """An accepted effect and one that does the same, beside the same others: else the others would tell them apart.

    A rival that was found in a second look stands beside what was accepted since; it is fitted anew to what the final
    model has.
    """
    own = outcome.accepted[index].trial.fit
    if rival.effect is None or beside(own) == beside(rival.fit):
        return own, rival.fit
    selection, smaller = outcome.selection, outcome.without[index].fit
    replay = selection.replay([*smaller.replay.effects, rival.effect])
    values = rival.fit.xi[rival.fit.replay.columns(len(rival.fit.replay.effects) - 1)]
    court = selection.court
    start = court.fitter.start(replay, np.concatenate([smaller.xi, values])[None], smaller.scatter)
    found = court.converged(start)
    selection.count(replay)
    return outcome.final.fit, found


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


def _ladder(outcome: Outcome, gap: Level) -> list[tuple[str, float]]:
    rungs = [("nominal model", gap.before), ("+ parameters", gap.after_parameters)]
    unit = outcome.unit()
    for i, accepted in enumerate(outcome.accepted[:-1]):
        trial = outcome.final
        for later in range(len(outcome.accepted) - 1, i, -1):
            trial = outcome.selection.without(trial, later)
        rungs.append((f"+ {_called(called(accepted.effect))}", float(outcome.yardstick.gap(trial.held).mean()) / unit))
    if outcome.accepted:
        rungs.append((f"+ {_called(called(outcome.accepted[-1].effect))}", gap.after_effects))
    return [*rungs, ("noise floor", gap.noise_floor)]
