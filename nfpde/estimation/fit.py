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

SCHEMA_VERSION = 1
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
        """Write `distribution/`, `initial/` and, last, `fit.json`."""
        folder = Path(folder)
        self.distribution.save(folder / "distribution")
        self.initial.save(folder / "initial")
        content = {"schema_version": SCHEMA_VERSION, **self.info, "history": self.history}
        temporary = folder / "fit.json.tmp"
        temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False), encoding="utf-8")
        temporary.replace(folder / "fit.json")

    @classmethod
    def load(cls, folder: str | Path) -> FitResult:
        """Read what `save` wrote.

        Raises:
            BadInput: a file is missing or damaged, or of another version.
        """
        folder = Path(folder)
        path = folder / "fit.json"
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise BadInput(f"{path} cannot be read ({error.strerror}); is this the folder of a fit?") from None
        except ValueError as error:
            raise BadInput(f"{path} is not JSON: {error}") from None
        found = content.pop("schema_version", None) if isinstance(content, dict) else None
        if found != SCHEMA_VERSION or "history" not in content:
            raise BadInput(f"{path}: schema_version is {found!r}, this version of nfpde reads {SCHEMA_VERSION}")
        distribution = ParameterDistribution.load(folder / "distribution")
        initial = ParameterDistribution.load(folder / "initial", distribution.space)
        return cls(distribution, initial, content.pop("history"), content)


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

    Args:
        simulator: predicts; its `space` holds the parameters.
        dataset: recordings that fit the simulator.
        method: `softmax` (Eq. 11) or `cai` (Eq. 10) of Takano et al., IROS 2024, Algorithm 1. With `softmax`
            the temperature beta is found from the data unless the settings give it: see `next_beta`.
        config: settings; the defaults suit a few parameters and a few hundred transitions.
        seed: of everything random, at least 0; equal seeds give equal results.
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
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**63:
        raise BadInput(f"seed is {seed!r}; it must be an integer of at least 0")
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

    def snapshot() -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        tensors, info = trainer.state()
        now = {
            "simulated_steps": steps_before + simulator.simulated_steps,
            "seconds": seconds_before + time.perf_counter() - begun,
        }
        return tensors, {"run": run, "counted": now, **info}

    def save() -> None:
        if folder is not None:
            save_state(folder, *whole)

    total, last_save = trainer.config.iterations, time.monotonic()
    if saved is not None and trainer.iteration >= total:
        return counted
    # an interrupt may hit in the middle of an iteration: what is saved is always the state at the end of one
    whole = snapshot()
    with progress(f"Fitting ({trainer.candidate})", total, start=trainer.iteration, quiet=quiet) as report:
        try:
            while trainer.iteration < total:
                figures = trainer.step()
                whole = snapshot()
                shown = {k: figures[k] for k in ("loss", "beta", "effective") if k in figures}
                report(trainer.iteration, **shown)
                if time.monotonic() - last_save > CHECKPOINT_SECONDS:
                    save()
                    last_save = time.monotonic()
        except KeyboardInterrupt:
            if folder is None:
                raise
            raise KeyboardInterrupt(
                f"the fit stopped; {out} holds its state after {whole[1]['iteration']} of {total} iterations, from "
                "which the same call goes on"
            ) from None
        finally:
            save()
    return whole[1]["counted"]
