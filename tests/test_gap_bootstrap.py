"""What candidates gain by noise alone, and what that asks of them near the floor."""

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import Effect, effect
from nfpde.gap.bootstrap import NoiseAlone, made_by
from nfpde.gap.levels import Yardstick
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.select import Selection
from nfpde.gap.stage import Stage, first_fit, in_noise
from nfpde.gap.trial import Court, Trial
from tests.test_gap_contacts import BLOCK, pushes

ANYTHING: Any = None

MASS = """
<mujoco><option timestep="0.002" gravity="0 0 0"/>
<worldbody><body><joint name="along" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/></body></worldbody></mujoco>
"""


def stage_of(data: Dataset, model: mujoco.MjModel) -> Stage:
    """A model without free parameters on recordings."""
    recordings = cut_recordings(data, 0, 0, 160)
    base, court = first_fit(Replay(model, None, []), recordings, np.zeros((1, 0)), capped=True)
    return in_noise(base, court, recordings, 0)


def beside(stage: Stage, what: Effect, value: float) -> Trial:
    """An effect fitted to the recordings from a value."""
    court = stage.court
    replay = Replay(stage.base.fit.replay.sim.model, None, [what])
    fit = court.fitter.start(replay, np.array([[value]]), stage.base.fit.scatter)
    return court.judge(what, court.converged(fit))


def test_windows_without_noise_are_the_models_own():
    """The model that made them leaves nothing; noise is on every state as it was asked for, starts included."""
    stage = stage_of(pushes(0.5, noise=1e-4), mujoco.MjModel.from_xml_string(BLOCK))
    fit, windows = stage.base.fit, stage.court.fitter.windows
    quiet = made_by(fit, windows, np.zeros(4), np.random.default_rng(0))
    np.testing.assert_array_equal(quiet.start, windows.start)
    left = stage.court.fitter.residuals_at(fit.replay, fit.xi[None])[0]
    again = fit.replay.residuals(fit.xi[None], quiet, stage.court.fitter.horizons)[0]
    assert np.abs(again).max() < 1e-12 < np.abs(left).max()
    sigma = np.array([1e-4, 2e-4, 3e-3, 4e-3])
    noisy = made_by(fit, windows, sigma, np.random.default_rng(1))
    for rows in (slice(0, 1), slice(1, None)):
        errors = (noisy.state - quiet.state)[:, rows].reshape(-1, 4)
        # a standard deviation of n draws errs by 1 / sqrt(2 n)
        np.testing.assert_allclose(errors.std(0) / sigma, 1.0, atol=5 / np.sqrt(2 * len(errors)))


def test_what_noise_alone_gives_is_next_to_nothing_in_smooth_motion():
    """Damping of what is not damped acts, and is fitted to noise: that loses half a nat where no fit saw it.

    Of three draws the best gains three nats with a chance below one in fifty (half a chi squared of one). Without noise
    nothing is gained, from wherever it begins, beyond the hundredth of a nat at which a fit stops.
    """
    model = mujoco.MjModel.from_xml_string(MASS)
    rng, episodes = np.random.default_rng(3), []
    for number in range(4):
        speed = rng.normal(size=(1, 1)) * np.ones((200, 1))
        qpos, time = 0.01 * speed * np.arange(200)[:, None], 0.01 * np.arange(200)
        errors = rng.normal(size=(2, 200, 1))
        episodes.append(
            Episode(str(number), time, qpos + 1e-3 * errors[0], speed + 1e-2 * errors[1], np.zeros((200, 0)))
        )
    stage = stage_of(Dataset(episodes), model)
    windows = len(stage.court.held.windows)
    for begin in (0.1, 5.0):
        damping = beside(stage, effect("viscous_damping", "along", damping=(0.0, 10.0)), begin)
        noisy = NoiseAlone(stage.court, stage.base, stage.sigma)
        gains = [noisy.gain(damping, draw) for draw in range(3)]
        # noise that asks for less than no damping, as every second draw does, changes nothing
        assert any(noisy.gain(damping, draw) != 0.0 for draw in range(8))
        assert windows * max(gains) < 3.0
        assert noisy.gives(damping, max(gains))
        assert not noisy.gives(damping, 3.0 / windows)
        quiet = NoiseAlone(stage.court, stage.base, np.zeros(2))
        assert abs(windows * quiet.gain(damping, 0)) < 1e-2


class Touching(Selection):
    """A selection where contacts are, with a floor of one; noise alone gives `given` to a candidate."""

    given: Any = None

    def floor(self, trial):
        return 1.0

    def given_by_noise(self, trial, current, sigma, gain):
        assert self.given is not None
        return self.given >= gain


@pytest.mark.parametrize(
    ("gap", "given", "named"),
    [(1.4, 0.0, True), (1.4, 0.09, True), (1.4, 0.11, False), (9.0, 1.0, False), (11, None, True)],
)
def test_near_the_floor_a_candidate_must_gain_ten_times_what_noise_gives_it(gap, given, named):
    """It gains one nat a window in all of them; a gap beyond ten floors is no noise, and nobody asks."""
    noise = np.random.default_rng(2).choice([-1.0, 1.0], size=(40, 2, 4))
    block = np.arange(40) // 4
    court = Court(block, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0))
    chosen = Touching(
        ANYTHING, None, 1, court, [], yardstick=Yardstick(np.ones((2, 4)), noise[None], 0.0), sigma=np.ones(4)
    )
    chosen.given = given

    def trial(what, density, size):
        fit: Any = SimpleNamespace(residuals=size * noise)
        return Trial(what, fit, density, size * noise, density)

    base = trial(None, np.zeros(40), np.sqrt(gap))
    better = trial(effect("ground_height", height=(-0.1, 0.1)), np.ones(40) + 1e-3 * np.arange(40) / 40, 1.0)
    assert chosen.gap_of(base) == pytest.approx(gap)
    assert (chosen.accept(base, [better], gap) is not None) is named


def test_what_lies_below_the_floors_own_error_is_asked_about_at_first():
    """Above what noise leaves, however little, candidates may try; below it, none does beside contacts."""
    yardstick: Any = SimpleNamespace(gap=lambda residuals: residuals)
    chosen = Touching(ANYTHING, None, 1, ANYTHING, [], yardstick=yardstick, sigma=np.ones(4))
    for gap, hidden in ((1.05, True), (1.2, False)):
        fit: Any = SimpleNamespace(residuals=np.full(3, gap))
        base = Trial(None, fit, np.zeros(3), np.full(3, gap), np.zeros(3))
        assert chosen.in_noise(base) is hidden
        assert chosen.at_floor(base)
