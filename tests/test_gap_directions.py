"""In which directions noise is loud, and what is seen across them."""

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.gap.directions import Directions, likeliest_directions, noise_covariance
from nfpde.gap.grain import Encoders
from nfpde.gap.loud import Loudness, noise_residuals
from nfpde.gap.replay import Replay
from nfpde.gap.sensors import sensor_noise

MASS = """
<mujoco><option timestep="0.01" gravity="0 0 0" integrator="RK4"/>
<worldbody><body><joint name="along" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/></body></worldbody></mujoco>
"""

CART = """
<mujoco><option timestep="0.002"/>
<worldbody>
  <geom name="floor" type="plane" size="5 5 .1"/>
  <body name="cart" pos="0 0 .1">
    <joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
    <joint name="pitch" axis="0 1 0"/>
    <geom type="box" size=".2 .1 .02" mass="2" contype="0" conaffinity="0"/>
    <geom type="sphere" pos="-.2 0 -.05" size=".05" mass=".1" friction=".02"/>
    <geom type="sphere" pos=".2 0 -.05" size=".05" mass=".1" friction=".02"/>
    <body pos="0 0 .02"><joint name="arm" axis="0 1 0" damping=".05"/>
      <geom type="capsule" fromto="0 0 0 0 0 .3" size=".02" mass=".3" contype="0" conaffinity="0"/></body>
  </body>
</worldbody>
<actuator><motor joint="arm"/><motor joint="x"/></actuator></mujoco>
"""
SIGMA = np.array([3e-4, 2e-4, 1e-3, 2e-3, 1e-3, 5e-4, 1e-3, 5e-3])
"""Noise of the cart's sensors: that of its height and its pitch opens and closes contacts."""


def rides(sigma=SIGMA, rows=250, seed=0):
    """Recordings of a cart that stands on two feet and swings an arm."""
    rng, model, out = np.random.default_rng(seed), mujoco.MjModel.from_xml_string(CART), []
    for number in range(4):
        data = mujoco.MjData(model)
        time = 0.01 * np.arange(rows)
        ctrl = np.stack([0.8 * np.sin(2 * np.pi * rng.uniform(0.5, 1.5) * time + p) for p in rng.uniform(0, 6, 2)], 1)
        states = np.empty((rows, 8))
        for _ in range(200):
            mujoco.mj_step(model, data)
        for row in range(rows):
            states[row] = [*data.qpos, *data.qvel]
            data.ctrl[:] = ctrl[row]
            mujoco.mj_step(model, data, 5)
        states += sigma * rng.normal(size=states.shape)
        out.append(Episode(str(number), time, states[:, :4], states[:, 4:], ctrl))
    return Dataset(out)


def test_noise_of_a_free_mass_spreads_as_in_the_books():
    """Prediction A e(0), measured with e(h): A S A' + S, whatever the horizon; both share the start's error."""
    time = 0.01 * np.arange(40)
    still = Dataset([Episode("0", time, np.zeros((40, 1)), np.zeros((40, 1)), np.zeros((40, 0)))])
    replay, sigma = Replay(mujoco.MjModel.from_xml_string(MASS), None, []), np.array([1e-3, 2e-2])
    found = noise_covariance(replay, np.zeros(0), still.windows(4), (1, 4), sigma)
    lever = np.array([[1, 0.01], [1, 0.04], [0, 1], [0, 1]])  # position after 1 and 4 steps, then speed
    wanted = lever @ np.diag(sigma**2) @ lever.T + np.diag(sigma[[0, 0, 1, 1]] ** 2)
    np.testing.assert_allclose(found, np.broadcast_to(wanted, found.shape), rtol=1e-6, atol=1e-12)


def test_beside_contacts_noise_is_white_in_its_directions():
    """Draws of the noise, simulated, have one size in all directions once turned, and some far more before."""
    data = rides()
    replay, windows = Replay(mujoco.MjModel.from_xml_string(CART), None, []), data.windows(1)[::4]
    draws = noise_residuals(replay, np.zeros(0), windows, (1,), SIGMA, 1, 40)
    covariance = noise_covariance(replay, np.zeros(0), windows, (1,), SIGMA)
    plain = Loudness(np.ones(draws.shape[1:]))
    found = likeliest_directions(covariance, draws[0], np.full((4, 2), 1e-12), plain)
    assert isinstance(found, Directions)
    size = np.sqrt(np.einsum("nii->i", covariance) / len(covariance))

    def condition(residuals):
        flat = (residuals.reshape(len(residuals), -1, 8) / size).reshape(-1, 8)
        values = np.linalg.eigvalsh(flat.T @ flat / len(flat))
        return values[-1] / values[0]

    assert condition(draws) > 100
    assert condition(found.quieten(draws)) < 10  # feet that lift off do more than one standard deviation to a side says


