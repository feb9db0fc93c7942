"""What candidates gain by noise alone, and what that asks of them near the floor."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import Effect, effect
from nfpde.gap.acceptance import NOISE_TIMES
from nfpde.gap.bootstrap import DRAWS, FEWEST, FIRST, HIDDEN, PLAIN, STILL, NoiseAlone, judging, no_more_than
from nfpde.gap.fit import Fitter
from nfpde.gap.levels import Yardstick
from nfpde.gap.loud import Loudness
from nfpde.gap.natural import measured, natural
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.select import Selection
from nfpde.gap.stage import Stage, first_fit, in_noise
from nfpde.gap.trial import LEAST_GAIN, Court, Trial

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


def test_noise_alone_gives_nothing_in_smooth_motion():
    """Damping of what is not damped is fitted to noise, and gains too little to be looked at, from wherever it begins.

    Five nats come with a chance of one in six hundred (half a chi squared of one). Damping that is there gains more in
    every draw of windows that a damped model has made, once it is taken from that model.
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
    what = effect("viscous_damping", "along", damping=(0.0, 10.0))
    for begin in (0.1, 5.0):
        damping = beside(stage, what, begin)
        for sigma in (stage.sigma, np.zeros(2)):
            noise = NoiseAlone(stage.court, stage.base, sigma)
            assert [noise.gain(damping, draw) for draw in range(3)] == [0.0, 0.0, 0.0]
            assert not noise.gives(damping, 1e-9)
    there = NoiseAlone(stage.court, stage.base, stage.sigma)
    there._draw(2)
    damped = replace(damping.fit, xi=np.ones(1))
    rng = np.random.default_rng(1)
    for draw, (court, _) in enumerate(list(there._made)):
        truths = [natural(damped.replay, damped.xi, h.windows) for h in (court.fitter, court.held)]
        halves = [
            measured(damped.replay, truth, stage.sigma, court.fitter.windows, court.encoders, rng) for truth in truths
        ]
        court = judging(stage.court, stage.base.fit, halves, stage.sigma, draw)
        base = court.judge(
            None, court.settle(court.fitter.start(stage.base.fit.replay, np.zeros((1, 0)), stage.base.fit.scatter))
        )
        there._made[draw] = court, base
        assert there.gain(damping, draw) > LEAST_GAIN / len(court.held.windows)


