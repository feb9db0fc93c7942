"""Recording benchmark data: robots drawn from a population, one episode of random commands each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.metadata import version

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.benchmarks.hidden import Hidden
from nfpde.benchmarks.robots import Robot
from nfpde.benchmarks.sensing import with_noise
from nfpde.benchmarks.targets import Target, draw_robots, population
from nfpde.dataset import Dataset, Episode, Metadata
from nfpde.errors import BadInput, SimulationDiverged
from nfpde.live import LivePhysics, PhysicsDiverged
from nfpde.parameters import ParameterSpace
from nfpde.sim import model_hash
from nfpde.sim.quiet import quiet_mujoco
from nfpde.truth import Truth


def collect(
    robot: Robot,
    target: Target,
    *,
    episodes: int = 10,
    steps: int = 150,
    seed: int = 0,
    robots: int | None = None,
    effects: Sequence[Hidden] = (),
    noise: float = 0.0,
) -> tuple[Dataset, Truth]:
    """Record random episodes of robots whose parameters come from a population.

    Commands are uniform over the action space; an episode ends where the Gymnasium environment ends it (a fall), at
    the latest after `steps` control steps. The state is recorded in full, never the observation, which clips.

    Args:
        robot: which.
        target: the population.
        episodes: number of episodes.
        steps: longest episode, in control steps.
        seed: of robots, first states and commands.
        robots: number of robots, which take the episodes in turn; None for one robot an episode.
        effects: what all robots have and their model lacks; see `hide`.
        noise: standard deviation of white noise on every measured state, in those of each channel over the recordings.

    Returns:
        The recordings, and apart from them the robots' parameters, those of effects last. The population is told where
        there are no effects.

    Raises:
        BadInput: an unknown target, a count below one, more robots than episodes, a seed or noise below zero.
        BadEffect, BadParameter: an effect that cannot act in the robot's environment, or one that is hidden twice.
        SimulationDiverged: an episode blew up.
    """
    count = episodes if robots is None else robots
    if episodes < 1 or steps < 1 or count < 1:
        raise BadInput(f"episodes, steps and robots must be at least 1, got {episodes}, {steps} and {count}")
    if count > episodes:
        raise BadInput(f"{count} robots need as many episodes at least, got {episodes}")
    if seed < 0:
        raise BadInput(f"seed must be at least 0, got {seed}")
    if not 0 <= noise < math.inf:
        raise BadInput(f"noise must be a share of at least 0, got {noise:g}")
    rng = np.random.default_rng(seed)
    people = population(robot.space, target)
    drawn = draw_robots(robot.space, people, count, rng)
    space = robot.space + [p for hidden in effects for p in hidden.effect.parameters]
    values = [v for hidden in effects for v in hidden.values]
    turn = np.arange(episodes) % count
    xi = np.hstack([drawn, np.tile(values, (count, 1))])[turn]
    labels = None if robots is None else [f"{i}" for i in turn]
    clean = record(robot, xi, steps=steps, rng=rng, labels=labels, space=space)
    dataset, _ = with_noise(robot.model, clean, noise, seed)
    return dataset, Truth(space, xi, dataset.names, None if effects else people, dataset.content_hash())


def record(
    robot: Robot,
    xi: NDArray[np.float64],
    *,
    steps: int,
    rng: np.random.Generator,
    labels: Sequence[str] | None = None,
    space: ParameterSpace | None = None,
) -> Dataset:
    """Record one random episode of a robot with each of the given parameter vectors.

    Args:
        robot: which.
        xi: parameters (E, D), in physical units.
        steps: longest episode, in control steps.
        rng: of first states and commands.
        labels: which physical robot each episode is of, E texts; None where every episode has its own.
        space: what the vectors mean, effects included; None for the robot's own space.

    Returns:
        E episodes, named by their number.

    Raises:
        BadInput: the labels are not one for each episode.
        BadEffect: an effect of the space cannot act in the robot's environment.
        SimulationDiverged: an episode blew up; names its parameters.
    """
    if labels is not None and len(labels) != len(xi):
        raise BadInput(f"there are {len(labels)} labels for {len(xi)} parameter vectors; give one for each")
    with quiet_mujoco():
        env = gymnasium.make(robot.env_id).unwrapped
    space = robot.space if space is None else space
    recordings = []
    try:
        physics = LivePhysics(env, space, observes=False)
        for i, vector in enumerate(space.check(xi)):
            physics.write(vector)
            try:
                recordings.append(_record(physics, f"{i}", steps, rng, None if labels is None else labels[i]))
            except PhysicsDiverged:
                shown = ", ".join(f"{name}={value:g}" for name, value in zip(space.names, vector, strict=True))
                raise SimulationDiverged(f"{robot.name}: the recording of episode {i} blew up, with {shown}") from None
    finally:
        env.close()
    return _with_metadata(recordings, robot)


def _record(physics: LivePhysics, name: str, steps: int, rng: np.random.Generator, label: str | None) -> Episode:
    env = physics.env
    env.reset(seed=int(rng.integers(2**31)))
    # Gymnasium adds noise to quaternions too; a recorded one has length 1
    mujoco.mj_normalizeQuat(env.model, env.data.qpos)
    mujoco.mj_forward(env.model, env.data)
    states, commands = [physics.measured()], []
    ended = False
    while not ended and len(commands) < steps:
        command = rng.uniform(env.action_space.low, env.action_space.high)
        ended = bool(env.step(command)[2])
        commands.append(command)
        states.append(physics.measured())
    commands.append(commands[-1])  # no command acts after the last row
    qpos, qvel = np.split(np.array(states), [env.model.nq], axis=1)
    return Episode(name, physics.control_dt * np.arange(len(states)), qpos, qvel, np.array(commands), label)


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
