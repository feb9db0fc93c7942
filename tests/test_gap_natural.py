"""Recordings as a model would have made them: states that it goes through, and the noise of the sensors on them."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import Effect, effect
from nfpde.gap.bootstrap import NoiseAlone
from nfpde.gap.brief import brief
from nfpde.gap.grain import Encoders
from nfpde.gap.natural import begun_earlier, measured, natural
from nfpde.gap.recordings import WINDOW_TIME, cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.search import Search
from nfpde.gap.stage import first_fit, in_noise
from nfpde.gap.trial import Trial
from nfpde.sim.simulator import steps_back
from tests.test_gap_contacts import BLOCK, pushes

ANYTHING: Any = None

HISTORY = 40

FACTOR = 3.0
"""To which draws are trusted to say what noise gives: the noise of the sensors is found to a third or so."""


def replay(*effects: Effect) -> Replay:
    """The block, with effects."""
    return Replay(mujoco.MjModel.from_xml_string(BLOCK), None, effects)


def rests(noise: float, seed: int = 0) -> Dataset:
    """Recordings of a block that lies on the floor, and is measured to so much [m]."""
    rng, time = np.random.default_rng(seed), 0.01 * np.arange(200)
    model = mujoco.MjModel.from_xml_string(BLOCK)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1000)
    errors = rng.normal(size=(4, 200, 4)) * noise * np.array([1.0, 1.0, 0.1, 0.1])
    return Dataset(
        [
            Episode(str(i), time, data.qpos + e[:, :2], data.qvel + e[:, 2:], np.zeros((200, 1)))
            for i, e in enumerate(errors)
        ]
    )


@pytest.mark.parametrize("nu", [0, 1])
def test_windows_of_robots_without_commands_begin_earlier_too(nu):
    """What touches a floor settles whether anybody commands it or not."""
    model = mujoco.MjModel.from_xml_string(BLOCK if nu else BLOCK[: BLOCK.index("<actuator>")] + "</mujoco>")
    episodes = [replace(e, ctrl=e.ctrl[:, :nu]) for e in pushes(0.5, noise=1e-3)]
    data, start = Dataset(episodes), Replay(model, None, [])
    touching = [(effect("ground_height", height=(-0.01, 0.01)), np.zeros((1, 1)))]
    search = Search(start, data, touching, np.zeros((1, 0)), 60, 0, ANYTHING, ANYTHING)
    windows = search.cut().fit
    there = natural(start, np.zeros(0), windows)
    early = windows.row < round(WINDOW_TIME / data.control_dt)
    moved = (there.state[:, 0] != windows.state[:, 0]).any(1)
    assert (moved | early).all()
    assert moved.sum() > 40


def test_windows_that_begin_earlier_are_those_of_the_recordings():
    """Cut from the recordings so much earlier, they are the same."""
    data = pushes(0.5)
    windows = data.windows(4, stride=7, history=HISTORY, past=HISTORY)
    late = windows[np.flatnonzero(windows.row >= HISTORY)]
    earlier = begun_earlier(late, 10)
    for i in range(0, len(late), 17):
        episode = data.episodes[late.episode[i]]
        rows = np.hstack([episode.qpos, episode.qvel])
        begin = late.row[i] - 10
        assert earlier.row[i] == begin
        np.testing.assert_array_equal(earlier.state[i], rows[begin : begin + 15])
        np.testing.assert_array_equal(earlier.ctrl[i], episode.ctrl[begin : begin + 14])
        np.testing.assert_array_equal(earlier.history[i], episode.ctrl[begin - HISTORY + 10 : begin])
        np.testing.assert_array_equal(earlier.past[i], rows[begin - HISTORY + 10 : begin])
    assert begun_earlier(late, 0) is late


@pytest.mark.parametrize("known", [0, 5, HISTORY])
def test_what_the_model_has_recorded_is_natural(known: int):
    """Recordings without noise that the model made are what it goes through, however much of the past is known."""
    windows = pushes(0.5, noise=0.0).windows(4, stride=7, history=known, past=known)
    there = natural(replay(), np.zeros(0), windows)
    # contacts multiply what rounding leaves between two runs
    np.testing.assert_allclose(there.state, windows.state, atol=1e-9)
    np.testing.assert_allclose(there.past, windows.past, atol=1e-9)


def test_a_block_that_lies_still_lies_still():
    """Measured inside the floor, or above it, it would be thrown or fall at once; begun earlier, it has come to rest.

    Rest is within the tenth part of what it moves by from where it was measured.
    """
    windows = rests(1e-3).windows(1, history=HISTORY, past=HISTORY)
    windows = windows[np.flatnonzero(windows.row >= HISTORY)]
    block = replay()
    thrown = block.predict(np.zeros((1, 0)), windows)[0][:, 0]
    there = natural(block, np.zeros(0), windows)
    speed = [np.sqrt(np.mean(states[:, 3] ** 2)) for states in (thrown, there.state[:, 0], there.state[:, 1])]
    assert max(speed[1:]) < 0.1 * speed[0]


def test_what_is_not_known_stays_as_it_was():
    """At the beginning of an episode there is no past; where commands are asked for from long ago, none is spare."""
    data = pushes(0.3)
    windows = data.windows(4, stride=7, history=HISTORY, past=HISTORY)
    first = windows[np.flatnonzero(windows.row == 0)]
    there = natural(replay(), np.zeros(0), first)
    np.testing.assert_array_equal(there.start, first.start)
    np.testing.assert_array_equal(there.past, first.past)
    np.testing.assert_allclose(there.target, replay().predict(np.zeros((1, 0)), first)[0], atol=1e-12)
    slow = replay(effect("actuation_delay", "along", delay=(0.0, 0.01 * HISTORY - 0.01)))
    assert steps_back(slow.sim.memory_time, windows.control_dt) == HISTORY
    np.testing.assert_array_equal(natural(slow, np.array([0.02]), windows).start, windows.start)


def test_noise_is_on_every_row_that_was_measured():
    """As large as it was asked for, on the past as on the rest; what was never measured stays unknown."""
    windows = pushes(0.5).windows(4, stride=7, history=HISTORY, past=HISTORY)
    sigma = np.array([1e-4, 2e-4, 3e-3, 4e-3])
    noisy = measured(replay(), windows, sigma, windows, Encoders.of([windows.start]), np.random.default_rng(1))
    unknown = np.isnan(windows.past)
    np.testing.assert_array_equal(np.isnan(noisy.past), unknown)
    past = (noisy.past - windows.past)[~unknown.any(2)]
    for errors in (past, (noisy.state - windows.state)[:, 0], (noisy.state - windows.state)[:, 1:].reshape(-1, 4)):
        # a standard deviation of n draws errs by 1 / sqrt(2 n)
        np.testing.assert_allclose(errors.std(0) / sigma, 1.0, atol=5 / np.sqrt(2 * len(errors)))


def test_what_encoders_round_is_rounded():
    """A height that is read in steps lies on the same steps, and errs by the same in every row in which it rests.

    The other channels are blurred, a speed beside the rounded height as well; the variance of all errors is that asked
    for where a channel is blurred on top of being rounded.
    """
    data, step, rng = pushes(0.5), 8e-4, np.random.default_rng(2)
    zero = float(np.median(np.concatenate([e.qpos[:, 1] for e in data]))) + 0.3 * step
    episodes = []
    for episode in data:
        qpos, qvel = episode.qpos + 1e-4 * rng.normal(size=episode.qpos.shape), np.array(episode.qvel)
        qpos[:, 1] = zero + step * np.round((episode.qpos[:, 1] - zero) / step)
        qvel[:, 0] = 0.01 * np.round(qvel[:, 0] / 0.01)
        episodes.append(replace(episode, qpos=qpos, qvel=qvel))
    recorded = Dataset(episodes).windows(4, stride=7, history=HISTORY, past=HISTORY)
    truth = natural(replay(), np.zeros(0), recorded)
    sigma = np.array([1e-4, step / np.sqrt(12), np.hypot(0.01, 0.01) / np.sqrt(12), 4e-3])
    encoders = Encoders.of([np.hstack([e.qpos, e.qvel]) for e in episodes])
    noisy = measured(replay(), truth, sigma, recorded, encoders, np.random.default_rng(1))
    for column, grain, phase in ((1, step, zero), (2, 0.01, 0.0)):
        steps = (noisy.state[..., column] - phase) / grain
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    errors = noisy.state - truth.state
    height = truth.state[..., 1]
    resting = np.abs(height - np.median(height)) < 0.1 * step
    assert resting.mean() > 0.5
    apart = errors[..., 1][resting] - np.median(errors[..., 1][resting])
    same = np.abs(apart) < 0.5 * step
    assert apart[same].std() < 0.1 * step  # noise as large as what is rounded has 0.29
    # but for the rows in which the recordings show the next step: 5 standard deviations of a share of so many
    assert 1 - same.mean() == pytest.approx(encoders.flips[:, 1].sum(), abs=5 * np.sqrt(0.1 / same.size))
    for channel in (0, 2, 3):
        # 5 standard deviations of what so many draws err by; a speed of zero is rounded to itself and blurred all the
        # same, by noise as large as the rounding's
        assert errors[..., channel].std() / sigma[channel] == pytest.approx(1.0, abs=0.15 if channel == 2 else 0.05)


def test_what_rests_between_two_steps_shows_the_other_as_often_as_it_did():
    """A joint that rests is read a step higher in one row of ten and lower in one of fifty, each for one row."""
    data, step, rng = pushes(0.5, noise=0.0), 8e-4, np.random.default_rng(3)
    rest = float(np.median(np.concatenate([e.qpos[:, 1] for e in data])))
    episodes = []
    for episode in data:
        qpos, chance = np.array(episode.qpos), rng.random(len(episode))
        qpos[:, 1] = rest + step * (chance < 0.1) - step * (chance > 0.98)
        episodes.append(replace(episode, qpos=qpos))
    encoders = Encoders.of([np.hstack([e.qpos, e.qvel]) for e in episodes])
    assert encoders.steps[1] == pytest.approx(step, rel=1e-6)
    assert encoders.rest[1] == rest
    # 800 rows, of which three of four lie between two at rest: 5 standard deviations of a share of so many
    assert encoders.flips[:, 1] == pytest.approx([0.1, 0.02], abs=5 * np.sqrt(0.1 / 600))
    recorded = Dataset(episodes).windows(4, stride=7, history=HISTORY, past=HISTORY)
    truth = natural(replay(), np.zeros(0), recorded)
    sigma = np.array([1e-4, step / np.sqrt(12), 1e-3, 1e-3])
    noisy = measured(replay(), truth, sigma, recorded, encoders, np.random.default_rng(1))
    shown = np.round((noisy.state[..., 1] - rest) / step)
    found = [(shown == 1).mean(), (shown == -1).mean()]
    assert found == pytest.approx(encoders.flips[:, 1], abs=5 * np.sqrt(0.1 / shown.size))


def gains(data: Dataset, what: Effect, values: list[list[float]], length: int) -> tuple[float, list[float]]:
    """What an effect gains on recordings in windows of a length, from the best of values, and in draws of noise."""
    recordings = brief(cut_recordings(data, HISTORY, 0, 160))[length]
    base, court = first_fit(replay(), recordings, np.zeros((1, 0)), capped=True)
    stage = in_noise(base, court, recordings, 0, whole=length == 0)
    with_it = replay(what)
    fit = stage.court.fitter.start(with_it, np.array(values), stage.base.fit.scatter)
    trial: Trial = stage.court.judge(what, stage.court.converged(fit))
    noise = NoiseAlone(stage.court, stage.base, stage.sigma)
    return stage.court.gain(trial, stage.base)[0], [noise.gain(trial, draw) for draw in range(3)]


@pytest.mark.parametrize("length", [0, 1])
def test_a_softer_floor_gains_as_much_in_draws_as_by_the_noise_of_recordings(length: int):
    """What is measured too low presses: a softer floor presses less, and foretells noisy recordings better.

    The floor is as it is in the model. A draw gives as much within the factor that it is trusted to.
    """
    soft = effect("contact_softness", time_constant=(0.004, 0.2), damping_ratio=(0.1, 4.0))
    gain, given = gains(rests(3e-4), soft, [[0.05, 1.0], [0.05, 3.0], [0.02, 3.0]], length)
    assert gain > 0.5  # nats a window: no chance
    assert gain / FACTOR < min(given)
    assert max(given) < FACTOR * gain


@pytest.mark.parametrize("length", [0, 1])
def test_friction_that_is_there_gains_far_more_than_noise_gives(length: int):
    """A block on a floor more slippery than the model's, measured as badly as the resting one."""
    slippery = effect("ground_friction", sliding=(0.05, 2.0))
    gain, given = gains(pushes(0.4, noise=3e-4), slippery, [[0.35], [0.42]], length)
    assert gain > 0.5
    assert gain > FACTOR * max(given)
