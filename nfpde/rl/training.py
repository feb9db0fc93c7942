"""One training in one folder: rounds of learning, an evaluation and a checkpoint after each."""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from nfpde.checkpoint import STATE_FILE, flatten_state, load_state, restore_state, save_state
from nfpde.errors import BadInput, CheckpointMismatch, SimulationDiverged
from nfpde.parameters import ParameterSpace
from nfpde.progress import Report, progress
from nfpde.rl.actor import BadAction, NotFinite
from nfpde.rl.behaviour import difference, observe
from nfpde.rl.history import Point, TrainResult, write_json
from nfpde.rl.learner import SacConfig, SacLearner, isolated_randomness, round_seed
from nfpde.rl.past import PastCommands, past_commands_of
from nfpde.rl.policy import Policy, load_policy
from nfpde.rl.randomize import Draws, RandomizedParameters
from nfpde.rl.replay import ReplayFiles
from nfpde.rl.scoring import Scoring
from nfpde.rl.settings import environment_settings, episode_limit
from nfpde.rl.tasks import Environment, make_environment
from nfpde.sim import model_hash
from nfpde.storage import alone_in

SETTINGS_VERSION = 2
"""Of what must be the same for a training to go on; one saved under another version does not."""

MOST_DIVERGED = 0.1
"""Share of a round's episodes that may diverge before training stops."""


@dataclass(frozen=True)
class Job:
    """What is to be done; see `train_sac` for each."""

    env: Environment
    model: Path | None
    steps: int
    seed: int
    target: NDArray[np.float64] | None
    target_space: ParameterSpace
    evaluation_every: int
    evaluation_episodes: int
    config: SacConfig
    device: str
    threads: int
    past_commands: int | None
    quiet: bool


