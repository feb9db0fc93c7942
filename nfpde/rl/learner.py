"""Stable-Baselines3's SAC, run in rounds that can be repeated exactly. The only file that imports it."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium.wrappers import TransformObservation
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from torch import Tensor

from nfpde.checkpoint import flatten_state, restore_state
from nfpde.errors import BadInput, CheckpointMismatch
from nfpde.rl.actor import NotFinite
from nfpde.rl.numbers import whole_number
from nfpde.rl.policy import Policy
from nfpde.rl.replay import ReplayFiles

Report = Callable[[int, dict[str, float]], None]

REPORT_EVERY = 50
"""Steps between two reports of a round's figures."""


@dataclass(frozen=True)
class SacConfig:
    """Settings of soft actor-critic (Haarnoja et al., Soft Actor-Critic Algorithms and Applications, 2018)."""

    hidden: tuple[int, ...] = (256, 256)
    """Neurons of the hidden layers, in the actor and in both critics."""
    learning_rate: float = 3e-4
    """Of Adam, for actor, critics and entropy coefficient."""
    batch_size: int = 256
    """Transitions of a gradient step."""
    buffer_size: int = 1_000_000
    """Transitions kept; older ones are overwritten."""
    learning_starts: int = 1000
    """Control steps with random actions before learning starts."""
    train_every: int = 1
    """Control steps between updates."""
    gradient_steps: int = 1
    """Gradient steps of an update."""
    gamma: float = 0.99
    """Discount of a control step."""
    tau: float = 0.005
    """Share by which the target critics follow the critics, at each gradient step."""
    entropy: float | Literal["auto"] = "auto"
    """Entropy coefficient; "auto" learns it, towards an entropy of minus the number of actions."""

    def __post_init__(self) -> None:
        hidden: Any = self.hidden
        if not isinstance(hidden, Iterable):
            raise BadInput(f"SAC: hidden is {hidden!r}; give the neurons of each layer, as in (256, 256)")
        object.__setattr__(self, "hidden", tuple(whole_number(f"SAC: hidden[{i}]", n, 1) for i, n in enumerate(hidden)))
        for name in ("batch_size", "buffer_size", "train_every", "gradient_steps"):
            object.__setattr__(self, name, whole_number(f"SAC: {name}", getattr(self, name), 1))
        object.__setattr__(self, "learning_starts", whole_number("SAC: learning_starts", self.learning_starts, 0))
        for name, top in (("learning_rate", float("inf")), ("gamma", 1.0), ("tau", 1.0)):
            value = getattr(self, name)
            if not _is_number(value) or not 0 < value <= top:
                raise BadInput(f"SAC: {name} is {value!r}; it must lie in (0, {top}]")
            object.__setattr__(self, name, float(value))
        if self.entropy != "auto":
            if not _is_number(self.entropy) or not 0 < self.entropy < float("inf"):
                raise BadInput(f'SAC: entropy is {self.entropy!r}; it must be "auto" or a positive number')
            object.__setattr__(self, "entropy", float(self.entropy))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


