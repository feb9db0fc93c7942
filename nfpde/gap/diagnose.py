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
from nfpde.dataset.windows import check_count
from nfpde.effects import DataScales, Effect, all_candidates
from nfpde.elements import listed
from nfpde.errors import BadDataset, BadParameter
from nfpde.gap.answer import Outcome, answer
from nfpde.gap.checks import check_fit, check_readings
from nfpde.gap.found import surely
from nfpde.gap.halves import FEWEST
from nfpde.gap.journal import Journal
from nfpde.gap.late import believed
from nfpde.gap.recall import Recall
from nfpde.gap.recordings import windows_for
from nfpde.gap.replay import Replay
from nfpde.gap.report import GapReport
from nfpde.gap.resting import resting_error, without_error
from nfpde.gap.search import Search
from nfpde.gap.select import Selection
from nfpde.gap.sensors import sensor_noise
from nfpde.gap.stage import Stage
from nfpde.gap.touching import touches
from nfpde.gap.trial import noise_of
from nfpde.parameters import ParameterSpace
from nfpde.sim import Device, load_model
from nfpde.sim.limits import refuse_taken

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
    robot: str | None = None,
    journal: Journal | None = None,
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
        windows: Windows used of each half, at most, 20 or more; None: 80 to 160, fewer for models with many degrees of
            freedom.
        nthread: Threads; 0 takes all cores this process may use.
        device: Where to simulate, see `make_simulator`.
        robot: Label of the robot that is meant, where recordings are of several.
        journal: Keeps what is simulated, so that the same call goes on where this one was stopped.
        report: Called with what is being done.

    Returns:
        The report.

    Raises:
        BadModel, BadParameter, BadEffect: What cannot be used, and why.
        BadDataset: Recordings of several robots, that do not fit the model, or are too short.
        SimulationDiverged: The nominal model's simulation diverges.
        BadInput: A seed, a number of windows or of threads that is none, or a robot that was not recorded.
    """
    begin = time.monotonic()
    for name, value, least in (("seed", seed, 0), ("windows", windows, FEWEST), ("nthread", nthread, 0)):
        if value is not None:
            check_count(value, name, least)
    dataset = _of_one(dataset, robot)
    mjmodel = load_model(model)
    recall = Recall(journal=journal)
    start = Replay(mjmodel, space, [], nthread, device, recall)
    dataset = start.sim.prepare(dataset)
    check_readings(mjmodel, dataset)
    dataset, computed = believed(start, dataset, _nominal(start))
    scales = DataScales.of(mjmodel, dataset)
    # effects of the space itself are fitted anyway, such as friction at a joint that has some
    candidates = candidates_beside(mjmodel, scales, start.sim.effects, space)
    guesses = np.stack([_nominal(start), 0.5 * (start.low + start.high)])

    def select(stage: Stage) -> Selection:
        sigma = stage.sigma if search.touches else None
        return Selection(
            mjmodel,
            space,
            nthread,
            stage.court,
            candidates,
            report,
            device,
            recall,
            yardstick=stage.yardstick,
            sigma=sigma,
        )

    windows = windows or windows_for(mjmodel.nv)
    meets = touches(mjmodel, np.concatenate([np.hstack([e.qpos, e.qvel]) for e in dataset]))
    weights, force = computed.weights, scales.force
    search = Search(
        start, dataset, candidates, guesses, windows, seed, select, report, weights, meets=meets, force=force
    )
    error = resting_error(mjmodel, space, search.cut(), guesses, nthread, capped=search.touches, recall=recall)
    dataset = without_error(mjmodel, dataset, error)
    search = replace(search, dataset=dataset)
    check_fit(start, dataset, search.cut(), guesses[0])
    stage, found = search.run()
    found = surely(stage, found, seed)
    report("where, and what is left")
    final, accepted, selection = found.final, found.accepted, found.selection
    rows, encoders = found.recordings.rows, found.recordings.encoders
    sigma = sensor_noise(final.fit.replay, final.fit.xi, rows, encoders) / found.near.misjudged
    draws = stage.court.held.quieten(noise_of(final.fit, sigma, stage.court.held, seed))
    shown = stage.in_noise_of(draws)
    near = shown if found.near is stage else found.near
    effects, typical, said = tuple(accepted), scales.force, computed.sentence
    outcome = Outcome(dataset, shown, near, final, effects, selection, sigma, typical, seed, said, error, found.by)
    before = 0.0 if journal is None else journal.seconds
    return answer(outcome, before + time.monotonic() - begin)


def _of_one(dataset: Dataset, robot: str | None) -> Dataset:
    """The recordings of one robot: what two differ by is no effect that a model lacks."""
    if robot is not None:
        return dataset.of_robot(robot)
    if len(names := dataset.robots) > 1:
        raise BadDataset(
            f"these are recordings of {len(names)} robots ({listed(names)}), and a diagnosis is of one: choose one of "
            "them (robot=, --robot), or leave the labels away if they are the same"
        )
    return dataset


def candidates_beside(
    model: mujoco.MjModel, scales: DataScales, free: Sequence[Effect], space: ParameterSpace | None = None
) -> list[tuple[Effect, Array]]:
    """Every effect on every element on which it makes sense, with the values to screen, but those that are free.

    Args:
        model: The nominal model.
        scales: Typical magnitudes of the recordings.
        free: Effects whose values are free parameters already.
        space: Free parameters; what an effect takes from the model must not be among them.
    """
    known = {_what(e, model) for e in free}

    def possible(effect: Effect) -> bool:
        if _what(effect, model) in known:
            return False
        try:
            refuse_taken(model, space, [effect.bind(model)])
        except BadParameter:
            return False
        return True

    return [(e, e.screened(scales)) for e in all_candidates(model, scales) if possible(e)]


def _what(effect: Effect, model: mujoco.MjModel) -> tuple[str, tuple[int, ...]]:
    """An effect and the elements it acts on, however they are named."""
    if effect.kind is None:
        return effect.called, ()
    return effect.called, tuple(sorted({int(i) for i in effect.bind(model).ids}))


def _nominal(start: Replay) -> Array:
    """The model's own parameters, brought inside their bounds; the middle of the bounds where elements differ."""
    own, middle = start.sim.nominal()[: start.nfree], 0.5 * (start.low + start.high)
    return np.clip(np.where(np.isnan(own), middle, own), start.low, start.high)