def test_a_pit_that_a_candidate_leads_out_of_is_not_its_gain(monkeypatch):
    """A parameter has a pit at 0, and one at 1 that fits 20 nats better; 2 of them are the candidate's.

    Without it nothing leads from one to the other. Where it is worth less than chance, it counts for nothing.
    """
    what = effect("coulomb_friction", "along", torque=(0.0, 1.0))

    def made(trial: Trial, pit: float, worth: float) -> Trial:
        with_effect = trial.effect is not None
        gain = 20.0 * pit + (worth if with_effect else 0.0)
        fit = replace_fit(trial.fit, [pit, 0.1] if with_effect else [pit], -gain)
        return Trial(trial.effect, fit, np.full(8, gain), ANYTHING, ANYTHING)

    def replace_fit(fit: Any, xi: list[float], cost: float) -> Any:
        return SimpleNamespace(xi=np.array(xi), cost=cost, replay=fit.replay, scatter=ANYTHING)

    half: Any = SimpleNamespace(windows=np.zeros(8))
    court = Court(np.arange(8) // 2, half, ANYTHING, np.zeros((1, 2)), np.zeros(1), ANYTHING)
    exact = list[float]()
    for worth, gain in ((6.0, 6.0), (4.0, 0.0)):

        def refitted(
            court: Court, trial: Trial, guesses: np.ndarray, scatter: Any, least: float, worth: float = worth
        ) -> Trial:
            # the candidate finds its way from any place
            exact.append(least)
            return made(trial, 1.0 if trial.effect is not None else float(guesses[:, 0].max() > 0.5), worth)

        monkeypatch.setattr("nfpde.gap.bootstrap._refitted", refitted)
        bare: Any = SimpleNamespace(replay=SimpleNamespace(effects=[], columns=ANYTHING))
        full: Any = SimpleNamespace(replay=SimpleNamespace(effects=[what], columns=lambda i: slice(1, 2)))
        current = Trial(None, replace_fit(bare, [0.0], 0.0), np.zeros(8), ANYTHING, ANYTHING)
        candidate = Trial(what, replace_fit(full, [0.0, 0.2], 0.0), np.zeros(8), ANYTHING, ANYTHING)
        noise = NoiseAlone(court, current, np.zeros(2))
        noise._made.append((court, made(current, 0.0, worth)))
        assert noise.gain(candidate, 0) == gain
        assert set(exact) == {LEAST_GAIN}
        exact.clear()
        # a twentieth of what all eight windows must gain tells as well whether noise gives it
        again = NoiseAlone(court, current, np.zeros(2))
        again._made.append((court, made(current, 0.0, worth)))
        assert again.gain(candidate, 0, enough=100.0) == gain
        assert set(exact) == {0.05 * 8 * 100.0}
        exact.clear()


class Touching(Selection):
    """A selection where contacts are, with a floor of one; noise alone gives `given` to a candidate."""

    given: Any = None

    def floor(self, trial):
        return 1.0

    def given_by_noise(self, trial, current, sigma, gain):
        assert self.given is not None
        return self.given >= gain


@pytest.mark.parametrize(
    ("gap", "given", "settled", "named"),
    [
        (1.4, 0.0, None, True),
        (1.4, 0.9 / NOISE_TIMES, None, True),
        (1.4, 1.1 / NOISE_TIMES, None, False),
        (9.0, 1.0, None, False),
        (11, None, None, True),
        (1.4, None, "ground_height", True),
        (1.4, 1.1 / NOISE_TIMES, "contact_softness", False),
    ],
)
def test_near_the_floor_a_candidate_must_gain_more_than_noise_gives_it(gap, given, settled, named):
    """It gains one nat a window in all of them; a gap beyond ten floors is no noise, and nobody asks.

    Nor is asked about one that stays anyway, where nothing but the others' worth is the question.
    """
    noise = np.random.default_rng(2).choice([-1.0, 1.0], size=(40, 2, 4))
    block = np.arange(40) // 4
    court = Court(block, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0), ANYTHING)
    chosen = Touching(
        ANYTHING, None, 1, court, [], yardstick=Yardstick(np.ones((2, 4)), noise[None], 0.0), sigma=np.ones(4)
    )
    chosen.given = given

    def trial(what, density, size):
        fit: Any = SimpleNamespace(residuals=size * noise, replay=SimpleNamespace(effects=()))
        return Trial(what, fit, density, size * noise, density)

    base = trial(None, np.zeros(40), np.sqrt(gap))
    floor = effect("ground_height", height=(-0.1, 0.1))
    better = trial(floor, np.ones(40) + 1e-3 * np.arange(40) / 40, 1.0)
    assert chosen.gap_of(base) == pytest.approx(gap)
    stays = None if settled is None else (settled, floor.place)
    assert (chosen.accept(base, [better], gap, settled=stays) is not None) is named


def test_what_lies_below_the_floors_own_error_is_asked_about_at_first():
    """Above what noise leaves, however little, candidates may try; below it, none does beside contacts."""
    yardstick: Any = SimpleNamespace(gap=lambda residuals: residuals)
    chosen = Touching(ANYTHING, None, 1, ANYTHING, [], yardstick=yardstick, sigma=np.ones(4))
    for gap, hidden in ((1.05, True), (1.2, False)):
        fit: Any = SimpleNamespace(residuals=np.full(3, gap))
        base = Trial(None, fit, np.zeros(3), np.full(3, gap), np.zeros(3))
        assert chosen.in_noise(base) is hidden
        assert chosen.at_floor(base)


WINDOWS = 200


class Counted:
    """Windows that know their numbers."""

    def __init__(self, count: int | np.ndarray) -> None:
        self.number = np.arange(count) if isinstance(count, int) else count

    def __len__(self) -> int:
        return len(self.number)

    def __getitem__(self, index: np.ndarray) -> "Counted":
        return Counted(self.number[index])


class Given(NoiseAlone):
    """What noise gives in each draw is known [nats over all windows]."""

    def __init__(self, given: list[float]) -> None:
        self._court: Any = SimpleNamespace(held=SimpleNamespace(windows=range(WINDOWS)))
        self.given, self.draws = given, 0

    def _part(self, enough: float) -> NoiseAlone:
        return self

    def gain(self, trial, draw, enough=0.0):
        self.draws += 1
        return self.given[draw] / WINDOWS


