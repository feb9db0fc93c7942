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
from nfpde.gap.checks import check_fit
from nfpde.gap.levels import Yardstick
from nfpde.gap.recordings import Recordings, alike_halves, cut_recordings, windows_for
from nfpde.gap.replay import Replay
from nfpde.gap.report import GapReport
from nfpde.gap.select import Accepted, Selection
from nfpde.gap.sensors import sensor_noise
from nfpde.gap.stage import Stage, first_fit, gaps, in_noise, moved_over
from nfpde.gap.trial import Trial, noise_of
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
    scales = DataScales.of(mjmodel, dataset)
    candidates = [(e, e.screened(scales)) for e in all_candidates(mjmodel, scales)]
    history, lead = _history(candidates, dataset.control_dt)
    windows = windows or windows_for(mjmodel.nv)
    recordings = cut_recordings(dataset, history, seed, windows, lead)
    guesses = np.stack([_nominal(start), 0.5 * (start.low + start.high)])
    check_fit(start, recordings, guesses[0])
    touches = any(e.whole == "contact" for e, _ in candidates)
    report("fitting the parameters")
    base, court = first_fit(start, _lengths(recordings, touches)[0], guesses, capped=touches)
    held = alike_halves(_lengths(recordings, touches)[0], gaps(base, court), seed)
    if held is not None:
        recordings = cut_recordings(dataset, history, seed, windows, lead, held)
        base, court = moved_over(base, court, _lengths(recordings, touches)[0])
    selection: Selection | None = None
    stage: Stage | None = None
    found: tuple[Trial, list[Accepted]] | None = None
    for part in _lengths(recordings, touches):
        report("noise of the sensors")
        if stage is not None:
            guesses = np.vstack([guesses[:2], base.fit.xi])
            base, court = first_fit(start, part, guesses, capped=touches)
        stage = in_noise(base, court, part, seed)
        base = stage.base
        if selection is None:
            selection = Selection(mjmodel, space, nthread, stage.court, stage.yardstick, candidates, report, device)
        selection = replace(selection, court=stage.court, yardstick=stage.yardstick)
        selection.sigma = stage.sigma if touches else None
        found = selection.run(base, found)
    if selection is None or stage is None or found is None:
        raise RuntimeError("there are no windows of any length")
    report("where, and what is left")
    near, (final, accepted) = stage, found
    if touches and len(near.recordings.horizons) < len(recordings.horizons):
        base, court = first_fit(start, recordings, np.vstack([guesses[:2], base.fit.xi]), capped=True)
        stage = in_noise(base, court, recordings, seed)
        selection = replace(selection, court=stage.court, yardstick=stage.yardstick)
        final = stage.shown(final, refitted=True) if accepted else stage.base
        selection.ranking[:] = [stage.shown(t, refitted=False) for t in selection.ranking]
    sigma = sensor_noise(final.fit.replay, final.fit.xi, recordings.rows)
    draws = noise_of(final.fit, sigma, stage.court.held, seed) / stage.court.held.scale
    shown = replace(stage, yardstick=Yardstick.of(draws, stage.base.held, stage.court.capped))
    near = shown if near is stage else near
    outcome = Outcome(dataset, shown, near, final, tuple(accepted), selection, sigma, scales.force, seed)
    return answer(outcome, time.monotonic() - begin)


def _lengths(recordings: Recordings, touches: bool) -> list[Recordings]:
    """The recordings in windows of the lengths that are fitted, shortest first."""
    return (brief(recordings) if touches else []) or [recordings]


def _history(candidates: Sequence[tuple[Effect, Array]], control_dt: float) -> tuple[int, int]:
    """Commands from before a window that any combination of three effects may need, and that any single one may."""
    times = sorted((e.memory_time() for e, _ in candidates), reverse=True)[:3]
    if not times or times[0] <= 0:
        return 0, 0
    return int(np.ceil(sum(times) / control_dt - 1e-9)) + 2, int(np.ceil(times[0] / control_dt - 1e-9))


def _nominal(start: Replay) -> Array:
    """The model's own parameters, brought inside their bounds; the middle of the bounds where elements differ."""
    own, middle = start.sim.nominal()[: start.nfree], 0.5 * (start.low + start.high)
    return np.clip(np.where(np.isnan(own), middle, own), start.low, start.high)
