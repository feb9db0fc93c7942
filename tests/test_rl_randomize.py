"""RandomizedParameters: draws, physics equal to MujocoSimulator's, effects in the live environment, errors."""

from typing import Any, ClassVar

import gymnasium
import mujoco
import numpy as np
import pytest

from nfpde.dataset import Windows
from nfpde.effects import Effect, Quantity, effect, registry
from nfpde.effects.effect import Array, World
from nfpde.errors import BadEffect, BadInput, BadParameter, SpaceMismatch
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import RandomizedParameters
from nfpde.sim import MujocoSimulator

MASS = Parameter("body_mass", "thigh", 2.0, 6.0)
DAMPING = Parameter("dof_damping", "leg_joint", 0.1, 3.0)
DELAY = effect("actuation_delay", "*", delay=(0.0, 0.05))
CLOCK = effect("time_scale", ratio=(0.8, 1.25))
LAG = effect("actuator_lag", "thigh_joint", time_constant=(0.0, 0.1))
PLAY = effect("backlash", "leg_joint", width=(0.0, 0.2))
STRIBECK = effect("stribeck_friction", "thigh_joint", coulomb=(0.0, 2.0), static=(0.0, 4.0), speed=(0.05, 1.0))


def space_of(*parts: Parameter | Effect) -> ParameterSpace:
    return ParameterSpace([p for part in parts for p in (part.parameters if isinstance(part, Effect) else [part])])


SPACE = space_of(MASS, DAMPING, DELAY, STRIBECK)
XI = np.array([4.7, 0.6, 0.013, 0.9, 2.1, 0.3])


class Uniform:
    """A distribution: uniform over the box."""

    def __init__(self, space: ParameterSpace) -> None:
        self.space = space

    def sample(self, n: int, seed: int = 0) -> Array:
        return self.space.uniform(n, np.random.default_rng(seed))


class Push(Effect):
    """A constant force on every degree of freedom, and a memory of the steps since the start."""

    name = "test_push"
    kind = None
    quantities = (Quantity("force", "N", -10.0, 10.0, neutral=0.0),)
    default_bounds: ClassVar[dict[str, tuple[float, float]]] = {"force": (-5.0, 5.0)}
    sentence = "Pushes."

    def step(self, world: World, rows: Any, values: Array) -> None:
        steps = world.memory.setdefault("steps", np.zeros(len(world.qpos)))
        world.qfrc_applied[rows] += values * (1 + 0.01 * steps[rows, None])
        steps[rows] += 1


