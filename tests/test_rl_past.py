"""Past commands among what a policy sees: where commands act late, nothing else tells what a robot is about to do."""

import json
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
    """Behind the environment's own, oldest first, zero before the first; a reset forgets them."""
    env: Any = PastCommands(make_environment("pendulum"), 2)
    assert env.observation_space.shape == (5,)
    np.testing.assert_array_equal(env.observation_space.low[3:], [-1.5, -1.5])
    for _ in range(2):
        seen = [env.reset(seed=0)[0], *(env.step(np.array([u]))[0] for u in (0.1, 0.2, 0.3))]
        assert [list(x[3:]) for x in seen] == [[0, 0], [0, 0.1], [0.1, 0.2], [0.2, 0.3]]
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


def policy(past: int) -> Policy:
    """An actor of random weights."""
    rng = np.random.default_rng(past)
    shapes = {"hidden.0.weight": (4, 3 + past), "hidden.0.bias": (4,), "mean.weight": (1, 4), "mean.bias": (1,)}
    weights = {k: rng.normal(size=s) for k, s in {**shapes, "log_std.weight": (1, 4), "log_std.bias": (1,)}.items()}
    return Policy(weights, [-1.5], [1.5], "nfpde/Pendulum-v0", past)


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
    without = train_sac("pendulum", [[1.0, 0.1]], out=tmp_path / "without", past_commands=0, **call)
    assert without.policy.nobservation == 3
    call |= {"space": ParameterSpace([MASS]), "target": [[1.0]]}
    assert train_sac("pendulum", [[1.0]], out=tmp_path / "prompt", **call).policy.past_commands == 0


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
    with pytest.raises(BadInput, match="n is 0; it must be a whole number, at least 1"):
        PastCommands(make_environment("pendulum"), 0)
    with pytest.raises(BadInput, match="past_commands is -2; it must be a whole number, at least 0"):
        train_sac("pendulum", [[1.0, 0.1]], space=LATE, steps=160, out=tmp_path, past_commands=-2)