@pytest.mark.parametrize(
    ("given", "enough", "gives", "draws"),
    [
        # Student's quantiles of 2 and 3 degrees at 0.05 / 7 and 0.05 / 6 are 8.277 and 4.857
        ([0.0] * DRAWS, 9.6 * HIDDEN, False, FIRST),
        ([0.0] * DRAWS, 9.5 * HIDDEN, False, 4),
        ([0.0] * DRAWS, 1.9 * HIDDEN, False, DRAWS),  # of the last one 1.860 at 8 degrees and 0.05
        ([0.0] * 8 + [50.0, 0.0], 1.9 * HIDDEN, True, 9),
        ([0.0, 100.0, 200.0] + [0.0] * 7, 1055.0, False, 4),  # the mean of three is 100, so is their deviation
        ([0.0, 100.0, 200.0] + [0.0] * 7, 1056.0, False, FIRST),
        ([0.0, 100.0], 99.0, True, 2),
        ([-1000.0] * DRAWS, 1.9 * HIDDEN, False, DRAWS),  # what noise takes says nothing of what it gives
    ],
)
def test_draws_end_where_the_first_ones_give_next_to_nothing(given, enough, gives, draws):
    noise = Given(given)
    assert noise.gives(ANYTHING, enough / WINDOWS) is gives
    assert noise.draws == draws


@pytest.mark.parametrize(
    ("windows", "enough", "count"),
    [
        (2 * FEWEST, PLAIN / FEWEST, FEWEST),
        (2 * FEWEST - 1, PLAIN / FEWEST, None),  # hardly fewer than all
        (1000, 100.0, FEWEST),
        (1000, 0.99 * PLAIN / FEWEST, 2 * FEWEST),
        (1000, PLAIN / (4 * FEWEST), 4 * FEWEST),
        (1000, 0.99 * PLAIN / (4 * FEWEST), None),  # by chance as much may be gained on half of them
        (3000, 0.0, None),
    ],
)
def test_a_part_of_many_windows_is_asked_where_much_is_to_be_gained(windows, enough, count, monkeypatch):
    """By window as much must be gained there as on all."""
    asked: list[int] = []

    def gain(noise: NoiseAlone, trial: Any, draw: int, enough: float) -> float:
        asked.append(len(noise._court.held.windows))
        return enough if draw else 0.0

    def court_of(count: int) -> Any:
        return SimpleNamespace(held=SimpleNamespace(windows=range(count)), some=court_of)

    monkeypatch.setattr(NoiseAlone, "gain", gain)
    assert NoiseAlone(court_of(windows), ANYTHING, np.zeros(2)).gives(ANYTHING, enough)
    assert set(asked) == {count or windows}


def test_part_of_a_court():
    """As many windows of either half all over, each with its block and its noise."""
    windows: Any = Counted
    held, fitter = (Fitter(windows(n), (1,), Loudness(np.arange(n, dtype=float)[:, None, None])) for n in (90, 40))
    court = Court(np.arange(90) // 3, fitter, held, np.zeros((1, 2)), np.zeros(1), ANYTHING, quiet=ANYTHING)
    part = court.some(45)
    assert len(part.fitter.windows) == 40  # all there are
    assert len(part.held.windows) == 45
    where = vars(part.held.windows)["number"]
    assert (where[0], where[-1], np.diff(where).max()) == (0, 89, 3)
    assert (part.block == where // 3).all()
    for half in (part.fitter, part.held):
        assert isinstance(half.noise, Loudness)
        assert (half.noise.size[:, 0, 0] == vars(half.windows)["number"]).all()


@pytest.mark.parametrize("count", range(FIRST, DRAWS))
def test_none_of_the_draws_to_come_gives_more_but_by_the_stated_chance(count):
    """Of normal draws as many sequences as stated, or fewer (Bonferroni), surpass what is said of them.

    The share of 4000 sequences is known to three standard errors of the stated chance, a hundredth.
    """
    draws = 100.0 + 7.0 * np.random.default_rng(count).normal(size=(4000, DRAWS))
    surpassed = [row[count:].max() > no_more_than(row[:count], 0.0) for row in draws]
    assert 0.5 * STILL < np.mean(surpassed) < STILL + 3 * (STILL / 4000) ** 0.5