def gaussian(rng, covariance):
    return np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.normal(size=covariance.shape[:2]))


def test_directions_are_believed_as_far_as_residuals_follow_them():
    """Noise that is as loud as foretold is whitened; noise alike in all directions is left alone."""
    rng = np.random.default_rng(4)
    loud = rng.normal(size=(400, 4))
    covariance = np.eye(4) + 400 * loud[:, :, None] * loud[:, None, :]
    floor, plain = np.full((2, 2), 1e-6), Loudness(np.ones((400, 2, 2)))
    follows = likeliest_directions(covariance, gaussian(rng, covariance).reshape(400, 2, 2), floor, plain)
    assert isinstance(follows, Directions)
    white = follows.quieten(gaussian(rng, covariance).reshape(400, 2, 2)).reshape(-1, 4)
    expected = np.sqrt(np.einsum("nii->i", covariance) / 400)
    # the mean of n squares errs by sqrt(2 / n)
    np.testing.assert_allclose(np.sqrt((white**2).mean(0)), expected, rtol=5 / np.sqrt(2 * 400))
    assert likeliest_directions(covariance, rng.normal(size=(400, 2, 2)), floor, plain) is plain
    # noise below what is believed of a residual has no directions
    quiet = likeliest_directions(1e-8 * covariance, rng.normal(size=(400, 2, 2)), np.ones((2, 2)), plain)
    residuals = rng.normal(size=(400, 2, 2))
    np.testing.assert_allclose(quiet.quieten(residuals), residuals, atol=1e-3)


def test_what_an_effect_does_is_seen_across_the_loud_direction():
    """A change a tenth as large as the noise stands out where the noise has one direction, which differs each time.

    In squares it is .01 of six channels of noise of size 1. Five sixths of it lie across the loud direction, where the
    noise is .01: 5/6 (.1/.01)^2 = 83 beside six white channels.
    """
    rng = np.random.default_rng(5)
    loud = rng.normal(size=(300, 6))
    covariance = 1e-4 * np.eye(6) + loud[:, :, None] * loud[:, None, :]
    residuals = gaussian(rng, covariance).reshape(300, 3, 2)
    found = likeliest_directions(covariance, residuals, np.full((3, 2), 1e-6), Loudness(np.ones((300, 3, 2))))
    change = np.zeros((300, 3, 2))
    change[:, 1, 0] = 0.1

    def share(quieten):
        return (quieten(change) ** 2).mean() / (quieten(residuals) ** 2).mean()

    assert share(lambda r: r) <= 0.005
    assert share(lambda r: r) == pytest.approx(0.01 / 6, rel=0.3)
    assert share(found.quieten) >= 0.3
    assert share(found.quieten) == pytest.approx(83 / 6, rel=0.3)


def test_parts_of_both_kinds_are_those_of_the_whole():
    """Windows that are picked keep what they had, and volumes are those of densities."""
    rng = np.random.default_rng(6)
    residuals = rng.normal(size=(3, 10, 2, 2))
    root = rng.normal(size=(10, 4, 4))
    for one in (Loudness(rng.uniform(1, 2, (10, 2, 2))), Directions(root @ root.swapaxes(1, 2) + np.eye(4))):
        picked = np.array([1, 7])
        np.testing.assert_allclose(one.some(picked).quieten(residuals[:, picked]), one.quieten(residuals)[:, picked])
        volume = 0.0
        for window in range(10):  # the determinant of the map, column by column
            inputs = np.eye(4).reshape(4, 1, 2, 2)
            mapped = one.some(np.array([window])).quieten(inputs).reshape(4, 4)
            volume += np.linalg.slogdet(mapped)[1]
        assert one.log_volume == pytest.approx(volume)


def test_noise_of_speeds_is_found_beside_contacts():
    """Errors of the height and the pitch move all speeds by far more than their own noise, which is found all the same.

    To a factor of two; by each channel's spread alone two of them were found ten and a hundred times too small.
    """
    replay = Replay(mujoco.MjModel.from_xml_string(CART), None, [])
    rows = rides().windows(1)
    moved = noise_residuals(replay, np.zeros(0), rows, (1,), SIGMA * ([1] * 4 + [0] * 4), 0)[0, :, :, 1]
    assert (moved.std(0) > 5 * SIGMA[4:]).all()  # what the positions alone do to the speeds
    found = sensor_noise(replay, np.zeros(0), rows, Encoders.of([rows.start]))
    np.testing.assert_allclose(found[:4] / SIGMA[:4], 1.0, atol=0.25)
    assert (np.abs(np.log2(found[4:] / SIGMA[4:])) < 1).all()
