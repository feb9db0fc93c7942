"""Recording benchmark data: robots drawn from a population, one episode of random commands each."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

import gymnasium
import mujoco
import numpy as np
from gymnasium.envs.mujoco.mujoco_env import MujocoEnv
from numpy.typing import NDArray

from nfpde.benchmarks.robots import Robot
from nfpde.benchmarks.targets import Target, draw_robots, population
from nfpde.dataset import Dataset, Episode, Metadata
from nfpde.errors import BadInput
from nfpde.sim import ModelWriter, model_hash
from nfpde.sim.quiet import quiet_mujoco
from nfpde.truth import Truth


def collect(
    robot: Robot, target: Target, *, episodes: int = 10, steps: int = 150, seed: int = 0
) -> tuple[Dataset, Truth]:
    """Record random episodes of robots whose parameters come from a population.

    Commands are uniform over the action space; an episode ends where the Gymnasium environment ends it (a fall), at
    the latest after `steps` control steps. The state is recorded in full, never the observation, which clips.

    Args:
        robot: which.
        target: the population.
        episodes: number of robots, one episode each.
        steps: longest episode, in control steps.
        seed: of robots, first states and commands.

    Returns:
        The recordings, and apart from them the robots' parameters.

    Raises:
        BadInput: an unknown target, a count below one, or a seed below zero.
    """
    if episodes < 1 or steps < 1:
        raise BadInput(f"episodes and steps must be at least 1, got {episodes} and {steps}")
    if seed < 0:
        raise BadInput(f"seed must be at least 0, got {seed}")
    rng = np.random.default_rng(seed)
    people = population(robot.space, target)
    xi = draw_robots(robot.space, people, episodes, rng)
    dataset = record(robot, xi, steps=steps, rng=rng)
    return dataset, Truth(robot.space, xi, dataset.names, people, dataset.content_hash())


def record(
    robot: Robot, xi: NDArray[np.float64], *, steps: int, rng: np.random.Generator, labels: Sequence[str] | None = None
) -> Dataset:
    """Record one random episode of a robot with each of the given parameter vectors.

    Args:
        robot: which.
        xi: parameters (E, D), in physical units.
        steps: longest episode, in control steps.
        rng: of first states and commands.
        labels: which physical robot each episode is of, E texts; None where every episode has its own.

    Returns:
        E episodes, named by their number.

    Raises:
        BadInput: the labels are not one for each episode.
    """
    if labels is not None and len(labels) != len(xi):
        raise BadInput(f"there are {len(labels)} labels for {len(xi)} parameter vectors; give one for each")
    with quiet_mujoco():
        env = gymnasium.make(robot.env_id).unwrapped
    if not isinstance(env, MujocoEnv):
        raise BadInput(f"{robot.env_id} is no MuJoCo environment")
    model = env.model
    model.opt.solver, model.opt.disableflags = robot.model.opt.solver, robot.model.opt.disableflags
    writer = ModelWriter(robot.model, robot.space)
    recordings = []
    for i, vector in enumerate(xi):
        writer.write(model, vector)
        recordings.append(_record(env, f"{i}", steps, rng, None if labels is None else labels[i]))
    env.close()
    return _with_metadata(recordings, robot)


def _record(env: MujocoEnv, name: str, steps: int, rng: np.random.Generator, label: str | None) -> Episode:
    env.reset(seed=int(rng.integers(2**31)))
    # Gymnasium adds noise to quaternions too; a recorded one has length 1
    mujoco.mj_normalizeQuat(env.model, env.data.qpos)
    mujoco.mj_forward(env.model, env.data)
    space = env.action_space
    states, commands = [_state(env)], []
    ended = False
    while not ended and len(commands) < steps:
        command = rng.uniform(space.low, space.high)  # type: ignore[attr-defined]
        ended = bool(env.step(command)[2])
        commands.append(command)
        states.append(_state(env))
    commands.append(commands[-1])  # no command acts after the last row
    qpos, qvel = (np.array(part) for part in zip(*states, strict=True))
    return Episode(name, env.dt * np.arange(len(states)), qpos, qvel, np.array(commands), label)


def _state(env: MujocoEnv) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return env.data.qpos.copy(), env.data.qvel.copy()


def _with_metadata(recordings: list[Episode], robot: Robot) -> Dataset:
    option = robot.model.opt
    facts = Metadata(
        model_hash=model_hash(robot.model),
        timestep=float(option.timestep),
        solver=mujoco.mjtSolver(option.solver).name.removeprefix("mjSOL_").title(),
        integrator=mujoco.mjtIntegrator(option.integrator).name.removeprefix("mjINT_"),
        versions={name: version(name) for name in ("mujoco", "gymnasium", "nfpde")},
        conventions={
            "body_mass": "body_inertia is scaled by the same ratio",
            "constants": "mj_setConst after every change of a parameter",
            "state": "qpos and qvel in full; warm start not recorded",
        },
        notes=f"{robot.env_id}, uniform random commands",
    )
    return Dataset(recordings, metadata=facts)
