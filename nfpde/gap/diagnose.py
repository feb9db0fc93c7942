"""The diagnosis from recordings to report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset
from nfpde.effects import DataScales, Effect, all_candidates
from nfpde.gap.answer import Outcome, answer
from nfpde.gap.brief import brief
from nfpde.gap.checks import check_fit, check_readings
from nfpde.gap.levels import Yardstick
from nfpde.gap.recordings import Recordings, alike_halves, cut_recordings, windows_for
from nfpde.gap.replay import Replay
from nfpde.gap.report import GapReport
from nfpde.gap.select import Selection
from nfpde.gap.sensors import sensor_noise
from nfpde.gap.stage import Stage, begins_worse, first_fit, gaps, in_noise, moved_over
from nfpde.gap.trial import noise_of
from nfpde.parameters import ParameterSpace
from nfpde.sim import Device, load_model

Array = NDArray[np.float64]


def diagnose_gap(
    model: str | Path | mujoco.MjModel,
    dataset: Dataset,
    space: ParameterSpace | None = None,
    *,
    seed: int = 0,
    windows: int | None = None,
    nthread: int = 0,
    device: Device = "auto",
    report: Callable[[str], None] = lambda what: None,
) -> GapReport:
    """Say where the gap between a model and recordings lies, which effects cause it, and how far it shrinks.

    Every effect of the library is tried on every element it can act on, together with the free parameters; what is
    named has been asked for by recordings that no fit saw.

    Args:
        model: The nominal model: a path or an mjModel.
        dataset: Recordings of one robot, best several episodes.
        space: Parameters that are free, with bounds; None where the model's own are trusted.
        seed: Decides which episodes are held out, and all draws.
        windows: Windows used of each half, at most; None: 80 to 160, fewer for models with many degrees of freedom.
        nthread: Threads; 0 takes all cores this process may use.
        device: Where to simulate, see `make_simulator`.
        report: Called with what is being done.

    Returns:
        The report.

    Raises:
        BadModel, BadParameter, BadEffect: What cannot be used, and why.
        BadDataset: Recordings that do not fit the model or are too short.
    """
    begin = time.monotonic()
    mjmodel = load_model(model)
    start = Replay(mjmodel, space, [], nthread, device)
    dataset = start.sim.prepare(dataset)
    computed = check_readings(mjmodel, dataset)
    scales = DataScales.of(mjmodel, dataset)
    candidates = [(e, e.screened(scales)) for e in all_candidates(mjmodel, scales)]
    history, lead = _history(candidates, dataset.control_dt)
    windows = windows or windows_for(mjmodel.nv)
    recordings = cut_recordings(dataset, history, seed, windows, lead)
    guesses = np.stack([_nominal(start), 0.5 * (start.low + start.high)])
    check_fit(start, dataset, recordings, guesses[0])
    touches = any(e.whole == "contact" for e, _ in candidates)
    report("fitting the parameters")
    lengths = _lengths(recordings, touches)
    base, court = first_fit(start, lengths[0], guesses, capped=touches)
    every = cut_recordings(dataset, history, seed, windows)
    if begins_worse(base, court, _lengths(every, touches)[0], lead):
        lead, recordings, lengths = 0, every, _lengths(every, touches)
        base, court = first_fit(start, lengths[0], guesses, capped=touches)
    held = alike_halves(lengths[0], gaps(base, court), seed)
    if held is not None:
        recordings = cut_recordings(dataset, history, seed, windows, lead, held)
        lengths = _lengths(recordings, touches)
        base, court = moved_over(base, court, lengths[0])
    report("noise of the sensors")
    near = in_noise(base, court, lengths[0], seed)
    sigma = near.sigma if touches else None
    selection = Selection(mjmodel, space, nthread, near.court, near.yardstick, candidates, report, device, sigma=sigma)
    final, accepted = selection.run(near.base)
    for longer in lengths[1:]:
        report("longer windows")
        near = _stage_after(near, longer, guesses, seed)
        selection = replace(selection, court=near.court, yardstick=near.yardstick, sigma=near.sigma)
        final, accepted = selection.run(near.base, (final, accepted))
    report("where, and what is left")
    stage = near
    if lengths[-1] is not recordings:
        stage = _stage_after(near, recordings, guesses, seed)
        selection = replace(selection, court=stage.court, yardstick=stage.yardstick)
        final = stage.shown(final, refitted=True) if accepted else stage.base
        selection.ranking[:] = [stage.shown(t, refitted=False) for t in selection.ranking]
    sigma = sensor_noise(final.fit.replay, final.fit.xi, recordings.rows)
    draws = noise_of(final.fit, sigma, stage.court.held, seed) / stage.court.held.scale
    shown = replace(stage, yardstick=Yardstick.of(draws, stage.base.held, stage.court.capped, stage.precision))
    near = shown if near is stage else near
    outcome = Outcome(dataset, shown, near, final, tuple(accepted), selection, sigma, scales.force, seed, computed)
    return answer(outcome, time.monotonic() - begin)


def _lengths(recordings: Recordings, touches: bool) -> list[Recordings]:
    """The recordings in windows of the lengths that are fitted, shortest first."""
    return (brief(recordings) if touches else []) or [recordings]


def _stage_after(before: Stage, longer: Recordings, guesses: Array, seed: int) -> Stage:
    """The stage of longer windows, its base fitted from guesses (G, D) and from the base of the shorter ones."""
    fit = before.base.fit
    base, court = first_fit(fit.replay, longer, np.vstack([guesses, fit.xi]), capped=True)
    return in_noise(base, court, longer, seed)


def _history(candidates: Sequence[tuple[Effect, Array]], control_dt: float) -> tuple[int, int]:
    """Commands from before a window that any combination of three effects may need, and that any single one may."""
    times = sorted((e.memory_time() for e, _ in candidates), reverse=True)[:3]
    recall = int(np.ceil(max((e.recall_time() for e, _ in candidates), default=0.0) / control_dt - 1e-9))
    if not times or times[0] <= 0:
        return recall, 0
    return int(np.ceil(sum(times) / control_dt - 1e-9)) + 2 + recall, int(np.ceil(times[0] / control_dt - 1e-9))


def _nominal(start: Replay) -> Array:
    """The model's own parameters, brought inside their bounds; the middle of the bounds where elements differ."""
    own, middle = start.sim.nominal()[: start.nfree], 0.5 * (start.low + start.high)
    return np.clip(np.where(np.isnan(own), middle, own), start.low, start.high)
