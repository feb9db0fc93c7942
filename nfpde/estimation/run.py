"""The run around an estimator: progress, checkpoints, Ctrl-C, going on after a kill."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import torch

from nfpde.checkpoint import STATE_FILE, load_state, save_state
from nfpde.dataset import Dataset
from nfpde.errors import CheckpointMismatch
from nfpde.estimation.behaviour import Behaviour, difference, observe
from nfpde.progress import progress
from nfpde.sim import Simulator

CHECKPOINT_SECONDS = 5.0

STATE_VERSION = 3
"""Of what a checkpoint holds, and of what is made of it."""


class Estimator(Protocol):
    """What advances in steps, and can be saved and restored between two of them."""

    iteration: int

    @property
    def title(self) -> str:
        """Shown with the progress."""
        ...

    @property
    def total(self) -> int:
        """Iterations at most."""
        ...

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        ...

    def step(self) -> dict[str, float]:
        """One iteration; returns its figures."""
        ...

    def state(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Everything the next iteration depends on, as tensors and JSON."""
        ...

    def restore(self, tensors: dict[str, torch.Tensor], info: dict[str, Any]) -> None:
        """Go on from a `state`."""
        ...


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keep torch to one thread: its networks here are so small that more of them only get in each other's way."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def run_estimator(
    trainer: Estimator, simulator: Simulator, dataset: Dataset, run: dict[str, Any], out: Path | None, quiet: bool
) -> dict[str, float]:
    """All iterations, from the last checkpoint on where there is one.

    Args:
        trainer: what advances.
        simulator: its steps are counted, but for those that tell whether it is the one of the checkpoint.
        dataset: recordings that are fitted.
        run: what must be the same for a run to go on, JSON.
        out: the run's folder; None saves nothing.
        quiet: no progress on the error stream.

    Returns:
        `simulated_steps` and `seconds` of the whole run, its earlier parts included.

    Raises:
        CheckpointMismatch: `out` belongs to another run, or to another simulator by what it does.
        KeyboardInterrupt: after saving a checkpoint.
    """
    # reading a state back trains flows as well, whose last digits hang on the number of threads
    with _one_thread():
        return _run(trainer, simulator, dataset, run, out, quiet)


def _run(
    trainer: Estimator, simulator: Simulator, dataset: Dataset, run: dict[str, Any], out: Path | None, quiet: bool
) -> dict[str, float]:
    folder = None if out is None else out / "checkpoint"
    behaviour, saved = None, None
    if folder is not None:
        behaviour = observe(simulator, dataset)
        saved = _load(folder, run, simulator, behaviour)
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
        return tensors, {
            "state_version": STATE_VERSION,
            "run": run,
            "behaviour": behaviour,
            "counted": now,
            **info,
        }

    def save() -> None:
        if folder is not None:
            save_state(folder, *whole)

    total, last_save = trainer.total, time.monotonic()
    if saved is not None and trainer.done:
        return counted
    # an interrupt may hit in the middle of an iteration: what is saved is always the state at the end of one
    whole = snapshot()
    with progress(trainer.title, total, start=trainer.iteration, quiet=quiet) as report:
        try:
            while not trainer.done:
                figures = trainer.step()
                whole = snapshot()
                shown = {k: v for k, v in figures.items() if k not in ("iteration", "seconds")}
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


def _load(
    folder: Path, run: dict[str, Any], simulator: Simulator, behaviour: Behaviour
) -> tuple[dict[str, torch.Tensor], dict[str, Any]] | None:
    """The state to go on from, if it is one of this run and of this simulator."""
    saved = load_state(folder)
    if saved is None:
        return None
    path, version = folder / STATE_FILE, saved[1].get("state_version")
    if version != STATE_VERSION:
        raise CheckpointMismatch(
            f"{path} was saved by another version of nfpde (a state of version {version}, this one goes on with "
            f"{STATE_VERSION}): fit into another folder"
        )
    load_state(folder, run)  # refuses other settings
    found = difference(saved[1]["behaviour"], behaviour, simulator)
    if found is not None:
        raise CheckpointMismatch(
            f"{path} was saved by a fit with another simulator of the same name:\n"
            f"  {found[0]}: saved {found[1]}, now {found[2]}\n"
            "Use the same simulator to go on (its function, and every number in it), or another folder to start afresh."
        )
    return saved
