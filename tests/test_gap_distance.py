"""The distance between recorded and simulated states: known shifts, rotations, and a diagnosis that closes it."""

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.gap import diagnose_gap
from nfpde.gap.distance import MOST_POINTS, distance
from nfpde.sim import StateSpace
from tests.gap_systems import nominal, record

PLAIN = StateSpace.euclidean(["a"], ["a"])


def ends_of(points):
    """Windows of one step that end at the given states (N, nx), with no quaternion among them."""
    points = np.repeat(np.asarray(points, dtype=float), 2, axis=0)
    half = points.shape[1] // 2
    rows = np.arange(len(points))
    return Dataset([Episode("0", 0.01 * rows, points[:, :half], points[:, half:], rows[:, None] * 0.0)]).windows(
        1, stride=2
    )


def test_a_shift_counts_in_standard_deviations():
    """Everything moved by c in a channel of deviation s costs c / s; nothing moved costs nothing."""
    rng = np.random.default_rng(0)
    windows = ends_of(rng.normal(size=(200, 2)) * [2.0, 5.0])
    real = windows.target[:, -1]
    shift = np.array([0.3, 0.0])
    found = distance(PLAIN, windows, [real + shift, real + 2 * shift, real], np.zeros((200, 2)))
    one = 0.3 / real[:, 0].std()
    assert (found.before, found.after_parameters) == (pytest.approx(one), pytest.approx(2 * one))
    assert found.after_effects == pytest.approx(0.0, abs=1e-12)
    assert found.noise_floor == pytest.approx(0.0, abs=1e-12)
    assert found.windows == 200


def test_it_compares_distributions_not_windows():
    """The same states in another order are the same distribution."""
    windows = ends_of(np.random.default_rng(1).normal(size=(60, 2)))
    real = windows.target[:, -1]
    assert distance(PLAIN, windows, [real[::-1]] * 3, np.zeros((60, 2))).before == pytest.approx(0.0, abs=1e-12)


def test_many_windows_are_thinned_and_diverged_ones_left_out():
    """A thousand windows, of which some diverge in one of the simulations."""
    windows = ends_of(np.random.default_rng(2).normal(size=(1000, 2)))
    real = windows.target[:, -1]
    wild = real.copy()
    wild[::3] = np.nan
    assert distance(PLAIN, windows, [real] * 3, np.zeros((1000, 2))).windows == MOST_POINTS
    some = distance(PLAIN, windows[np.arange(90)], [real[:90], wild[:90], real[:90]], np.zeros((90, 2)))
    assert (some.windows, some.before) == (60, pytest.approx(0.0, abs=1e-12))
    assert np.isnan(distance(PLAIN, windows, [np.full_like(real, np.nan)] * 3, np.zeros((1000, 2))).before)


def test_a_start_that_noise_makes_diverge_is_left_out():
    """From the recorded start all went well: the others still tell the distance."""
    windows = ends_of(np.random.default_rng(3).normal(size=(50, 2)))
    real = windows.target[:, -1]
    noise = np.zeros((50, 2))
    noise[4] = np.nan
    found = distance(PLAIN, windows, [real] * 3, noise)
    assert found.windows == 49
    assert found.noise_floor == pytest.approx(0.0, abs=1e-12)


def test_rotations_are_compared_as_rotations():
    """The quaternions q and -q are the same pose and cost nothing; a turn about one axis costs its angle."""
    ball = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='b' type='ball'/><geom size='.1'/></body></worldbody></mujoco>"
    )
    states = StateSpace.of_model(ball)
    rng = np.random.default_rng(3)
    angle = rng.normal(size=80) * 0.2
    time = 0.01 * np.arange(80)
    turned = lambda a: np.stack([np.cos(a / 2), np.sin(a / 2), 0 * a, 0 * a], axis=1)  # noqa: E731
    episode = Episode("0", time, turned(angle), rng.normal(size=(80, 3)), np.zeros((80, 0)))
    windows = Dataset([episode]).windows(1)
    real = windows.target[:, -1]
    flipped, moved = real.copy(), real.copy()
    flipped[:, :4] *= -1
    moved[:, :4] = turned(angle[1:] + 0.1)
    found = distance(states, windows, [moved, flipped, real], np.zeros((79, 6)))
    # the tangent space is that at the first pose, with which all turns share their axis
    assert found.before == pytest.approx(0.1 / angle[1:].std(), rel=1e-6)
    assert found.after_parameters == pytest.approx(0.0, abs=1e-7)


def test_noise_of_a_turn_goes_on_behind_half_a_turn():
    """A yaw all round: simulations that err by as much as the noise lie as near as noise does."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    states, rng = StateSpace.of_model(model), np.random.default_rng(0)
    yaw, error = rng.uniform(-np.pi, np.pi, 300), 0.15 * rng.normal(size=300)
    yaw[0] = 0.0

    def turned(angle):
        out = np.zeros((len(angle), 13))
        out[:, 3], out[:, 6] = np.cos(angle / 2), np.sin(angle / 2)
        return out

    noise = np.zeros((300, 12))
    noise[:, 5] = error
    windows: Any = SimpleNamespace(target=turned(yaw)[:, None])
    found = distance(states, windows, [turned(yaw + error)] * 3, noise)
    assert found.noise_floor == pytest.approx(found.before, rel=1e-9)


@pytest.mark.parametrize("sigma", [0.0, 0.5])
def test_a_channel_that_hardly_moves_counts_little(sigma):
    """Beside one that spreads by 5 it counts in a hundredth of that, or in its sensor's noise, where that is more."""
    rng = np.random.default_rng(4)
    space = StateSpace.euclidean(["a", "b"], ["a", "b"])
    real = rng.normal(size=(200, 4)) * [5.0, 1e-4, 1.0, 1.0]
    windows = ends_of(real)
    shift = np.array([0.0, 0.1, 0.0, 0.0])
    found = distance(space, windows, [real + shift, real, real], np.zeros((200, 4)), np.full(4, sigma))
    assert found.before == pytest.approx(0.1 / (sigma or 0.01 * real[:, 0].std()), rel=1e-6)


def test_a_diagnosis_closes_the_distance():
    """Friction at the elbow: the effect brings the simulated states as near as noise lets them."""
    found = diagnose_gap(
        nominal(), record(lambda m: setattr(m, "dof_frictionloss", [0.0, 0.2]), noise=1e-3), windows=60
    )
    apart = found.distance
    assert apart.before == apart.after_parameters > 3 * apart.after_effects
    assert apart.after_effects == pytest.approx(apart.noise_floor, rel=0.5)  # 60 windows
    assert found.to_json()["gap"]["distance"]["before"] == apart.before
    assert any("standard deviations from the recorded" in line for line in found.summary)
