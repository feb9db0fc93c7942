"""Transitions of another training in a folder: never learned from."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import SacConfig, TrainResult, train_sac

SPACE = ParameterSpace([Parameter("body_mass", "pendulum", 0.4, 1.6)])
SMALL = SacConfig(hidden=(8,), batch_size=8, learning_starts=10, train_every=10)


def train(out: Path, steps: int, every: int = 160, **change: Any) -> TrainResult:
    return train_sac(
        "pendulum", [[0.7]], space=SPACE, steps=steps, out=out, evaluation_every=every, evaluation_episodes=2,
        hyperparameters=SMALL, device="cpu", quiet=True, **change,
    )  # fmt: skip


def same(first: TrainResult, second: TrainResult) -> None:
    assert first.points == second.points
    for name, weight in first.policy.weights.items():
        np.testing.assert_array_equal(weight, second.policy.weights[name])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A training of three rounds without interruption, and a file of another one's first two."""
    other = tmp_path_factory.mktemp("other")
    train(other, 320, 320, seed=5)
    return train(tmp_path_factory.mktemp("whole"), 480), next((other / "replay").iterdir())


def test_a_fresh_start_leaves_nothing_of_the_last_one(whole, tmp_path):
    """Where the state was deleted, the transitions go, too, and going on is as without them."""
    expected, stale = whole
    (tmp_path / "replay").mkdir()
    for name in (stale.name, "000000009000-000000009160.npz"):
        (tmp_path / "replay" / name).write_bytes(stale.read_bytes())
    train(tmp_path, 320)
    assert sorted(p.name[:12] for p in (tmp_path / "replay").iterdir()) == ["000000000000", "000000000160"]
    same(train(tmp_path, 480), expected)


def test_files_of_other_rounds_are_not_read(whole, tmp_path):
    """They may lie in folders of earlier versions."""
    expected, stale = whole
    train(tmp_path, 320)
    (tmp_path / "replay" / stale.name).write_bytes(stale.read_bytes())
    same(train(tmp_path, 480), expected)


def test_a_longer_round_that_was_cut_off_is_not_read(whole, tmp_path):
    """Killed before its state was saved, and gone on with to fewer steps: its file is no round's."""
    _, stale = whole
    first, second = tmp_path / "a", tmp_path / "b"
    for out, left in ((first, False), (second, True)):
        train(out, 160)
        if left:
            (out / "replay" / "000000000160-000000000320.npz").write_bytes(stale.read_bytes())
        train(out, 240)
        train(out, 400)
    same(train(second, 480), train(first, 480))