class SacLearner:
    """An agent that learns in rounds; everything random in a round follows from the round's own seed.

    A round begins with a fresh episode. Its outcome depends only on the state before it and on its seed, so that a
    state saved between rounds is enough to go on exactly. Use inside `isolated_randomness`.

    Args:
        env: observations and actions are flat boxes.
        config: settings.
        steps: most control steps that will be taken; the buffer is no larger.
        seed: of the first weights.
        device: `cpu`, `cuda` or `auto`.

    Raises:
        BadInput: another kind of observation or action, or one without bounds.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], config: SacConfig, *, steps: int, seed: int = 0, device: str = "auto"
    ) -> None:
        _check_spaces(env)
        self.config = config
        env = _FiniteOnly(env, self.blown_up)
        seen: Any = env.observation_space
        # the networks compute in single precision anyway, and the buffer takes half the memory
        box = gymnasium.spaces.Box(seen.low.astype(np.float32), seen.high.astype(np.float32), dtype=np.float32)
        env = TransformObservation(env, lambda o: np.asarray(o, dtype=np.float32), box)
        self.model = SAC(
            "MlpPolicy",
            env,
            learning_rate=config.learning_rate,
            buffer_size=min(config.buffer_size, steps),
            learning_starts=config.learning_starts,
            batch_size=config.batch_size,
            tau=config.tau,
            gamma=config.gamma,
            train_freq=config.train_every,
            gradient_steps=config.gradient_steps,
            ent_coef=config.entropy,
            policy_kwargs={"net_arch": list(config.hidden)},
            seed=seed % 2**32,  # numpy's generator of old, which Stable-Baselines3 seeds too, takes no more
            device=device,
        )
        self.model.set_logger(Logger(None, []))

    @property
    def steps(self) -> int:
        """Control steps taken."""
        return self.model.num_timesteps

    def run_round(self, steps: int, seed: int, report: Report) -> list[float]:
        """Collect `steps` transitions and learn; returns of the episodes that ended.

        Raises:
            NotFinite: the learning blew up, or the environment gave an observation or a reward that is not finite.
        """
        model = self.model
        model.set_random_seed(seed)
        model._last_obs = None  # makes learn() begin an episode
        callback = _Callback(report)
        # no interval: nothing is logged, the logger only holds the last losses
        model.learn(steps, callback, log_interval=10**12, reset_num_timesteps=False)
        if not all(torch.isfinite(tensor).all() for tensor in self.state()[0].values()):  # nothing mends it any more
            raise self.blown_up(f"weights of the networks are not finite after {self.steps} control steps")
        return callback.returns

    def blown_up(self, what: str) -> NotFinite:
        """The error of a learning that diverged; `what` says how that shows."""
        return NotFinite(
            f"SAC: {what}: the learning blew up, not the simulation; use a smaller learning_rate (it is "
            f"{self.config.learning_rate:g}), or rewards of smaller size"
        )

    def state(self) -> tuple[dict[str, Tensor], Any]:
        """Weights, optimizers and counters; the transitions are saved by `ReplayFiles`."""
        model = self.model
        entropy = None if model.log_ent_coef is None else model.log_ent_coef.detach()
        return flatten_state(
            "sac",
            {
                "parameters": model.get_parameters(),
                "log_entropy": entropy,
                "steps": model.num_timesteps,
                "updates": model._n_updates,
                "episodes": model._episode_num,
            },
        )

    def restore(self, layout: Any, tensors: dict[str, Tensor], replay: ReplayFiles, ends: Sequence[int]) -> None:
        """Take over a saved state and its transitions; `ends` as in `ReplayFiles.load`.

        Raises:
            CheckpointMismatch: the networks differ.
            BadInput: files of transitions are missing or damaged.
        """
        model = self.model
        state = restore_state(layout, tensors)
        try:
            model.set_parameters(state["parameters"], exact_match=True, device=model.device)
        except (RuntimeError, ValueError) as error:
            raise CheckpointMismatch(f"the saved networks do not fit this environment: {error}") from None
        if model.log_ent_coef is not None:
            model.log_ent_coef.data.copy_(state["log_entropy"])
        model.num_timesteps, model._n_updates = state["steps"], state["updates"]
        model._episode_num = state["episodes"]
        replay.load(self.buffer, ends)

    @property
    def buffer(self) -> Any:
        """The replay buffer."""
        return self.model.replay_buffer

    def policy(self, environment: str) -> Policy:
        """The actor as it is now."""
        actor = self.model.policy.actor
        linear = [m for m in actor.latent_pi if isinstance(m, torch.nn.Linear)]
        layers = {**{f"hidden.{i}": m for i, m in enumerate(linear)}, "mean": actor.mu, "log_std": actor.log_std}
        weights: dict[str, Any] = {}
        for name, layer in layers.items():
            weights[f"{name}.weight"] = layer.weight.detach().cpu().numpy().copy()
            weights[f"{name}.bias"] = layer.bias.detach().cpu().numpy().copy()
        space: Any = self.model.action_space
        return Policy(weights, space.low, space.high, environment)


class _FiniteOnly(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Passes on what is finite: a NaN is told where it arises, not where it ends up."""

    def __init__(self, env: gymnasium.Env[Any, Any], blown_up: Callable[[str], NotFinite]) -> None:
        super().__init__(env)
        self.blown_up = blown_up

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        self._check("observation of a reset", observation)
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        if not np.isfinite(action).all():
            raise self.blown_up(f"the agent gave the action {action}")
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._check("observation of a step", observation)
        self._check("reward of a step", reward)
        return observation, reward, terminated, truncated, info

    def _check(self, what: str, numbers: Any) -> None:
        if not np.isfinite(numbers).all():
            name = self.spec.id if self.spec is not None else type(self.unwrapped).__name__
            raise NotFinite(f"environment {name}: the {what} is not finite: {numbers}")


class _Callback(BaseCallback):
    """Collects the returns of a round's episodes and reports its figures now and then."""

    def __init__(self, report: Report) -> None:
        super().__init__()
        self.report = report
        self.returns: list[float] = []

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                self.returns.append(float(info["episode"]["r"]))
        if self.num_timesteps % REPORT_EVERY == 0:
            values: dict[str, Any] = self.logger.name_to_value
            figures = {"return": float(np.mean(self.returns[-10:]))} if self.returns else {}
            names = {"critic": "train/critic_loss", "actor": "train/actor_loss", "entropy": "train/ent_coef"}
            figures |= {short: float(values[long]) for short, long in names.items() if long in values}
            self.report(self.num_timesteps, figures)
        return True


def round_seed(seed: int, index: int) -> int:
    """Seed of a training's round."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])


@contextmanager
def isolated_randomness(threads: int) -> Iterator[None]:
    """Stable-Baselines3 draws from global generators; give them and torch's settings back as they were."""
    python, numpy, before = random.getstate(), np.random.get_state(), torch.get_num_threads()  # noqa: NPY002
    cudnn = torch.backends.cudnn
    flags = cudnn.deterministic, cudnn.benchmark
    with torch.random.fork_rng():
        try:
            torch.set_num_threads(threads)
            yield
        finally:
            torch.set_num_threads(before)
            cudnn.deterministic, cudnn.benchmark = flags
            random.setstate(python)
            np.random.set_state(numpy)  # noqa: NPY002


def _check_spaces(env: gymnasium.Env[Any, Any]) -> None:
    observation, action = env.observation_space, env.action_space
    for what, space in (("observations", observation), ("actions", action)):
        if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
            raise BadInput(f"SAC needs {what} that are one row of real numbers, this environment has {space}")
    bounds: Sequence[Any] = (action.low, action.high)  # type: ignore[attr-defined]
    if not np.isfinite(bounds).all():
        raise BadInput(f"SAC needs bounded actions, this environment has {action}; set ctrlrange of every actuator")
