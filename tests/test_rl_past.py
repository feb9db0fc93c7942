"""Past commands among what a policy sees: where commands act late, nothing else tells what a robot is about to do."""

import json
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadInput
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import (
    Controller,
    PastCommands,
    Policy,
    RandomizedParameters,
    SacConfig,
    evaluate_policy,
    load_policy,
    make_environment,
    train_sac,
)

MASS = Parameter("body_mass", "pendulum", 0.4, 1.6)
LATE = ParameterSpace([MASS, *effect("actuation_delay", "motor", delay=(0.0, 0.1)).parameters])
"""Up to two control steps of the pendulum's."""
SMALL = SacConfig(hidden=(8,), batch_size=8, learning_starts=20, train_every=10)


def test_observations_by_hand():
    """Behind the environment's own, oldest first; the first counts as those before it; a reset forgets them."""
    env: Any = PastCommands(make_environment("pendulum"), 2)
    assert env.observation_space.shape == (5,)
    np.testing.assert_array_equal(env.observation_space.low[3:], [-1.5, -1.5])
    for _ in range(2):
        seen = [env.reset(seed=0)[0], *(env.step(np.array([u]))[0] for u in (0.1, 0.2, 0.3))]
        assert [list(x[3:]) for x in seen] == [[0, 0], [0.1, 0.1], [0.1, 0.2], [0.2, 0.3]]
        np.testing.assert_array_equal(seen[3][:3], env.unwrapped._get_obs())
        assert env.observation_space.contains(seen[3])


@pytest.mark.parametrize("delay", [0.03, 0.1])
def test_they_tell_what_comes_next(delay):
    """From one state, the last two commands decide the next state under a delay of two steps; one does not."""
    env: Any = RandomizedParameters(make_environment("pendulum"), [[1.0, delay]], LATE)
    assert env.pending_commands == 2

    def after(*commands):
        env.reset(seed=0)
        for u in commands[:-1]:
            env.step(np.array([u]))
        env.unwrapped.set_state(np.array([0.3]), np.array([0.2]))
        return env.step(np.array([commands[-1]]))[0]

    expected = after(0.5, -0.2, 0.7, 0.1, 0.4)
    # the last step of a simulation is the same function of the same numbers but for its solver's warm start
    np.testing.assert_allclose(after(-1.0, 1.2, 0.7, 0.1, 0.4), expected, rtol=0, atol=1e-12)
    assert (
        np.abs(after(0.5, -0.2, -0.7 if delay == 0.1 else 0.7, 0.1 if delay == 0.1 else -1.0, 0.4) - expected).max()
        > 1e-3
    )


def test_they_tell_it_from_the_first_step_on():
    """An episode's first command is what was given before, too: in the simulation, and in what is seen of it."""
    env: Any = RandomizedParameters(PastCommands(make_environment("pendulum"), 2), [[1.0, 0.1]], LATE)

    def after(*commands):
        env.reset(seed=0)
        seen = [env.step(np.array([u]))[0] for u in commands[:-1]]
        env.unwrapped.set_state(np.array([0.3]), np.array([0.2]))
        return seen[-1][3:], env.step(np.array([commands[-1]]))[0]

    for early, late in (((0.7, 0.4), (0.1, 0.7, 0.7, 0.4)), ((0.7, 0.1, 0.4), (0.2, 0.7, 0.1, 0.4))):
        (seen, first), (known, later) = after(*early), after(*late)
        np.testing.assert_array_equal(seen, known)
        np.testing.assert_allclose(first[:3], later[:3], rtol=0, atol=1e-12)


def test_delays_count_in_full_and_lags_as_four():
    """Delays in series add up, of each motor for itself; of a lag older commands count for little."""
    hopper = make_environment("hopper")

    def pending(*effects):
        space = ParameterSpace([p for e in effects for p in e.parameters])
        env = RandomizedParameters(hopper, None, space)
        env.release()
        return env.pending_commands

    late = effect("actuation_delay", "*", delay=(0.0, 0.03))  # in control steps of 0.008 s
    thigh, leg = (effect("actuator_lag", j, time_constant=(0.0, 0.1)) for j in ("thigh_joint", "leg_joint"))
    assert pending(late) == 4
    assert pending(thigh, leg) == 4
    assert pending(late, thigh) == 8
    assert pending(effect("actuator_lag", "*", time_constant=(0.0, 0.001))) == 1
    assert pending(effect("coulomb_friction", "leg_joint", torque=(0.0, 1.0))) == 0


def plain() -> Any:
    """The pendulum from a function that makes it."""
    return make_environment("pendulum")


def with_two() -> Any:
    """The same with two past commands in its observations."""
    return PastCommands(plain(), 2)


def policy(past: int) -> Policy:
    """An actor of random weights."""
    rng = np.random.default_rng(past)
    shapes = {"hidden.0.weight": (4, 3 + past), "hidden.0.bias": (4,), "mean.weight": (1, 4), "mean.bias": (1,)}
    weights = {k: rng.normal(size=s) for k, s in {**shapes, "log_std.weight": (1, 4), "log_std.bias": (1,)}.items()}
    low, high = np.array([[-1.5], [1.5]], dtype=np.float32)
    return Policy(weights, low, high, "nfpde/Pendulum-v0", past)


@pytest.mark.parametrize("past", [0, 3])
def test_a_controller_does_as_the_policy_in_its_environment(past):
    """On the bare environment it gives the commands that the policy gives where observations hold them."""
    inside: Any = PastCommands(make_environment("pendulum"), past) if past else make_environment("pendulum")
    bare: Any = make_environment("pendulum")
    actor, controller = policy(past), Controller(policy(past))
    for seed in range(2):
        controller.reset()
        seen, own = inside.reset(seed=seed)[0], bare.reset(seed=seed)[0]
        for _ in range(6):
            command = controller.act(own)
            np.testing.assert_array_equal(command, actor.predict(seen))
            seen, own = inside.step(command)[0], bare.step(command)[0]


