"""Which parameter vectors an evaluation runs with, where there are more of them than episodes."""

import json

import numpy as np
import pytest

from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import SacConfig, evaluate_policy, train_sac
from nfpde.rl.evaluate import episode_vectors
from nfpde.truth import Truth

SPACE = ParameterSpace([Parameter("body_mass", "pendulum", 0.4, 1.6)])
SMALL = SacConfig(hidden=(8,), batch_size=8, learning_starts=10, buffer_size=1000, train_every=10)
SORTED = np.linspace(0.4, 1.6, 200)[:, None]


def chosen(array: np.ndarray, episodes: int, seed: int = 0) -> np.ndarray:
    found = episode_vectors(array, SPACE, episodes, seed)
    assert found is not None
    return found[:, 0]


def test_few_episodes_represent_a_long_array():
    """One vector from each stretch of a sorted array: its whole range, and its mean; the same under a seed."""
    for seed in range(5):
        found = chosen(SORTED, 20, seed)
        np.testing.assert_array_equal(np.floor(np.searchsorted(SORTED[:, 0], found) / 10), np.arange(20))
        # a uniform place in each of 20 stretches of 0.06: the mean errs by 0.06 / sqrt(12 * 20) = 0.004
        assert abs(found.mean() - 1.0) < 5 * 0.004
        np.testing.assert_array_equal(chosen(SORTED, 20, seed), found)
    assert not np.array_equal(chosen(SORTED, 20, 0), chosen(SORTED, 20, 1))


@pytest.mark.parametrize("n", [3, 7, 21, 39, 41])
def test_no_vector_comes_twice_while_others_are_left(n):
    """Whatever the numbers of vectors and episodes; over many seeds every vector has its turn."""
    array = np.linspace(0.4, 1.6, n)[:, None]
    for episodes in range(2, n):
        seen = [chosen(array, episodes, seed) for seed in range(60)]
        assert all(len(np.unique(found)) == episodes for found in seen)
        if 2 * episodes > n:  # stretches of two at most: missed sixty times by one in 1e18
            assert len(np.unique(seen)) == n


def test_fewer_vectors_than_episodes_come_in_turn():
    """Every robot has its episodes."""
    np.testing.assert_array_equal(chosen(SORTED[:3], 7), SORTED[[0, 1, 2, 0, 1, 2, 0], 0])
    np.testing.assert_array_equal(chosen(SORTED[:4], 4), SORTED[:4, 0])


def test_an_evaluation_says_how_many_it_ran_with():
    """Of 200 vectors 4; of two, both, and no word of it."""
    found = evaluate_policy(lambda o: o[2:], "pendulum", SORTED, space=SPACE, episodes=4)
    assert found.given == 200
    assert repr(found).endswith("over 4 episodes, 4 of 200 parameter vectors)")
    assert found.parameters is not None
    assert found.parameters.max() > 1.3
    assert found.parameters.min() < 0.7
    assert repr(evaluate_policy(lambda o: o[2:], "pendulum", SORTED[:2], space=SPACE, episodes=2)).endswith("episodes)")


def test_a_training_says_how_many_robots_it_was_evaluated_on(tmp_path):
    """In its summary and in train.json; of a sorted sample array it evaluates more than the beginning."""
    truth = Truth(SPACE, SORTED[::40], [f"{i}" for i in range(5)])
    result = train_sac(
        "pendulum", SORTED, space=SPACE, steps=150, out=tmp_path, target=truth, evaluation_every=150,
        evaluation_episodes=2, hyperparameters=SMALL, device="cpu", quiet=True,
    )  # fmt: skip
    assert result.robots == (2, 5)
    assert "after (2 of its 5 robots)" in result.summary()
    assert json.loads((tmp_path / "train.json").read_text())["robots"] == {"evaluated": 2, "all": 5}
    again = evaluate_policy(result.policy, "pendulum", SORTED, space=SPACE, episodes=2)
    assert tuple(again.returns) == result.after.training.returns
    assert again.parameters is not None
    assert again.parameters[1, 0] > 1.0
    every = evaluate_policy(result.policy, "pendulum", truth.xi, space=SPACE, episodes=2)
    assert result.after.target is not None
    assert tuple(every.returns) == result.after.target.returns


def test_a_robot_of_several_recordings_counts_once(tmp_path):
    """Of three robots with ten recordings the evaluations meet all three, in turn, and say no word of a choice."""
    xi = np.array([1.2, 0.5, 1.2, 0.5, 0.9, 1.2, 1.2, 1.2, 1.2, 1.2])[:, None]
    result = train_sac(
        "pendulum", SORTED, space=SPACE, steps=150, out=tmp_path, target=Truth(SPACE, xi, [f"{i}" for i in range(10)]),
        evaluation_every=150, evaluation_episodes=4, hyperparameters=SMALL, device="cpu", quiet=True,
    )  # fmt: skip
    assert result.settings["target"]["xi"] == [[1.2], [0.5], [0.9]]
    assert result.robots == (3, 3)
    assert "robots)" not in result.summary()
    every = evaluate_policy(result.policy, "pendulum", [[1.2], [0.5], [0.9]], space=SPACE, episodes=4)
    assert result.after.target is not None
    assert tuple(every.returns) == result.after.target.returns
