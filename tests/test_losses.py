"""The scale that errors are counted in."""

import numpy as np
import pytest

from nfpde.dataset import Windows
from nfpde.errors import BadDataset
from nfpde.losses import increment_scale
from nfpde.sim import StateSpace
from tests.models import BALL, load, make_windows, with_arrays

PLAIN = StateSpace.euclidean(["x", "y"], ["vx", "vy"])


def windows(state):
    state = np.asarray(state, dtype=float)
    n, rows, _ = state.shape
    none = np.zeros((n, 0, 0))
    return Windows(state, np.zeros((n, rows - 1, 0)), none, 0.1, 2, 2, np.zeros(n, int), np.arange(n))


def test_by_hand():
    """Root mean square, over windows and steps, of the change since the window's start."""
    made = windows(
        [
            [[0, 0, 0, 0], [3, 1, 10, 0], [0, 1, -10, 2]],
            [[5, 5, 5, 5], [5, 6, 5, 5], [9, 6, 5, 5]],
        ]
    )
    expected = np.sqrt([(9 + 0 + 0 + 16) / 4, (1 + 1 + 1 + 1) / 4, (100 + 100) / 4, 4 / 4])
    np.testing.assert_allclose(increment_scale(PLAIN, made), expected, rtol=1e-14)


def test_units_cancel():
    """Recordings in other units give scales in those units: divided errors are the same."""
    rng = np.random.default_rng(0)
    state = rng.normal(size=(9, 4, 4))
    factor = np.array([1e3, 1e-3, 57.3, 1.0])
    np.testing.assert_allclose(
        increment_scale(PLAIN, windows(state * factor)), factor * increment_scale(PLAIN, windows(state)), rtol=1e-12
    )


def test_a_channel_that_never_moves():
    """It takes the smallest scale of its kind; where its whole kind rests, the smallest of all."""
    state = np.random.default_rng(1).normal(size=(5, 2, 4)) * [1.0, 0.0, 100.0, 10.0]
    x, y, vx, vy = increment_scale(PLAIN, windows(state))
    assert y == x
    assert x < vy < vx
    state[..., :2] = 7.0
    x, y, vx, vy = increment_scale(PLAIN, windows(state))
    assert x == y == vy < vx


def test_rounding_errors_are_no_movement():
    """A channel that changes in the last digits only does not rule the loss."""
    rng = np.random.default_rng(2)
    state = rng.normal(size=(50, 2, 4)) * [1.0, 1e-15, 10.0, 0.01]
    x, y, _, vy = increment_scale(PLAIN, windows(state))
    assert y == x
    # a thousandth of the other velocity is a movement: 50 draws of sqrt(2) 0.01, four standard errors
    assert vy == pytest.approx(0.01 * np.sqrt(2), rel=0.4)


def test_nothing_moves():
    """A robot at rest says nothing about its parameters."""
    with pytest.raises(BadDataset, match="nothing moves in these recordings"):
        increment_scale(PLAIN, windows(np.ones((3, 2, 4))))


def test_quaternions_count_as_angles():
    """The scale has a number per channel of a difference, and a turn of the ball joint counts in radians."""
    model = load(BALL)
    states = StateSpace.of_model(model)
    made = make_windows(model, 6, 1)
    ((q, v),) = states.quaternions
    state = np.repeat(made.state[:, :1], 2, axis=1)
    state[:, :, q : q + 4] = [1.0, 0.0, 0.0, 0.0]
    angle = 0.3
    state[:, 1, q : q + 4] = [np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0]
    state[:, 1, model.nq] += 2.0
    scale = increment_scale(states, with_arrays(made, state=state))
    assert scale.shape == (states.ndiff,) == (2 * model.nv,)
    # nothing else moves: every position takes the scale of the turn, every velocity that of the first one
    np.testing.assert_allclose(scale, [angle] * model.nv + [2.0] * model.nv, rtol=1e-12)
    assert v < model.nv
