"""The diagnosis from recordings to report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset
from nfpde.effects import DataScales, Effect, all_candidates
from nfpde.gap.answer import Outcome, answer
from nfpde.gap.checks import check_fit
from nfpde.gap.fit import Fitter
from nfpde.gap.levels import Yardstick, noise_residuals
from nfpde.gap.noise import floor_of, learn_scatter
from nfpde.gap.recordings import Recordings, cut_recordings, windows_for
from nfpde.gap.replay import Replay
from nfpde.gap.report import GapReport
from nfpde.gap.search import search_all
from nfpde.gap.select import Selection
from nfpde.gap.sensors import sensor_noise
from nfpde.gap.trial import Court, Trial
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
    recordings = cut_recordings(dataset, history, seed, windows or windows_for(mjmodel.nv), lead)
    check_fit(start, recordings, _nominal(start))
    report("fitting the parameters")
    nominal, base, court = _base_fit(start, recordings, any(e.whole == "contact" for e, _ in candidates))
    report("noise of the sensors")
    yardstick = _yardstick(base, base, recordings, seed)[0]
    selection = Selection(mjmodel, space, nthread, court, yardstick, candidates, report, device)
    final, accepted = selection.run(base)
    report("where, and what is left")
    yardstick, sigma = _yardstick(base, final, recordings, seed)
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


def _base_fit(start: Replay, recordings: Recordings, rugged: bool) -> tuple[Array, Trial, Court]:
    """Held-out residuals of the nominal model, the fit of the parameters alone, and the court that judges effects.

    Where contacts make the cost rugged, the parameters are searched by samples too.
    """
    fitter = Fitter(recordings.fit, recordings.horizons)
    guesses = np.stack([_nominal(start), 0.5 * (start.low + start.high)])
    steps = np.array(recordings.horizons) - 1
    moved = start.sim.states.difference(recordings.fit.target[:, steps], recordings.fit.state[:, :1])
    moved = start.by_dof(moved)
    first = start.residuals(guesses[:1], recordings.fit, recordings.horizons)[0]
    scatter = learn_scatter(first, 0, floor_of(first, moved))
    fit = fitter.improve(fitter.start(start, guesses, scatter), 6)
    court = Court(recordings, fitter, floor_of(fit.residuals, moved), guesses[0])
    fit = court.settle(fit, rounds=1, iterations=5)
    court = Court(recordings, fitter, floor_of(fit.residuals, moved), guesses[0])
    fit = court.settle(fit, rounds=1, iterations=5)
    if rugged and start.nfree:
        some, part = court.screening(fit)
        found = fitter.start(start, search_all(some, part).xi[None], fit.scatter)
        found = court.settle(found)
        fit = found if found.cost < fit.cost else fit
    court = Court(recordings, fitter, floor_of(fit.residuals, moved), guesses[0], rugged)
    nominal = start.residuals(guesses[:1], recordings.held, recordings.horizons)[0]
    fit = fitter.linearise(fitter.rescale(fit, court.scatter(fit)))
    return nominal, court.judge(None, fit), court


def _yardstick(base: Trial, trial: Trial, recordings: Recordings, seed: int) -> tuple[Yardstick, Array]:
    """What counts as one unit of gap, and the noise of the sensors, as a trial's model sees them."""
    fit = trial.fit
    sigma = sensor_noise(fit.replay, fit.xi, recordings.rows)
    noise = noise_residuals(fit.replay, fit.xi, recordings.held, recordings, sigma, seed)
    return Yardstick.of(noise, base.held), sigma