def test_training_sees_as_many_as_delays_hold_back(tmp_path):
    """By default; the nominal baseline has no use for them; what is saved says how many, and evaluations know."""
    call: dict[str, Any] = {"steps": 160, "evaluation_every": 160, "evaluation_episodes": 2, "quiet": True}
    call |= {"hyperparameters": SMALL, "device": "cpu", "space": LATE, "target": [[1.0, 0.05]]}
    result = train_sac("pendulum", [[1.0, 0.1]], out=tmp_path / "late", nominal_baseline=True, **call)
    assert result.policy.past_commands == load_policy(tmp_path / "late").past_commands == 2
    assert load_policy(tmp_path / "late" / "nominal").nobservation == 3
    assert "its own last 2 commands" in result.summary()
    wrappers = json.loads((tmp_path / "late" / "train.json").read_text())["settings"]["wrappers"]
    assert {"name": "PastCommands", "arguments": {"n": 2}} in wrappers
    again = evaluate_policy(load_policy(tmp_path / "late"), "pendulum", [[1.0, 0.05]], space=LATE, episodes=2)
    assert result.after.target is not None
    assert tuple(again.returns) == result.after.target.returns
    for env in (plain, with_two):  # which know nothing of it, or all
        found = evaluate_policy(load_policy(tmp_path / "late"), env, [[1.0, 0.05]], space=LATE, episodes=2)
        assert tuple(found.returns) == tuple(again.returns)
    without = train_sac("pendulum", [[1.0, 0.1]], out=tmp_path / "without", past_commands=0, **call)
    assert without.policy.nobservation == 3
    assert train_sac("pendulum", [[1.0, 0.1]], out=tmp_path / "without", **call).policy.past_commands == 0  # goes on
    assert train_sac("pendulum", None, out=tmp_path / "nominal", **call).policy.past_commands == 0
    call |= {"space": ParameterSpace([MASS]), "target": [[1.0]]}
    assert train_sac("pendulum", [[1.0]], out=tmp_path / "prompt", **call).policy.past_commands == 0


def test_a_baseline_in_an_environment_that_holds_them(tmp_path):
    """Its observations have them for the nominal model, too; what was begun goes on with what it has."""
    call: dict[str, Any] = {"evaluation_every": 160, "evaluation_episodes": 2, "quiet": True, "nominal_baseline": True}
    call |= {"hyperparameters": SMALL, "device": "cpu", "space": LATE, "target": [[1.0, 0.05]]}
    for env, past, nominal in ((with_two, None, 2), (with_two, 2, 2), ("pendulum", 1, 1)):
        out = tmp_path / f"{past} {nominal}"
        result = train_sac(env, [[1.0, 0.1]], out=out, steps=160, past_commands=past, **call)
        assert result.baseline is not None
        assert result.baseline.policy.past_commands == load_policy(out / "nominal").past_commands == nominal
        again = train_sac(env, [[1.0, 0.1]], out=out, steps=320, **call)
        assert again.baseline is not None
        assert (again.baseline.after.step, again.baseline.policy.past_commands) == (320, nominal)


def test_policies_of_earlier_versions_have_none(tmp_path):
    """Their file does not say; one that says nonsense is damaged."""
    policy(0).save(tmp_path)
    content = json.loads((tmp_path / "policy.json").read_text())
    del content["past_commands"]
    (tmp_path / "policy.json").write_text(json.dumps(content))
    assert load_policy(tmp_path).past_commands == 0
    (tmp_path / "policy.json").write_text(json.dumps(content | {"past_commands": -1}))
    with pytest.raises(BadInput, match="past_commands is -1; it must be a whole number, at least 0"):
        load_policy(tmp_path)


def test_refusals(tmp_path):
    """Observations in several parts, and numbers that are none."""
    parts = gymnasium.wrappers.TransformObservation(
        make_environment("pendulum"),
        lambda o: {"o": o},
        gymnasium.spaces.Dict({"o": gymnasium.spaces.Box(-1, 1, (3,))}),
    )
    with pytest.raises(BadInput, match=r"past commands go with observations that are a row of numbers.*FlattenObs"):
        PastCommands(parts, 2)
    for n in (0, -1, 1.5):
        with pytest.raises(BadInput, match=f"n is {n}; it must be a whole number, at least 1"):
            PastCommands(make_environment("pendulum"), n)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="has 2 past commands in its observations already"):
        train_sac(with_two, [[1.0, 0.1]], space=LATE, steps=160, out=tmp_path, past_commands=3)
    with pytest.raises(BadInput, match="sees 4 numbers, which cannot end with 5 past commands of 1 numbers each"):
        replace(policy(1), past_commands=5)
    for seen in (np.zeros(4), np.zeros((2, 3)), "up", 1.0):
        with pytest.raises(BadInput, match=r"of 3 numbers \(and adds its own last 1 c|a row of numbers, got"):
            Controller(policy(1)).act(seen)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="a controller runs what load_policy returns, got a str"):
        Controller("runs/policy")  # type: ignore[arg-type]
    with pytest.raises(BadInput, match=r"of 4 numbers, the last of them its own last 1 commands \(see nfpde.rl.Contr"):
        policy(1).predict(np.zeros(3))
    with pytest.raises(BadInput, match="past_commands is -2; it must be a whole number, at least 0"):
        train_sac("pendulum", [[1.0, 0.1]], space=LATE, steps=160, out=tmp_path, past_commands=-2)
