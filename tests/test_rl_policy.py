"""Policies on their own: the same actions as Stable-Baselines3's actor, files, refusals; evaluation of policies."""

import json
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest

from nfpde.errors import BadInput, SimulationDiverged, SpaceMismatch
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import Policy, RandomizedParameters, SacConfig, evaluate_policy, load_policy, make_environment
from nfpde.rl import evaluate as evaluation
from nfpde.rl.learner import SacLearner, isolated_randomness

SPACE = ParameterSpace([Parameter("body_mass", "pendulum", 0.4, 1.6)])


@pytest.fixture(scope="module")
def learner():
    with isolated_randomness(1):
        return SacLearner(gymnasium.make("Hopper-v5"), SacConfig(hidden=(24, 16)), steps=10, seed=3, device="cpu")


def test_same_actions_as_stable_baselines(learner, tmp_path):
    """A saved and loaded policy acts as SB3's actor does, one observation or many: rounding of float32 only."""
    learner.policy("Hopper-v5").save(tmp_path)
    policy = load_policy(tmp_path)
    observations = np.random.default_rng(0).normal(scale=3, size=(50, 11))
    expected, _ = learner.model.predict(observations, deterministic=True)
    np.testing.assert_allclose(policy.predict(observations), expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(policy.predict(observations[7]), expected[7], rtol=0, atol=1e-5)
    assert (policy.nobservation, policy.nhidden, policy.environment) == (11, 2, "Hopper-v5")


def test_random_actions_have_the_actors_distribution(learner):
    """Drawn actions: the unsquashed ones have the mean and standard deviation that SB3's actor gives."""
    import torch

    policy = learner.policy("")
    one = np.random.default_rng(1).normal(size=11).astype(np.float32)
    draws = policy.predict(np.tile(one, (20_000, 1)), np.random.default_rng(2))
    with torch.no_grad():
        mean, log_std, _ = learner.model.policy.actor.get_action_dist_params(torch.from_numpy(one)[None])
    raw = np.arctanh(np.clip(draws.astype(np.float64), -1 + 1e-7, 1 - 1e-7))
    std = log_std.exp().numpy()[0]
    # 20000 draws: five standard errors of a median are 0.045 standard deviations, of a quartile range 0.05
    np.testing.assert_allclose(np.median(raw, 0), mean.numpy()[0], rtol=0, atol=0.045 * std.max())
    quartiles = np.quantile(raw, [0.25, 0.75], axis=0)
    np.testing.assert_allclose((quartiles[1] - quartiles[0]) / 1.34898, std, rtol=0.05)
    np.testing.assert_array_equal(
        policy.predict(one, np.random.default_rng(5)), policy.predict(one, np.random.default_rng(5))
    )


def test_actions_fill_the_bounds():
    """A saturated actor reaches exactly the bounds, which need not be symmetric."""
    weights = {"mean.weight": np.eye(2) * 100, "mean.bias": np.zeros(2)}
    weights |= {"log_std.weight": np.zeros((2, 2)), "log_std.bias": np.zeros(2)}
    policy = Policy(weights, np.array([-1.0, 2.0]), np.array([3.0, 2.5]))
    np.testing.assert_array_equal(policy.predict([9, -9]), [3.0, 2.0])
    np.testing.assert_array_equal(policy.predict([-9, 9]), [-1.0, 2.5])
    np.testing.assert_array_equal(policy.predict([0, 0]), [1.0, 2.25])


def test_no_pickle_in_the_files(learner, tmp_path):
    """A policy is two files, JSON and safetensors."""
    learner.policy("x").save(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["policy.json", "policy.safetensors"]
    assert json.loads((tmp_path / "policy.json").read_text())["hidden"] == [24, 16]


def spoil_json(folder, **change):
    config = json.loads((folder / "policy.json").read_text())
    (folder / "policy.json").write_text(json.dumps({k: v for k, v in {**config, **change}.items() if v is not None}))


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda f: (f / "policy.json").unlink(), "holds no policy"),
        (lambda f: (f / "policy.safetensors").unlink(), "holds no policy"),
        (lambda f: (f / "policy.json").write_text("{"), "damaged"),
        (lambda f: (f / "policy.safetensors").write_bytes(b"1234567890"), "damaged"),
        (lambda f: (f / "policy.json").write_text("[]"), "schema_version None"),
        (lambda f: spoil_json(f, schema_version=99), "schema_version 99"),
        (lambda f: spoil_json(f, activation="tanh"), "activation relu"),
        (lambda f: spoil_json(f, action_low=None), "entry 'action_low' is missing"),
        (lambda f: spoil_json(f, action_low=[0.0]), "low < high"),
        (lambda f: spoil_json(f, hidden=[24, 17]), "do not belong together"),
    ],
)
def test_damaged_policies_are_refused(learner, tmp_path, spoil, text):
    """Every way of damaging a saved policy is refused by message."""
    learner.policy("x").save(tmp_path)
    spoil(tmp_path)
    with pytest.raises(BadInput, match=text):
        load_policy(tmp_path)