class Training:
    """Trains one policy, going on with what its folder holds.

    Args:
        job: what is to be done.
        source: parameters of the training's episodes: a distribution, vectors (n, D) or None.
        space: what they mean.
        out: the folder.
        title: shown with the progress.
    """

    def __init__(self, job: Job, source: Any, space: ParameterSpace, out: Path, title: str) -> None:
        self.job = job
        self.source = source
        self.space = space
        self.out = out
        self.title = title
        self.replay = ReplayFiles(out / "replay")
        self.points: list[Point] = []
        self.seconds = 0.0
        self.saved: int | None = None  # control steps of the state on disk

    def run(self) -> TrainResult:
        """Train up to the job's number of steps.

        Raises:
            CheckpointMismatch: the folder holds another training.
            BadInput: an environment that cannot be used, a folder in which another process trains, or learning that
                blew up.
            SimulationDiverged: more than a tenth of a round's episodes blew up.
        """
        with isolated_randomness(self.job.threads), self._environments(), self._folder():
            self._begin()
            started = time.monotonic() - self.seconds
            with progress(self.title, self.job.steps, start=self.learner.steps, quiet=self.job.quiet) as report:
                try:
                    while self.learner.steps < self.job.steps:
                        self._round(report, started)
                except NotFinite as error:
                    raise BadInput(f"{error}; {self._left()}") from None
                except KeyboardInterrupt:
                    raise KeyboardInterrupt(f"training stopped; {self._kept()}") from None
            self.policy.save(self.out)
            result = self._result()
            write_json(result)
            return result

    @contextmanager
    def _environments(self) -> Iterator[None]:
        job = self.job
        self.target: RandomizedParameters | None = None
        self.training = RandomizedParameters(make_environment(job.env, job.model), self.source, self.space)
        try:
            self.past, inside = self._past_commands(), past_commands_of(self.training)
            if inside and inside != self.past:
                raise BadInput(
                    f"environment {self.training.label} has {inside} past commands in its observations already; leave "
                    f"past_commands out, or set it to {inside}"
                )
            if self.past and not inside:
                self.training.release()
                seen = PastCommands(self.training.env, self.past)
                self.training = RandomizedParameters(seen, self.source, self.space)
            if job.target is not None:
                bare = make_environment(job.env, job.model)
                seen = PastCommands(bare, self.past) if self.past and not inside else bare
                self.target = RandomizedParameters(seen, job.target, job.target_space)
            yield
        finally:
            self.training.close()
            if self.target is not None:
                self.target.close()

    @contextmanager
    def _folder(self) -> Iterator[None]:
        """The folder to itself, once the environments are seen to be of use: one for nothing is not made."""
        self.label = self.training.label
        longest = episode_limit(self.training)
        if longest is not None and self.job.evaluation_every < longest:
            raise BadInput(
                f"evaluation_every is {self.job.evaluation_every}; it must be at least an episode of {self.label}, "
                f"{longest} control steps: a round begins with a fresh episode"
            )
        self.here = self._scoring(self.training)
        self.there = None if self.target is None else self._scoring(self.target)
        self.identity = self._identity()
        with alone_in(self.out, "training"):
            yield

    def _scoring(self, env: RandomizedParameters) -> Scoring:
        return Scoring(env, self.job.evaluation_episodes, self.job.seed)

    def _past_commands(self) -> int:
        """What was asked for; or as the environment or a training to go on with has it; or what may be under way."""
        if self.job.past_commands is not None:
            return self.job.past_commands
        if inside := past_commands_of(self.training):
            return inside
        if (self.out / STATE_FILE).exists():
            with contextlib.suppress(BadInput):  # a policy that cannot be read is told elsewhere
                return load_policy(self.out).past_commands
        return 0 if self.source is None else self.training.pending_commands

    def _begin(self) -> None:
        job, saved = self.job, self._load()
        self.learner = SacLearner(self.training, job.config, steps=job.steps, seed=job.seed, device=job.device)
        if saved is None:
            self.replay.clean(self.learner.buffer.buffer_size, 0)  # of a training whose state is gone
            self.policy = self._policy()
            self.points = [self._judge([], 0)]
            return
        tensors, info = saved
        self.points = [Point.from_json(p) for p in info["points"]]
        if self.points[-1].step > job.steps:
            raise BadInput(
                f"{self.out} holds a training of {self.points[-1].step} control steps already, more than the "
                f"{job.steps} asked for"
            )
        self.seconds = info["seconds"]
        self.saved = self.points[-1].step
        self.learner.restore(info["learner"], tensors, self.replay, [p.step for p in self.points])
        self.policy = self._policy()

    def _load(self) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """The state to go on from, if it is one of this training."""
        saved = load_state(self.out)
        if saved is None:
            return None
        path, (tensors, info) = self.out / STATE_FILE, saved
        version = info.get("run", {}).get("schema_version")
        if version != SETTINGS_VERSION:
            raise CheckpointMismatch(
                f"{path} was saved by another version of nfpde (settings of version {version}, this one goes on with "
                f"{SETTINGS_VERSION}): train in another folder"
            )
        load_state(self.out, self.identity)  # refuses other settings
        before = restore_state(info["behaviour"], tensors)
        found = difference(before, observe(self.training, before["parameters"]))
        if found is not None:
            raise CheckpointMismatch(
                f"{path} was saved by another run:\n"
                f"  environment {self.label}, {found[0]}: saved {found[1]}, now {found[2]}\n"
                "Use the same environment to go on (rewards, observations, start states, ends of episodes), or another "
                "folder to start afresh."
            )
        return saved

    def _round(self, report: Report, started: float) -> None:
        job, learner = self.job, self.learner
        shown = {} if self.points[-1].target is None else {"target": str(self.points[-1].target)}
        first, diverged = learner.steps, self.training.diverged_episodes
        returns = learner.run_round(
            min(job.evaluation_every, job.steps - first),
            round_seed(job.seed, len(self.points)),
            lambda step, figures: report(step, **figures, **shown),
        )
        diverged = self.training.diverged_episodes - diverged
        if diverged > MOST_DIVERGED * max(len(returns), 10):
            raise SimulationDiverged(
                f"the simulation diverged in {diverged} of the {len(returns)} episodes up to control step "
                f"{learner.steps}: use a smaller timestep in the model, or tighter bounds; {self._left()}"
            )
        self.policy = self._policy()
        self.points.append(self._judge(returns, diverged))
        self.seconds = time.monotonic() - started
        self.replay.add(learner.buffer, first, learner.steps)
        tensors, layout = learner.state()
        seen, behaviour = flatten_state("behaviour", self.here.behaviour)
        info = {
            "run": self.identity,
            "learner": layout,
            "behaviour": behaviour,
            "points": [asdict(p) for p in self.points],
            "seconds": self.seconds,
        }
        save_state(self.out, {**tensors, **seen}, info)
        self.saved = learner.steps
        self.replay.clean(learner.buffer.buffer_size, learner.steps)
        self.policy.save(self.out)
        write_json(self._result())

    def _policy(self) -> Policy:
        return replace(self.learner.policy(self.label), past_commands=self.past)

    def _kept(self) -> str:
        """What a training that stops leaves behind."""
        if self.saved is None:
            return "nothing was saved yet: the same call starts afresh"
        return f"{self.out} holds the state after {self.saved} control steps, from which the same call goes on"

    def _left(self) -> str:
        """The same where the same call would end in the same way."""
        if self.saved is None:
            return "nothing was saved"
        return f"{self.out} holds the state after {self.saved} control steps; other settings need another folder"

    def _judge(self, returns: list[float], diverged: int) -> Point:
        """Evaluate the policy where it trains and in the target."""
        try:
            training = self.here.score(self.policy)
            target = None if self.there is None else self.there.score(self.policy)
        except BadAction as error:
            raise self.learner.blown_up(str(error)) from None
        return Point(
            step=self.learner.steps,
            exploring=float(np.mean(returns)) if returns else None,
            episodes=len(returns),
            diverged=diverged,
            training=training,
            target=target,
        )

    def _result(self) -> TrainResult:
        return TrainResult(self.out, self.identity, tuple(self.points), self.policy, self.seconds)

    def _identity(self) -> dict[str, Any]:
        """What must be the same for a training to go on."""
        job = self.job
        return {
            "schema_version": SETTINGS_VERSION,
            **environment_settings(self.training),
            "model": model_hash(self.training.nominal_model),
            "space": self.space.to_json(),
            "parameters": _digest(self.source),
            "target": None if job.target is None else {**job.target_space.to_json(), "xi": job.target.tolist()},
            "seed": job.seed,
            "evaluation_every": job.evaluation_every,
            "evaluation_episodes": job.evaluation_episodes,
            "hyperparameters": asdict(job.config),
        }


def _digest(source: Any) -> str:
    """Fingerprint of what parameters are drawn from."""
    if source is None:
        return "nominal"
    values = source.sample(64, seed=0) if isinstance(source, Draws) else source
    text = " ".join(f"{v:.6e}" for v in np.asarray(values).ravel())
    return hashlib.sha256(text.encode()).hexdigest()