class Miscalibrated(Effect):
    """Every position sensor reads too much by a constant."""

    name = "test_offset"
    kind = None
    quantities = (Quantity("offset", "rad", -1.0, 1.0, neutral=0.0),)
    default_bounds: ClassVar[dict[str, tuple[float, float]]] = {"offset": (-0.5, 0.5)}
    sentence = "Sensors are off."

    def to_measured(self, state: Array, values: Array) -> Array:
        out = state.copy()
        out[..., : state.shape[-1] // 2] += values[..., :1]
        return out

    def to_simulated(self, state: Array, values: Array) -> Array:
        return self.to_measured(state, -values)


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """The effects of this file are known while its tests run."""
    for e in (Push, Miscalibrated):
        monkeypatch.setitem(registry._REGISTRY, e.name, e)


def drive(env: gymnasium.Env, actions: Array, **reset: Any) -> Array:
    """True states (T+1, nq+nv) along an episode that is not allowed to end."""
    env.reset(**reset)
    data: Any = env.unwrapped
    states = [data.state_vector()]
    for a in actions:
        _, _, terminated, truncated, _ = env.step(a)
        assert not terminated
        assert not truncated
        states.append(data.state_vector())
    return np.array(states)


def simulate(model: Any, space: ParameterSpace, xi: Array, states: Array, actions: Array, dt: float) -> Array:
    """What MujocoSimulator says of the same episode, (T, nq+nv)."""
    simulator = MujocoSimulator(model, space, check_influence=False)
    past = np.tile(actions[0], (simulator.history_steps(dt), 1))
    windows = Windows(
        state=np.tile(states[0], (1, len(actions) + 1, 1)),
        ctrl=actions[None],
        history=past[None],
        control_dt=dt,
        nq=model.nq,
        nv=model.nv,
        episode=np.zeros(1, np.intp),
        row=np.zeros(1, np.intp),
    )
    return simulator.predict(xi[None], windows)[0, 0]


def hopper(source: Any, space: ParameterSpace | None = None) -> RandomizedParameters:
    return RandomizedParameters(gymnasium.make("Hopper-v5", terminate_when_unhealthy=False), source, space)


@pytest.mark.parametrize(
    ("space", "xi"),
    [
        (space_of(MASS, DAMPING), XI[:2]),
        (space_of(MASS, DAMPING, DELAY), XI[:3]),
        (space_of(CLOCK, DELAY, LAG), np.array([1.2, 0.017, 0.03])),
        (space_of(PLAY, CLOCK), np.array([0.07, 0.85])),
        (SPACE, XI),
        (space_of(MASS, Push()), np.array([3.0, -1.7])),
        (space_of(DAMPING, Miscalibrated()), np.array([2.0, 0.1])),
    ],
    ids=["fields", "delay", "clock, delay and lag", "play and clock", "delay and Stribeck", "force", "sensor"],
)
def test_live_trajectory_equals_the_simulator(space, xi):
    """Two episodes of 60 commands agree with MujocoSimulator to 1e-10: same engine, same steps, rounding only."""
    env = hopper(xi, space)
    nominal = gymnasium.make("Hopper-v5").unwrapped.model  # type: ignore[attr-defined]
    actions = np.random.default_rng(3).uniform(-1, 1, (60, 3))
    for seed in (1, 2):
        states = drive(env, actions, seed=seed)
        sensor = 0.1 if "test_offset.offset" in space.names else 0.0
        offset = sensor * (np.arange(12) < 6)
        expected = simulate(nominal, space, xi, states + offset, actions, 0.008)
        np.testing.assert_allclose(states[1:] + offset, expected, rtol=0, atol=1e-10)


def test_humanoid_uses_the_solver_of_load_model():
    """Humanoid asks for PGS; here it runs with Newton, as in MujocoSimulator, and agrees with it."""
    space = ParameterSpace([Parameter("body_mass", "torso", 4.0, 12.0)])
    env = RandomizedParameters(gymnasium.make("Humanoid-v5", terminate_when_unhealthy=False), [11.0], space)
    nominal = gymnasium.make("Humanoid-v5").unwrapped.model  # type: ignore[attr-defined]
    assert nominal.opt.solver == mujoco.mjtSolver.mjSOL_PGS
    actions = np.random.default_rng(0).uniform(-0.4, 0.4, (20, 17))
    states = drive(env, actions, seed=0)
    # contacts between limbs amplify rounding; 1e-8 is far below what another solver or mass gives (> 1e-3)
    np.testing.assert_allclose(
        states[1:], simulate(nominal, space, np.array([11.0]), states, actions, 0.015), rtol=0, atol=1e-8
    )


@pytest.mark.parametrize("name", SPACE.names)
def test_every_parameter_changes_the_motion(name):
    """Moving one parameter of the space by a third of its width moves the robot."""
    moved = XI.copy()
    i = SPACE.names.index(name)
    moved[i] = SPACE.low[i] + (XI[i] - SPACE.low[i] + SPACE.width[i] / 3) % SPACE.width[i]
    actions = np.random.default_rng(1).uniform(-1, 1, (40, 3))
    first, second = (drive(hopper(xi, SPACE), actions, seed=0) for xi in (XI, moved))
    np.testing.assert_array_equal(first[0], second[0])
    assert np.abs(first - second).max() > 1e-5


def test_draws_repeat_under_a_seed_and_differ_between_resets():
    """A seeded reset fixes all draws after it; without a seed every reset draws anew."""
    env = hopper(Uniform(SPACE))

    def run(seed: int, n: int = 300) -> Array:
        first = env.reset(seed=seed)[1]["parameters"]
        rest = [env.reset()[1]["parameters"] for _ in range(n - 1)]
        return np.array([list(p.values()) for p in [first, *rest]])

    a, b, c = run(5), run(5), run(6)
    np.testing.assert_array_equal(a, b)
    assert len(np.unique(a[:, 0])) == 300  # beyond one block, no draw comes twice
    assert not np.isin(c[:, 0], a[:, 0]).any()
    # 300 uniform draws: the mean of the scaled values has standard deviation 0.29 / sqrt(300 * 6) = 0.007
    assert abs(((a - SPACE.low) / SPACE.width).mean() - 0.5) < 5 * 0.007


def test_start_states_do_not_depend_on_the_parameters():
    """The same seed gives the same start states whatever the parameters are drawn from."""
    one, other = hopper(Uniform(SPACE)), hopper(XI, SPACE)
    for seed in (0, None, None):
        first, second = one.reset(seed=seed)[0], other.reset(seed=seed)[0]
        np.testing.assert_array_equal(first, second)


def test_samples_are_drawn_one_an_episode():
    """An array of samples: each episode has one of its rows, and all rows come."""
    samples = Uniform(SPACE).sample(4)
    env = hopper(samples, SPACE)
    seen = [list(env.reset(seed=i)[1]["parameters"].values()) for i in range(40)]
    assert {tuple(s) for s in seen} == {tuple(s) for s in samples.tolist()}


def test_parameters_in_the_model_and_in_info():
    """The live model holds the drawn numbers, inertia scaled and derived constants recomputed; info names them."""
    env = hopper(Uniform(space_of(MASS, DAMPING)))
    model: Any = env.unwrapped.model  # type: ignore[attr-defined]
    nominal = gymnasium.make("Hopper-v5").unwrapped.model  # type: ignore[attr-defined]
    _, info = env.reset(seed=1)
    thigh = model.body("thigh").id
    mass = info["parameters"]["body_mass:thigh"]
    assert model.body_mass[thigh] == mass
    assert model.dof_damping[model.joint("leg_joint").dofadr[0]] == info["parameters"]["dof_damping:leg_joint"]
    np.testing.assert_allclose(model.body_inertia[thigh] / nominal.body_inertia[thigh], mass / 4.0577, rtol=1e-4)
    np.testing.assert_allclose(model.body_subtreemass[1], model.body_mass[1:].sum(), rtol=1e-12)
    assert env.reset(options={"parameters": {"body_mass:thigh": 3.0, "dof_damping:leg_joint": 0.2}})[1][
        "parameters"
    ] == {"body_mass:thigh": 3.0, "dof_damping:leg_joint": 0.2}
    assert model.body_mass[thigh] == 3.0


def test_last_step_of_an_episode_names_its_parameters():
    """info["parameters"] is there when the episode ends, for whoever logs episodes."""
    env = RandomizedParameters(gymnasium.make("Hopper-v5", max_episode_steps=3), XI, SPACE)
    env.reset(seed=0)
    infos = [env.step(np.zeros(3)) for _ in range(3)]
    assert [("parameters" in i[4], i[3]) for i in infos] == [(False, False), (False, False), (True, True)]


def test_without_source_the_model_is_nominal():
    """source=None: the episode equals the bare environment's, even after an episode with other parameters."""
    env = hopper(None, SPACE)
    actions = np.random.default_rng(0).uniform(-1, 1, (30, 3))
    drive(env, actions, options={"parameters": XI})
    states = drive(env, actions, seed=4)
    bare = drive(gymnasium.make("Hopper-v5", terminate_when_unhealthy=False), actions, seed=4)
    # the bare solver starts warm from reset's forward pass, ours cold: both stop within the solver's tolerance
    np.testing.assert_allclose(states, bare, rtol=0, atol=1e-6)


def test_release_gives_the_environment_back():
    """After release the environment is bare again and can be wrapped anew."""
    bare = gymnasium.make("Hopper-v5")
    env = RandomizedParameters(bare, XI, SPACE)
    env.reset(seed=0)
    with pytest.raises(BadInput, match="under RandomizedParameters already"):
        RandomizedParameters(bare, XI, SPACE)
    env.release()
    model: Any = bare.unwrapped.model  # type: ignore[attr-defined]
    np.testing.assert_allclose(model.body_mass[model.body("thigh").id], 4.0577, rtol=1e-4)
    RandomizedParameters(bare, XI, SPACE).reset(seed=0)


def test_release_gives_the_solver_back():
    """Humanoid has its own solver again after release, and after a refusal: its observation holds forces."""
    bare: Any = gymnasium.make("Humanoid-v5")
    options = bare.unwrapped.model.opt
    before = (options.solver, options.disableflags)
    env = RandomizedParameters(bare, [8.0], ParameterSpace([Parameter("body_mass", "torso", 4.0, 12.0)]))
    assert (options.solver, options.disableflags) != before
    env.release()
    assert (options.solver, options.disableflags) == before
    with pytest.raises(BadEffect, match="holds more than qpos and qvel"):
        RandomizedParameters(bare, [0.1], space_of(Miscalibrated()))
    assert (options.solver, options.disableflags) == before
    assert "do_simulation" not in vars(bare.unwrapped)


def test_sensor_effect_changes_the_observation_only():
    """A sensor's error shows in the observation and leaves state and reward alone."""
    space = space_of(DAMPING, Miscalibrated())
    results = []
    for offset in (0.0, 0.25):
        env = hopper([1.0, offset], space)
        observation, _ = env.reset(seed=0)
        step = env.step(np.full(3, 0.5))
        state = env.unwrapped.state_vector()  # type: ignore[attr-defined]
        results.append((np.array([observation, step[0]]), step[1], state))
    (first, reward, state), (second, other_reward, other_state) = results
    np.testing.assert_allclose(second - first, np.tile(0.25 * (np.arange(11) < 5), (2, 1)), atol=1e-15)
    assert reward == other_reward
    np.testing.assert_array_equal(state, other_state)


def test_sensor_effect_refuses_observations_it_cannot_reach():
    """Humanoid observes inertias and contact forces too: refused; without them the effect acts."""
    space = space_of(Parameter("body_mass", "torso", 4.0, 12.0), Miscalibrated())
    with pytest.raises(BadEffect, match=r"Humanoid-v5: its observation holds more than qpos and qvel.*test_offset"):
        RandomizedParameters(gymnasium.make("Humanoid-v5"), [8.0, 0.1], space)
    parts = ("cinert", "cvel", "qfrc_actuator", "cfrc_ext")
    plain = gymnasium.make("Humanoid-v5", **{f"include_{p}_in_observation": False for p in parts})
    env = RandomizedParameters(plain, [8.0, 0.1], space)
    observed, _ = env.reset(seed=0)
    np.testing.assert_allclose(observed[:3] - env.unwrapped.data.qpos[2:5], 0.1, atol=1e-12)  # type: ignore[attr-defined]


def test_effects_refuse_an_environment_with_its_own_stepping():
    """An environment that steps MuJoCo in its own way cannot carry delays or forces: refused, not ignored."""
    from gymnasium.envs.mujoco.hopper_v5 import HopperEnv

    class Odd(HopperEnv):
        def do_simulation(self, ctrl: Any, n_frames: int) -> None:
            super().do_simulation(ctrl, n_frames)

    with pytest.raises(BadEffect, match=r"Odd: its class has its own do_simulation.*actuation_delay"):
        RandomizedParameters(Odd(), XI, SPACE)
    RandomizedParameters(Odd(), XI[:2], space_of(MASS, DAMPING)).reset(seed=0)


def test_divergence_ends_the_episode():
    """A simulation that MuJoCo gives up on is truncated and says so; the next episode is sound."""
    env = hopper(XI[:2], space_of(MASS, DAMPING))
    start, _ = env.reset(seed=0)
    env.unwrapped.data.qvel[:] = 1e12  # type: ignore[attr-defined]
    observation, reward, terminated, truncated, info = env.step(np.zeros(3))
    assert (reward, terminated, truncated, info["diverged"], env.diverged_episodes) == (0.0, False, True, True, 1)
    np.testing.assert_array_equal(observation, start)
    env.reset()
    assert "diverged" not in env.step(np.zeros(3))[4]


def test_a_command_that_mujoco_ignores_ends_the_episode():
    """For NaN MuJoCo warns and takes 0 instead: plausible numbers, refused here as in MujocoSimulator."""
    for space, xi in ((space_of(MASS, DAMPING), XI[:2]), (SPACE, XI)):
        env = hopper(xi, space)
        env.reset(seed=0)
        assert "diverged" not in env.step(np.ones(3))[4]
        # three control steps: the command may be 13 ms late
        assert any("diverged" in env.step(np.full(3, np.nan))[4] for _ in range(3))


@pytest.mark.parametrize(
    ("make", "error", "text"),
    [
        (
            lambda: RandomizedParameters(gymnasium.make("CartPole-v1"), XI, SPACE),
            BadInput,
            "CartPole-v1 .*no MuJoCo model",
        ),
        (lambda: hopper(XI), BadInput, "without a space"),
        (lambda: hopper(XI[:3], SPACE), BadParameter, r"parameters: parameter vectors must have shape \(n, 6\)"),
        (lambda: hopper(XI * np.nan, SPACE), BadParameter, "row 0: body_mass:thigh = nan lies outside"),
        (lambda: hopper(XI + 10, SPACE), BadParameter, "lies outside"),
        (lambda: hopper("thigh", SPACE), BadParameter, "not numbers"),
        (lambda: hopper(np.empty((0, 6)), SPACE), BadParameter, "at least one vector"),
        (lambda: hopper(Uniform(SPACE), space_of(MASS)), SpaceMismatch, "6 parameters against 1"),
        (
            lambda: hopper([3.0], ParameterSpace([Parameter("body_mass", "wing", 2.0, 6.0)])),
            BadParameter,
            r"Hopper-v5: body_mass:wing: the model has no body 'wing'; it has: .*thigh",
        ),
        (
            lambda: hopper([3.0], ParameterSpace([Parameter("wingspan", "thigh", 2.0, 6.0)])),
            BadParameter,
            "Hopper-v5: wingspan:thigh",
        ),
        (
            lambda: hopper(XI, SPACE).reset(options={"parameters": {"body_mass:thigh": 3.0}}),
            BadParameter,
            "must name exactly body_mass:thigh, ",
        ),
        (
            lambda: hopper(XI, SPACE).reset(options={"parameters": [XI, XI]}),
            BadParameter,
            "expected one vector, got 2",
        ),
    ],
)
def test_bad_inputs(make, error, text):
    """What does not fit is refused, and the message says what."""
    with pytest.raises(error, match=text):
        make()
