"""Fitting a distribution: the run around an estimator (progress, checkpoints, results)."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray

from nfpde.checkpoint import load_state, save_state
from nfpde.dataset import Dataset
from nfpde.distribution import ParameterDistribution
from nfpde.errors import BadInput
from nfpde.estimation.config import NfpdeConfig
from nfpde.estimation.nfpde import NfpdeTrainer
from nfpde.flow import build_flow
from nfpde.losses import increment_scale
from nfpde.progress import progress
from nfpde.sim import Simulator

Method = Literal["softmax", "cai"]

CHECKPOINT_SECONDS = 5.0


@dataclass(frozen=True)
class FitResult:
    """What a fit found.

    Attributes:
        distribution: over the parameters, after the fit.
        initial: the distribution that the fit started from.
        history: one table of figures per iteration.
        info: method, settings, seed, counts, versions; JSON.
    """

    distribution: ParameterDistribution
    initial: ParameterDistribution
    history: list[dict[str, float]]
    info: dict[str, Any]

    def save(self, folder: str | Path) -> None:
        """Write `distribution/`, `initial/` and `fit.json`."""
        folder = Path(folder)
        self.distribution.save(folder / "distribution")
        self.initial.save(folder / "initial")
        (folder / "fit.json").write_text(json.dumps({**self.info, "history": self.history}, indent=1))


def fit(
    simulator: Simulator,
    dataset: Dataset,
    *,
    method: Method = "softmax",
    config: NfpdeConfig | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    quiet: bool = False,
) -> FitResult:
    """Fit a distribution over the simulator's parameters to recordings of one or many robots.

    Main arguments:

    Args:
        simulator: predicts; its `space` holds the parameters.
        dataset: recordings that fit the simulator.
        method: `softmax` (Eq. 11) or `cai` (Eq. 10) of Takano et al., IROS 2024, Algorithm 1. With `softmax`
            the temperature beta is found from the data unless the settings give it: see `next_beta`.
        config: settings; the defaults suit a few parameters and a few hundred transitions.
        seed: of everything random; equal seeds give equal results.
        out: folder for checkpoints and results. A run that was interrupted or killed goes on from there, to the
            same numbers as one that never stopped; a finished one is read back.
        quiet: no progress on the error stream.

    Raises:
        BadInput: settings, or windows without what the simulator needs.
        CheckpointMismatch: `out` belongs to another run.
        KeyboardInterrupt: after saving a checkpoint.
    """
    if method not in get_args(Method):
        raise BadInput(f"no method is called {method!r}; there are: {', '.join(get_args(Method))}")
    config = config or NfpdeConfig()
    dataset = simulator.prepare(dataset)
    windows = dataset.windows(config.horizon, stride=1, history=simulator.history_steps(dataset.control_dt))
    unit = np.ones(simulator.states.ndiff)
    scale = increment_scale(simulator.states, windows) if config.scale == "increment" else unit

    def losses(xi: NDArray[np.float64], batch: NDArray[np.intp]) -> NDArray[np.float64]:
        return simulator.losses(xi, windows[batch], scale)

    channels = simulator.states.ndiff * config.horizon
    trainer = NfpdeTrainer(losses, len(windows), channels, simulator.space, method, config, seed)
    run = {
        "method": method,
        "config": asdict(config),
        "seed": seed,
        "space": simulator.space.to_json(),
        "simulator": simulator.identity(),
        "dataset": dataset.content_hash(),
    }
    with _one_thread():
        counted = _iterate(trainer, simulator, run, None if out is None else Path(out), quiet)
    info = {
        **run,
        "transitions": len(windows),
        "episodes": len(dataset),
        **counted,
        "versions": {name: version(name) for name in ("nfpde", "mujoco", "torch", "zuko", "numpy")},
    }
    flow = trainer.flow
    start = build_flow(
        flow.features, flow.kind, hidden_features=flow.hidden_features, transforms=flow.transforms, seed=seed
    )
    result = FitResult(
        ParameterDistribution(simulator.space, flow),
        ParameterDistribution(simulator.space, start),
        trainer.history,
        info,
    )
    if out is not None:
        result.save(out)
    return result


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keep torch to one thread: its networks here are so small that more of them only get in each other's way."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _iterate(
    trainer: NfpdeTrainer, simulator: Simulator, run: dict[str, Any], out: Path | None, quiet: bool
) -> dict[str, float]:
    """All iterations, from the last checkpoint on where there is one; returns steps and seconds of the whole run."""
    folder = None if out is None else out / "checkpoint"
    saved = None if folder is None else load_state(folder, run)
    counted = {"simulated_steps": 0.0, "seconds": 0.0}
    if saved is not None:
        tensors, info = saved
        trainer.restore(tensors, info)
        counted = info["counted"]
    steps_before, begun = counted["simulated_steps"] - simulator.simulated_steps, time.perf_counter()
    seconds_before = counted["seconds"]

    def save() -> None:
        counted["simulated_steps"] = steps_before + simulator.simulated_steps
        counted["seconds"] = seconds_before + time.perf_counter() - begun
        if folder is not None:
            tensors, info = whole
            save_state(folder, tensors, {"run": run, "counted": counted, **info})

    total, last_save = trainer.config.iterations, time.monotonic()
    # an interrupt may hit in the middle of an iteration: what is saved is always the state at the end of one
    whole = trainer.state()
    with progress(f"Fitting ({trainer.candidate})", total, start=trainer.iteration, quiet=quiet) as report:
        try:
            while trainer.iteration < total:
                figures = trainer.step()
                whole = trainer.state()
                shown = {k: figures[k] for k in ("loss", "beta", "effective") if k in figures}
                report(trainer.iteration, **shown)
                if time.monotonic() - last_save > CHECKPOINT_SECONDS:
                    save()
                    last_save = time.monotonic()
        finally:
            save()
    return counted