def test_bad_weights_and_observations_are_refused(learner):
    """Weights that are poisoned or do not fit, observations of another robot: refused."""
    policy = learner.policy("x")
    with pytest.raises(BadInput, match="observations of 11 numbers, got an array of shape"):
        policy.predict(np.zeros(12))
    with pytest.raises(BadInput, match="not finite"):
        policy.predict(np.full(11, np.nan))
    poisoned = {**policy.weights, "mean.bias": np.full(3, np.inf)}
    with pytest.raises(BadInput, match="mean holds a number that is not finite"):
        Policy(poisoned, policy.low, policy.high)
    with pytest.raises(BadInput, match=r"hidden.1 has weight \(16, 25\)"):
        Policy({**policy.weights, "hidden.1.weight": np.zeros((16, 25), np.float32)}, policy.low, policy.high)
    with pytest.raises(BadInput, match="weights must be"):
        Policy({k: v for k, v in policy.weights.items() if "log_std" not in k}, policy.low, policy.high)


def test_evaluation_is_the_sum_of_rewards():
    """Returns equal those of a plain loop over the same seeds and parameters; vectors are taken in turn."""
    vectors = np.array([[0.5], [0.9], [1.4]])
    found = evaluate_policy(lambda o: np.array([1.5 * np.sign(o[2])]), "pendulum", vectors, space=SPACE, episodes=5)
    assert found.parameters is not None
    np.testing.assert_array_equal(found.parameters[:, 0], [0.5, 0.9, 1.4, 0.5, 0.9])
    np.testing.assert_array_equal(found.lengths, 150)
    env = RandomizedParameters(make_environment("pendulum"), vectors, SPACE)
    for i, seed in enumerate(np.random.SeedSequence(0).generate_state(5)):
        observation, _ = env.reset(seed=int(seed), options={"parameters": found.parameters[i]})
        total = 0.0
        for _ in range(150):
            observation, reward, *_ = env.step(np.array([1.5 * np.sign(observation[2])]))
            total += reward
        assert total == found.returns[i]
    assert found.mean == pytest.approx(found.returns.mean())
    assert found.standard_error == pytest.approx(found.returns.std(ddof=1) / 5**0.5)
    assert len(set(found.returns[[0, 3]])) == 2  # the start states differ


def test_evaluation_repeats_under_its_seed():
    """Equal seeds give equal episodes, other seeds others; also after the environment was used."""

    class Uniform:
        space = SPACE

        def sample(self, n: int, seed: int = 0):
            return SPACE.uniform(n, np.random.default_rng(seed))

    env = RandomizedParameters(make_environment("pendulum"), Uniform())
    first, second, other = (evaluate_policy(lambda o: -o[2:], env, episodes=4, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.returns, second.returns)
    assert not np.isin(other.returns, first.returns).any()
    assert first.parameters is not None
    assert len(np.unique(first.parameters)) == 4


def test_a_wrapped_environment_keeps_its_space():
    """Vectors, or a distribution, over the same parameters in another order are no parameters of this environment."""
    mass, damping = Parameter("body_mass", "pendulum", 0.05, 1.6), Parameter("dof_damping", "hinge", 0.0, 2.0)
    backwards = ParameterSpace([damping, mass])

    class Backwards:
        space = backwards

        def sample(self, n: int, seed: int = 0):
            return np.tile([0.1, 1.2], (n, 1))

    env = RandomizedParameters(make_environment("pendulum"), [[1.0, 0.1]], ParameterSpace([mass, damping]))
    with pytest.raises(SpaceMismatch):
        evaluate_policy(lambda o: o[2:], env, [[0.1, 1.2]], space=backwards)
    with pytest.raises(SpaceMismatch):
        evaluate_policy(lambda o: o[2:], env, Backwards())
    found = evaluate_policy(lambda o: o[2:], env, [[1.2, 0.1]], space=env.space, episodes=2)
    np.testing.assert_array_equal(found.parameters, [[1.2, 0.1]] * 2)


def test_an_episode_without_an_end_is_refused(monkeypatch):
    """A bare environment, which no TimeLimit ends, does not hang: the message says what to do."""
    monkeypatch.setattr(evaluation, "ENDLESS", 200)
    with pytest.raises(BadInput, match=r"did not end within 200 control steps.*TimeLimit"):
        evaluate_policy(lambda o: o[2:], lambda: make_environment("pendulum").unwrapped, [[1.0]], space=SPACE)


def test_evaluation_refuses():
    """Too few episodes, a source without its space, and simulations that blow up, which have no return."""
    with pytest.raises(BadInput, match="at least 2"):
        evaluate_policy(lambda o: o[2:], "pendulum", [[1.0]], space=SPACE, episodes=1)
    seeds: tuple[Any, ...] = (-1, 0.5, True)
    for seed in seeds:
        with pytest.raises(BadInput, match=f"seed is {seed}; it must be an integer from 0 to 9223372036854775807"):
            evaluate_policy(lambda o: o[2:], "pendulum", [[1.0]], space=SPACE, seed=seed)
    with pytest.raises(BadInput, match="without a space"):
        evaluate_policy(lambda o: o[2:], "pendulum", [[1.0]])
    with pytest.raises(BadInput, match="space for an evaluation on the nominal"):
        evaluate_policy(lambda o: o[2:], "pendulum")
    # damping integrated explicitly blows up where it is far beyond inertia / timestep
    space = ParameterSpace([Parameter("dof_damping", "thigh_joint", 0.0, 1e7)])
    stiff = gymnasium.make("Hopper-v5", terminate_when_unhealthy=False)
    stiff.unwrapped.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP  # type: ignore[attr-defined]
    env = RandomizedParameters(stiff, [9e6], space)
    with pytest.raises(SimulationDiverged, match="'dof_damping:thigh_joint': 9000000"):
        evaluate_policy(lambda o: np.full(3, 0.1), env, episodes=2)
