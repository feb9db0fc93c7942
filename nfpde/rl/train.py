"""Train a policy on parameters drawn from a distribution, and see what it is worth in the target."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import torch
from numpy.typing import ArrayLike

from nfpde.errors import BadInput
from nfpde.parameters import ParameterSpace
from nfpde.rl.history import TrainResult, write_json
from nfpde.rl.learner import SacConfig
from nfpde.rl.numbers import seed_number, whole_number
from nfpde.rl.plot import plot_returns
from nfpde.rl.randomize import Draws, check_source
from nfpde.rl.tasks import TASKS, Environment
from nfpde.rl.training import Job, Training
from nfpde.truth import Truth

_SMALL = SacConfig(hidden=(64, 64), learning_rate=1e-3, batch_size=128, learning_starts=500, gamma=0.98)

PRESETS = {TASKS[name]: _SMALL for name in ("pendulum", "payload")}
"""Hyperparameters of environments for which the defaults are needlessly slow, by Gymnasium id."""


def train_sac(
    env: Environment,
    distribution: Draws | ArrayLike | None,
    *,
    steps: int,
    out: Path | str,
    seed: int = 0,
    target: Truth | ArrayLike | None = None,
    space: ParameterSpace | None = None,
    evaluation_every: int = 5000,
    evaluation_episodes: int = 20,
    hyperparameters: SacConfig | None = None,
    nominal_baseline: bool = False,
    model: Path | str | None = None,
    device: Literal["auto", "cpu", "cuda"] = "auto",
    threads: int = 1,
    past_commands: int | None = None,
    quiet: bool = False,
) -> TrainResult:
    """Train soft actor-critic on a robot whose parameters are drawn anew for every episode.

    Training goes in rounds of `evaluation_every` control steps. After each round the policy is evaluated, without
    exploration, on parameters from the distribution and on the target's; then everything is saved. The same call
    goes on with what it finds in `out`: after a kill or Ctrl-C from the last round, and with more `steps` beyond the
    end. On the same machine, device and number of threads, a training that was interrupted ends in the same weights
    to the last bit as one that was not. (Going on beyond the end does so where the old `steps` was a multiple of
    `evaluation_every`.) A round begins with a fresh episode; one under way at its end is cut and not counted.

    A training goes on in the environment that it began in only: in one with the same arguments, wrappers, spaces and
    length of episodes, whose start states, observations, rewards and ends are the same in two short test episodes. An
    environment that carries something over from one episode to the next is refused, be it running statistics
    (`NormalizeObservation`, `NormalizeReward`) or random numbers that `reset(seed=...)` does not seed: its evaluations
    could not be compared, and no training could go on exactly.

    `out` then holds `policy.safetensors` and `policy.json` (read by `load_policy`), `train.json` (settings and all
    returns), `returns.png` and the state to go on from (`state.safetensors`, `state.json`, `replay/`). With
    `nominal_baseline` the same but for the picture is in `nominal/`; `train.json` and `returns.png` of `out` show both.

    Args:
        env: short name, Gymnasium id or maker of a MuJoCo environment, see `make_environment`.
        distribution: what parameters are drawn from, for example a fitted `ParameterDistribution`; or vectors (n, D)
            or one vector (D,) with `space`; or None for the nominal model, no randomization.
        steps: control steps in all, a multiple of the hyperparameters' `train_every`.
        out: folder for the results.
        seed: of everything random, from 0 to 2**63 - 1.
        target: parameters of the real robots: a `Truth`, whose recorded episodes of one robot count once, or vectors
            (n, D) of the distribution's space; episodes take them in turn. Of more robots than `evaluation_episodes`
            as many are evaluated, the same every time, one from each of equal stretches of the list; the result says
            how many. None evaluates on the distribution only.
        space: what vectors mean, where `distribution` is not one that knows.
        evaluation_every: control steps of a round, at least those of an episode; a multiple of `train_every`.
        evaluation_episodes: episodes of each evaluation, at least 2; as many as there are robots for all of them.
        hyperparameters: of SAC; None for those of `PRESETS` where the environment is among them, else the defaults.
        nominal_baseline: train a second policy, on the nominal model, with the same settings, and compare both. It sees
            past commands only where `past_commands` asks for them or the environment's observations hold them.
        model: MJCF file in place of the environment's own.
        device: for the networks: `cpu`, `cuda`, or `auto` for CUDA where there is one.
        past_commands: how many of its own last actions the policy sees behind the environment's observation, oldest
            first (`PastCommands`; `Controller` keeps them on the robot). None for as many as may be under way under
            the delays and lags of the distribution's effects, without which a policy cannot know what its robot is
            about to do (none where there are no such effects), or as the training has that is to go on.
        threads: torch's, while training. These networks are so small that more threads rarely pay, and on a busy
            machine they cost dearly.
        quiet: show no progress.

    Raises:
        BadInput, BadParameter, BadEffect, BadModel: what cannot be used, and why; BadInput also where the learning
            blows up, an observation or a reward is not finite, or another process trains in `out`.
        CheckpointMismatch: `out` holds another training, or one in another environment; names the differences.
        SimulationDiverged: more than a tenth of a round's episodes blew up.

    Example:
        A policy for a pendulum whose mass and damping were estimated::

            fitted = nfpde.ParameterDistribution.load("fit")
            result = train_sac("pendulum", fitted, steps=10_000, out="policy", target=[[1.1, 0.08]])
            print(result.summary())
            torque = load_policy("policy").predict(observation)
    """
    truth, vectors = (target.space, target.robots) if isinstance(target, Truth) else (None, target)
    if isinstance(vectors, Draws):
        raise BadInput("target takes vectors (n, D) or a Truth, the robots the policy is for, not a distribution")
    source, space = check_source(distribution, truth if distribution is None and space is None else space)
    vectors, target_space = check_source(vectors, truth or space)
    steps, seed = whole_number("steps", steps, 1), seed_number(seed)
    evaluation_every = whole_number("evaluation_every", evaluation_every, 1)
    evaluation_episodes = whole_number("evaluation_episodes", evaluation_episodes, 2)
    threads = whole_number("threads", threads, 1)
    if past_commands is not None:
        past_commands = whole_number("past_commands", past_commands, 0)
    _check_device(device)
    config = hyperparameters
    if config is None:
        config = PRESETS.get(TASKS.get(env, env), SacConfig()) if isinstance(env, str) else SacConfig()
    elif not isinstance(config, SacConfig):
        raise BadInput(
            f"hyperparameters is a {type(config).__name__}; give a SacConfig, as in SacConfig(hidden=(64, 64))"
        )
    for name, value in (("steps", steps), ("evaluation_every", evaluation_every)):
        if value % config.train_every:
            raise BadInput(f"{name} is {value}; it must be a multiple of train_every, {config.train_every}")
    job = Job(
        env=env,
        model=None if model is None else Path(model),
        steps=steps,
        seed=seed,
        target=vectors,
        target_space=target_space,
        evaluation_every=evaluation_every,
        evaluation_episodes=evaluation_episodes,
        config=config,
        device=device,
        threads=threads,
        past_commands=past_commands,
        quiet=quiet,
    )
    out = Path(out)
    result = Training(job, source, space, out, "Training").run()
    if nominal_baseline:
        nominal = Training(job, None, space, out / "nominal", "Training on the nominal model").run()
        result = result.with_baseline(nominal)
        write_json(result)
    plot_returns(result, out / "returns.png")
    return result


def _check_device(device: str) -> None:
    if device not in ("auto", "cpu", "cuda"):
        raise BadInput(f"device is {device!r}; networks train on 'cpu', 'cuda' or 'auto' (CUDA if there is one)")
    if device == "cuda" and not torch.cuda.is_available():
        raise BadInput("device 'cuda': PyTorch finds no CUDA device; use device='cpu', or 'auto'")
