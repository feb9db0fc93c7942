"""The layout of states and the difference of two."""

import mujoco
import numpy as np
import pytest

from nfpde.sim import LOSS_LIMIT, StateSpace, squared_error
from tests.models import BALL, DOUBLE_PENDULUM, FREE_BOX, load


def random_states(model, n, rng, angle=None):
    """States with random rotations; `angle` turns each quaternion by exactly that much from the first state's."""
    states = np.empty((n, model.nq + model.nv))
    base = model.qpos0.copy()
    mujoco.mj_integratePos(model, base, rng.normal(size=model.nv), 1.0)
    for row in states:
        tangent = rng.normal(size=model.nv)
        if angle is not None:
            for j in range(model.njnt):
                if model.jnt_type[j] < 2:
                    first = model.jnt_dofadr[j] + (3 if model.jnt_type[j] == 0 else 0)
                    tangent[first : first + 3] *= angle / np.linalg.norm(tangent[first : first + 3])
        qpos = base.copy()
        mujoco.mj_integratePos(model, qpos, tangent, 1.0)
        row[:] = np.concatenate([qpos, rng.normal(size=model.nv)])
    return np.concatenate([base, rng.normal(size=model.nv)]), states


def by_mujoco(model, predicted, measured):
    out = np.empty(model.nv)
    mujoco.mj_differentiatePos(model, out, 1.0, measured[: model.nq], predicted[: model.nq])
    return np.concatenate([out, predicted[model.nq :] - measured[model.nq :]])


@pytest.mark.parametrize("xml", [DOUBLE_PENDULUM, FREE_BOX, BALL])
@pytest.mark.parametrize("angle", [None, 0.0, 1e-14, 1e-9, 1e-4, 1.0, 3.0, np.pi - 1e-6])
def test_difference_is_mujocos(xml, angle):
    """For hinges, slides, ball and free joints: mj_differentiatePos, from tiny rotations to nearly half a turn."""
    model = load(xml)
    states = StateSpace.of_model(model)
    measured, predicted = random_states(model, 20, np.random.default_rng(0), angle)
    got = states.difference(predicted, measured)
    expected = np.array([by_mujoco(model, p, measured) for p in predicted])
    # near half a turn the axis comes from a vector of length one and a scalar of 5e-7: MuJoCo's acos-free formula too
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9 if angle and angle > 3 else 1e-13)
    if angle is not None and states.quaternions:
        first = states.quaternions[0][1]
        np.testing.assert_allclose(np.linalg.norm(got[:, first : first + 3], axis=1), angle, rtol=1e-7, atol=2e-15)


@pytest.mark.parametrize("xml", [FREE_BOX, BALL])
def test_a_quaternion_and_its_negative_are_one_rotation(xml):
    """Flipping the sign of either side changes nothing."""
    model = load(xml)
    states = StateSpace.of_model(model)
    measured, predicted = random_states(model, 20, np.random.default_rng(1))
    (q, _), *_ = states.quaternions
    flipped = predicted.copy()
    flipped[:, q : q + 4] *= -1
    expected = states.difference(predicted, measured)
    np.testing.assert_array_equal(states.difference(flipped, measured), expected)
    np.testing.assert_allclose(states.difference(flipped, flipped), 0, atol=1e-15)


def test_lengths_of_quaternions_do_not_matter():
    """A logger's rounding of a quaternion is no rotation."""
    model = load(BALL)
    states = StateSpace.of_model(model)
    measured, predicted = random_states(model, 5, np.random.default_rng(2))
    longer = predicted.copy()
    longer[:, 1:5] *= 1.001
    np.testing.assert_allclose(
        states.difference(longer, measured), states.difference(predicted, measured), rtol=1e-13, atol=1e-15
    )


def test_half_a_turn_has_its_length():
    """At exactly pi either direction is right; the length is pi."""
    states = StateSpace.of_model(load(BALL))
    measured, predicted = np.zeros(11), np.zeros(11)
    measured[1], predicted[2] = 1, 1
    assert np.linalg.norm(states.difference(predicted, measured)[1:4]) == pytest.approx(np.pi, rel=1e-15)


def test_broadcasting():
    """(R, H, nx) against (R, H, nx) or against one state."""
    states = StateSpace.of_model(load(FREE_BOX))
    measured, predicted = random_states(load(FREE_BOX), 6, np.random.default_rng(3))
    block = states.difference(predicted.reshape(2, 3, 13), measured)
    assert block.shape == (2, 3, 12)
    np.testing.assert_array_equal(block.reshape(6, 12), states.difference(predicted, np.tile(measured, (6, 1))))


def test_channels():
    """Names follow the joints, positions first; a rotation has three."""
    ball = StateSpace.of_model(load(BALL))
    names = ["before", "ball.rx", "ball.ry", "ball.rz", "after"]
    assert ball.channels == tuple([f"qpos {n}" for n in names] + [f"qvel {n}" for n in names])
    assert (ball.nq, ball.nv, ball.nx, ball.ndiff) == (6, 5, 11, 10)
    assert ball.quaternions == ((1, 1),)
    box = StateSpace.of_model(load(FREE_BOX))
    assert box.channels[:6] == tuple(f"qpos root.{s}" for s in ("x", "y", "z", "rx", "ry", "rz"))
    assert box.quaternions == ((3, 3),)


def test_plain_vectors():
    """A user's own state: every number is a channel."""
    states = StateSpace.euclidean(["level"], [])
    assert (states.channels, states.nx, states.ndiff) == (("qpos level",), 1, 1)
    assert states.difference(np.array([3.0]), np.array([5.0])).tolist() == [-2.0]


def test_losses_are_always_finite():
    """NaN, infinity and overflow all cost exactly the limit; below it losses are what they are."""
    states = StateSpace.euclidean(["a"], ["b"])
    predicted = np.array([[[np.nan, 0]], [[0, np.inf]], [[1e200, 0]], [[1e6, 0]], [[999999.0, 0]], [[0, 3]]])
    losses = squared_error(states, predicted, np.zeros((6, 1, 2)), np.array([1.0, 2.0]))
    assert losses.tolist() == [LOSS_LIMIT, LOSS_LIMIT, LOSS_LIMIT, LOSS_LIMIT, 999999.0**2, 2.25]
