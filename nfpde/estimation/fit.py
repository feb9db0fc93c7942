"""Fitting a distribution: one call from recordings and a simulator to the result."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nfpde.dataset import Dataset
from nfpde.distribution import ParameterDistribution
from nfpde.errors import BadInput
from nfpde.estimation.config import NfpdeConfig, TrajectoryConfig
from nfpde.estimation.nfpde import NfpdeTrainer
from nfpde.estimation.result import FitResult, versions
from nfpde.estimation.run import run_estimator
from nfpde.estimation.trajectory import make_problem
from nfpde.estimation.trajectory.fit import fit_trajectory
from nfpde.estimation.trajectory.problem import computed_channels
from nfpde.flow import build_flow
from nfpde.losses import increment_scale
from nfpde.sim import OnDevice, Simulator
from nfpde.storage import alone_in

Method = Literal["softmax", "cai", "trajectory"]

CONFIGS: dict[str, type] = {"softmax": NfpdeConfig, "cai": NfpdeConfig, "trajectory": TrajectoryConfig}
"""The settings class of every method."""


def fit(
    simulator: Simulator,
    dataset: Dataset,
    *,
    method: Method = "trajectory",
    config: NfpdeConfig | TrajectoryConfig | None = None,
    resolution: ArrayLike | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    quiet: bool = False,
) -> FitResult:
    """Fit a distribution over the simulator's parameters to recordings of one or many robots.

    Args:
        simulator: predicts; its `space` holds the parameters.
        dataset: recordings that fit the simulator.
        method: `trajectory`, which knows that a robot keeps its parameters for an episode, learns the noise, and needs
            far fewer simulations; or, for comparison, `softmax` (Eq. 11) or `cai` (Eq. 10) of Takano et al., IROS
            2024, Algorithm 1, which take every transition for a robot of its own. With `softmax` the temperature
            beta is found from the data unless the settings give it: see `next_beta`.
        config: settings of the method: `TrajectoryConfig` or `NfpdeConfig`; None for the defaults.
        resolution: with `trajectory`, the smallest step that the sensors show: one number, or one for each channel of
            a state difference (ndiff,), in the recorded units. No residual is believed below its rounding; where the
            recordings are too few to tell any noise it is all that is known of it.
        seed: of everything random, from 0 to 2^63 - 1; equal seeds give equal results.
        out: folder for checkpoints and results. A run that was interrupted or killed goes on from there, to the
            same numbers as one that never stopped; a finished one is read back.
        quiet: no progress on the error stream.

    Raises:
        BadInput: settings, windows without what the simulator needs, several models with `trajectory`, velocities that
            were computed from positions with another method, or another fit at work in `out`.
        BadDataset: recordings that do not fit into the memory with `trajectory`, or are too short, or too few to tell
            their noise from the parameters.
        CheckpointMismatch: `out` belongs to another run, or to another simulator by what it does.
        SimulationDiverged: every simulation did, of all recordings or with `trajectory` of a robot's.
        KeyboardInterrupt: after saving a checkpoint.
    """
    if method not in get_args(Method):
        raise BadInput(f"no method is called {method!r}; there are: {', '.join(get_args(Method))}")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
        raise BadInput(f"seed is {seed!r}; it must be an integer from 0 to {2**63 - 1}")
    seed = int(seed)
    settings: NfpdeConfig | TrajectoryConfig = CONFIGS[method]() if config is None else config
    if not isinstance(settings, CONFIGS[method]):
        raise BadInput(f"the method {method} takes a {CONFIGS[method].__name__}, got a {type(config).__name__}")
    if resolution is not None and not isinstance(settings, TrajectoryConfig):
        raise BadInput(f"resolution means nothing to the method {method}; leave it out, or take trajectory")
    if simulator.jumps and method == "trajectory":
        names = ", ".join(simulator.space.parameters[i].name for i in simulator.jumps)
        raise BadInput(
            f"predictions jump along {names}, and the method trajectory follows slopes: take softmax, or fit each "
            "model by a simulator of its own"
        )
    dataset = simulator.prepare(dataset)
    if method != "trajectory":
        _check_measured(simulator, dataset, method)
    run = {
        "method": method,
        "config": asdict(settings),
        "seed": seed,
        "space": simulator.space.to_json(),
        "simulator": simulator.identity(),
        "dataset": dataset.content_hash(),
    }
    if resolution is not None:
        run["resolution"] = np.asarray(resolution).tolist()
    if out is None:
        return _fitted(simulator, dataset, settings, resolution, seed, run, None, quiet)
    folder = Path(out)
    with alone_in(folder, "fitting"):
        result = _fitted(simulator, dataset, settings, resolution, seed, run, folder, quiet)
        result.save(folder)
    return result


def _check_measured(simulator: Simulator, dataset: Dataset, method: Method) -> None:
    """Refuse velocities that nobody measured where every transition starts from the recorded ones.

    They hold the position after them, which the transition is to predict, and half of what the command before them
    did: without their own errors in the loss as with them, what is found may be off by a factor of two.
    """
    computed = computed_channels(simulator, dataset)
    if computed.any():
        names = [c for c, yes in zip(simulator.states.channels, computed, strict=True) if yes]
        raise BadInput(
            f"{', '.join(names)}: computed from positions, and the method {method} starts every transition from the "
            "recorded velocities: take trajectory, which believes the positions alone"
            f"{' (each model by a simulator of its own)' if simulator.jumps else ''}, or record velocities"
        )


def _fitted(
    simulator: Simulator,
    dataset: Dataset,
    settings: NfpdeConfig | TrajectoryConfig,
    resolution: ArrayLike | None,
    seed: int,
    run: dict[str, Any],
    out: Path | None,
    quiet: bool,
) -> FitResult:
    if not isinstance(settings, TrajectoryConfig):
        return _fit_transitions(simulator, dataset, settings, seed, run, out, quiet)
    problem = make_problem(simulator, dataset, settings.horizon, resolution)
    problem.check_memory()
    run["computed"] = [c for c, yes in zip(simulator.states.channels, problem.computed, strict=True) if yes]
    return fit_trajectory(problem, dataset, settings, seed, run, out, quiet)


def _fit_transitions(
    simulator: Simulator,
    dataset: Dataset,
    config: NfpdeConfig,
    seed: int,
    run: dict[str, Any],
    out: Path | None,
    quiet: bool,
) -> FitResult:
    dt = dataset.control_dt
    history, past = simulator.history_steps(dt), simulator.past_steps(dt)
    windows = dataset.windows(config.horizon, stride=1, history=history, past=past)
    unit = np.ones(simulator.states.ndiff)
    scale = increment_scale(simulator.states, windows) if config.scale == "increment" else unit

    def losses(xi: NDArray[np.float64], batch: NDArray[np.intp]) -> OnDevice:
        return simulator.losses_on_device(xi, windows[batch], scale)

    channels = simulator.states.ndiff * config.horizon
    trainer = NfpdeTrainer(losses, len(windows), channels, simulator.space, run["method"], config, seed)
    counted = run_estimator(trainer, simulator, dataset, run, out, quiet)
    flow = trainer.flow
    start = build_flow(
        flow.features, flow.kind, hidden_features=flow.hidden_features, transforms=flow.transforms, seed=seed
    )
    return FitResult(
        ParameterDistribution(simulator.space, flow),
        ParameterDistribution(simulator.space, start),
        trainer.history,
        {**run, "transitions": len(windows), "episodes": len(dataset), **counted, "versions": versions()},
    )
