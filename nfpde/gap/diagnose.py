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
from nfpde.gap.checks import check_fit
from nfpde.gap.fit import Fit, Fitter
from nfpde.gap.levels import Yardstick, calm
from nfpde.gap.loud import DRAWS, loudness, noise_residuals
from nfpde.gap.noise import floor_of, learn_scatter
from nfpde.gap.recordings import Recordings, alike_halves, cut_recordings, windows_for
from nfpde.gap.replay import Replay
from nfpde.gap.report import GapReport
from nfpde.gap.search import search_all
from nfpde.gap.select import Selection
from nfpde.gap.sensors import sensor_noise
from nfpde.gap.trial import Court, Trial
from nfpde.parameters import ParameterSpace
from nfpde.sim import Device, load_model

Array = NDArray[np.float64]

GATHERINGS = 5
"""Turns of samples about the parameters at most where contacts make slopes mislead: what a base has left to gain every
effect would seem to explain."""


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
    check_fit(start, recordings, _nominal(start))
    report("fitting the parameters")
    base, court = _base_fit(start, recordings, any(e.whole == "contact" for e, _ in candidates))
    held = alike_halves(recordings, _gaps(base, court), seed)
    if held is not None:
        recordings = cut_recordings(dataset, history, seed, windows, lead, held)
        base, court = _moved_over(base, court, recordings)
    report("noise of the sensors")
    nominal, base, court, draws = _in_noise(base, court, recordings, seed)
    yardstick = Yardstick.of(draws, base.held, court.capped)
    selection = Selection(mjmodel, space, nthread, court, yardstick, candidates, report, device)
    final, accepted = selection.run(base)
    report("where, and what is left")
    sigma = _sigma(final.fit, recordings)
    draws = _noise(final.fit, sigma, court.held, seed) / court.held.scale
    yardstick = Yardstick.of(draws, base.held, court.capped)
    outcome = Outcome(
        dataset, recordings, nominal, base, final, tuple(accepted), selection, yardstick, sigma, scales.force, seed
    )
    return answer(outcome, time.monotonic() - begin)


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


def _base_fit(start: Replay, recordings: Recordings, rugged: bool) -> tuple[Trial, Court]:
    """The fit of the parameters alone, and the court that judges effects.

    Where contacts make the cost rugged, the parameters are searched by samples too.
    """
    fitter, held = (Fitter(half, recordings.horizons) for half in (recordings.fit, recordings.held))
    guesses = np.stack([_nominal(start), 0.5 * (start.low + start.high)])
    moved = _moved(start, recordings)
    first = fitter.residuals_at(start, guesses[:1])[0]
    scatter = learn_scatter(first, 0, floor_of(first, moved))
    fit = fitter.improve(fitter.start(start, guesses, scatter), 6)
    court = Court(recordings.block, fitter, held, floor_of(fit.residuals, moved), guesses[0], rugged)
    fit = court.settle(fit, rounds=1, iterations=5)
    court = replace(court, floor=floor_of(fit.residuals, moved))
    fit = court.settle(fit, rounds=1, iterations=5)
    if rugged and start.nfree:
        some, part = court.screening(fit)
        found = fitter.start(start, search_all(some, part).xi[None], fit.scatter)
        found = court.settle(found)
        fit = found if found.cost < fit.cost else fit
    return _judged(fit, court, moved)


def _judged(fit: Fit, court: Court, moved: Array) -> tuple[Trial, Court]:
    """A fit of the parameters as the base, and the court with the floor that it leaves."""
    court = replace(court, floor=floor_of(fit.residuals, moved))
    fit = court.fitter.linearise(court.fitter.rescale(fit, court.scatter(fit)))
    return court.judge(None, fit), court


def _gaps(base: Trial, court: Court) -> Array:
    """What a base leaves in every window, those to fit first (N,)."""
    white = base.fit.scatter.whiten(np.concatenate([base.fit.residuals, base.held]))
    return calm(white**2, court.capped).mean((1, 2))


def _moved_over(base: Trial, court: Court, recordings: Recordings) -> tuple[Trial, Court]:
    """The base fitted to other halves of the recordings, from where it was."""
    fitter, held = (Fitter(half, recordings.horizons) for half in (recordings.fit, recordings.held))
    fit = fitter.start(base.fit.replay, base.fit.xi[None], base.fit.scatter)
    court = replace(court, block=recordings.block, fitter=fitter, held=held)
    return _judged(court.settle(fit), court, _moved(fit.replay, recordings))


def _moved(replay: Replay, recordings: Recordings) -> Array:
    """By how much the channels change over the horizons, as residuals (N, nv, C)."""
    steps = np.array(recordings.horizons) - 1
    windows = recordings.fit
    return replay.by_dof(replay.sim.states.difference(windows.target[:, steps], windows.state[:, :1]))


def _in_noise(base: Trial, court: Court, recordings: Recordings, seed: int) -> tuple[Array, Trial, Court, Array]:
    """Residuals counted in how loud noise is in each window, and the parameters fitted once more.

    Returns:
        Held-out residuals of the nominal model (N, nv, C), the base, the court, and residuals that noise alone gives
        in the held-out windows (draws, N, nv, C).
    """
    sigma = _sigma(base.fit, recordings)
    fit, held = (_noise(base.fit, sigma, half, seed) for half in (court.fitter, court.held))
    left = np.concatenate([base.fit.residuals, base.held])
    loud = loudness(np.concatenate([fit, held], axis=1), left, court.floor)
    fitter = replace(court.fitter, loudness=loud[: fit.shape[1]])
    other = replace(court.held, loudness=loud[fit.shape[1] :])
    found = fitter.start(base.fit.replay, base.fit.xi[None], base.fit.scatter)
    floor = floor_of(found.residuals, _moved(found.replay, recordings))
    quiet = None
    if not court.rugged:
        quiet = learn_scatter((fit / fitter.scale).reshape(-1, *floor.shape), 0, floor)
    court = replace(court, fitter=fitter, held=other, floor=floor, quiet=quiet)
    found = court.settle(fitter.rescale(found, court.scatter(found)))
    if court.rugged and found.replay.nfree:
        found = court.evolved(found, GATHERINGS)
    found = fitter.linearise(found)
    nominal = other.residuals_at(found.replay, court.nominal[None])[0]
    return nominal, court.judge(None, found), court, held / other.scale


def _sigma(fit: Fit, recordings: Recordings) -> Array:
    """Noise of the sensors (2 nv,) as a fit's model sees it."""
    return sensor_noise(fit.replay, fit.xi, recordings.rows)


def _noise(fit: Fit, sigma: Array, half: Fitter, seed: int) -> Array:
    """Residuals that noise of the sensors (2 nv,) alone gives (draws, N, nv, C)."""
    return noise_residuals(fit.replay, fit.xi, half.windows, half.horizons, sigma, seed, DRAWS)
