"""The parts of the diagnosis, each against mathematics or another implementation."""

import json
import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.stats import multivariate_t, ttest_1samp, wilcoxon

from nfpde.dataset import Dataset
from nfpde.effects import effect
from nfpde.errors import BadDataset
from nfpde.gap.fit import PRIOR, Fit, Fitter
from nfpde.gap.halves import FEWEST, alike_halves
from nfpde.gap.loud import loudness
from nfpde.gap.noise import Scatter, floor_of, learn_scatter
from nfpde.gap.recordings import cut_recordings, joined
from nfpde.gap.replay import Replay
from nfpde.gap.screen import screen
from nfpde.gap.trial import block_test
from nfpde.gap.where import needed_forces
from nfpde.parameters import Parameter, ParameterSpace
from tests.gap_reports import arm, gap_report
from tests.gap_systems import nominal, record

ANYTHING: Any = None
FIELDS = ("time", "qpos", "qvel", "ctrl")


class Line(Replay):
    """A replay whose residuals are linear in its parameters: A xi - b, for two degrees of freedom of four channels."""

    effects = ()

    def __init__(self, matrix, target, low, high):
        self.matrix, self.target, self.low, self.high = matrix, target, np.array(low), np.array(high)

    def residuals(self, xi, windows, horizons, force=None):
        return (np.atleast_2d(xi) @ self.matrix.T - self.target).reshape(len(xi), -1, 2, 4)


def unit_scatter(windows, nv=2, channels=4):
    rng = np.random.default_rng(0)
    return learn_scatter(rng.normal(size=(windows, nv, channels)), 0, np.full((nv, channels), 1e-3))


def test_least_squares_in_a_box_against_scipy():
    """A linear problem ends where SciPy's bounded least squares ends, bounds that bind included."""
    rng = np.random.default_rng(1)
    a, truth = rng.normal(size=(60 * 8, 3)), np.array([0.7, 0.2, 1.4])  # the last lies beyond its bound
    b = a @ truth + 0.1 * rng.normal(size=len(a))
    line = Line(a, b, [0, 0, 0], [1, 1, 1])
    scatter = unit_scatter(4000)
    white = np.linalg.norm(scatter.whiten(np.eye(8).reshape(8, 2, 4)), axis=(1, 2))
    assert white == pytest.approx(1.0, abs=0.1)  # the scatter is that of unit noise, so SciPy needs no weights
    fitter = Fitter(ANYTHING, (1, 2))
    fit = fitter.improve(fitter.start(line, np.array([[0.5, 0.5, 0.5]]), scatter), 20)
    rows = np.vstack([a, np.eye(3) / PRIOR])
    expected = lsq_linear(rows, np.concatenate([b, np.full(3, 0.5) / PRIOR]), bounds=(0, 1)).x
    assert fit.xi == pytest.approx(expected, abs=5e-3)  # 4000 draws give the scatter to about 2 %


def test_standard_errors_cover():
    """Estimates scatter by their standard errors: mean squared ratio 1 within 4 sigma of its chi-squared."""
    rng = np.random.default_rng(2)
    a = rng.normal(size=(50 * 8, 2))
    scatter = unit_scatter(4000)
    fitter = Fitter(ANYTHING, (1, 2))
    ratios = []
    for _ in range(60):
        line = Line(a, a @ [0.5, 0.5] + rng.normal(size=len(a)), [-4, -4], [5, 5])
        fit = fitter.improve(fitter.start(line, np.array([[0.4, 0.6]]), scatter), 10)
        ratios.append((fit.xi - 0.5) / fitter.linearise(fit).standard_errors)
    # 120 ratios, the sandwich's own error of 50 windows (10 %) included
    assert np.mean(np.square(ratios)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 120) + 0.2)


def test_density_is_that_of_a_multivariate_t():
    """The log density of windows equals SciPy's, summed over degrees of freedom."""
    rng = np.random.default_rng(3)
    tails = rng.standard_t(4, size=(400, 2, 3))
    scatter = learn_scatter(tails, 0, np.full((2, 3), 1e-4))
    r = rng.normal(size=(7, 2, 3))
    expected = np.zeros(7)
    for d, noise in enumerate(scatter.noises):
        shape = np.linalg.inv(noise.whitener @ noise.whitener.T)
        df = noise.degrees if noise.degrees < 1e6 else np.inf
        frozen: Any = multivariate_t
        expected += frozen(np.zeros(3), shape, df=df).logpdf(r[:, d])
    assert scatter.log_density(r) == pytest.approx(expected, rel=1e-9)


def test_degrees_of_freedom_scatter_each_by_itself():
    """What is learned of one does not depend on the others, nor on windows in which it diverged.

    EM stops where weights change by less than a thousandth; a sum in another order may let it go on once more.
    """
    rng = np.random.default_rng(5)
    residuals = rng.normal(size=(120, 3, 2)) * np.array([1.0, 1e-3, 20.0])[:, None]
    residuals[:, 1] /= np.sqrt(rng.chisquare(3, size=(120, 1)) / 3)
    residuals[7:40, 0, 1] = np.nan
    residuals[5, 2] = np.inf
    residuals[:, 2, 1] += residuals[:, 2, 0]
    floor = np.full((3, 2), 1e-9)
    together = learn_scatter(residuals, 6, floor).noises
    for dof, noise in enumerate(together):
        own = residuals[np.isfinite(residuals[:, dof]).all(1), dof][:, None]
        (alone,) = learn_scatter(own, 2, floor[[dof]]).noises
        assert noise.degrees == alone.degrees
        covariances = [np.linalg.inv(n.whitener @ n.whitener.T) for n in (noise, alone)]
        np.testing.assert_allclose(*covariances, rtol=1e-3, atol=1e-3 * covariances[1].max())
    assert together[1].degrees < 10 < together[0].degrees


def test_block_test_is_the_better_of_two_tests():
    """With one window a block: twice the smaller p-value of SciPy's t test and signed-rank test."""
    rng = np.random.default_rng(4)
    gain = 0.1 + rng.normal(size=500)
    mean, error, p = block_test(gain, np.arange(500))
    assert mean == pytest.approx(gain.mean())
    assert error == pytest.approx(gain.std(ddof=1) / np.sqrt(500))
    both = [np.asarray(ttest_1samp(gain, 0, alternative="greater")), np.asarray(wilcoxon(gain, alternative="greater"))]
    assert p == pytest.approx(2 * min(test[1] for test in both))


def test_false_alarms_of_the_block_test_are_rare():
    """Gains of mean zero pass at level 5 % in at most 5 % of cases."""
    rng = np.random.default_rng(5)
    alarms = [block_test(rng.normal(size=60), np.repeat(np.arange(12), 5))[2] < 0.05 for _ in range(1000)]
    assert 0.01 < np.mean(alarms) < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 1000)


def test_halves_share_no_episode_and_one_episode_is_cut_in_time():
    """Held-out windows come from episodes, or from a time, that no fit sees."""
    data = record(episodes=5, rows=200)
    cut = cut_recordings(data, 3, 0, 160)
    assert not set(cut.fit.episode) & set(cut.held.episode)
    assert {data.names[i] for i in cut.held.episode} == set(cut.held_out)
    assert cut.fit.nhistory == 3
    single = cut_recordings(Dataset(data.episodes[:1]), 0, 0, 160)
    assert single.fit.row.max() + single.fit.horizon <= single.held.row.min()


def test_too_little_data_is_refused():
    """A handful of rows cannot carry a diagnosis, and the text says how many would."""
    with pytest.raises(BadDataset, match="too short for a diagnosis"):
        cut_recordings(record(episodes=2, rows=20), 0, 0, 160)


def test_screening_is_a_projection_on_what_parameters_cannot_do():
    """The explained share equals least squares with the change and the slopes together, less the slopes alone."""
    space = ParameterSpace([Parameter("body_mass", "fore", low=0.5, high=2.0, scale_inertia=False)])
    data = record(lambda m: m.dof_frictionloss.__setitem__(1, 0.05), noise=1e-3)
    cut = cut_recordings(data, 0, 0, 160)
    fitter = Fitter(cut.fit, cut.horizons)
    start = Replay(nominal(), space, [])
    first = start.residuals(np.array([[1.0]]), cut.fit, cut.horizons)[0]
    scatter = learn_scatter(first, 1, floor_of(first, first))
    base = fitter.linearise(fitter.start(start, np.array([[1.0]]), scatter))
    friction = effect("coulomb_friction", "elbow", torque=(0.0, 1.0))
    values = np.array([[0.4]])  # ten times too much: what is explained is a share of its change
    found = screen(fitter, base, [(friction, values)], lambda e: Replay(nominal(), space, [e]))[0]
    white = scatter.whiten(base.residuals)
    root = np.sqrt(scatter.weights(white))[..., None]
    change = found.replay.residuals(np.array([[1.0, 0.4]]), cut.fit, cut.horizons)[0]
    columns = np.stack(
        [(scatter.whiten(base.slopes[0]) * root).ravel(), ((scatter.whiten(change) - white) * root).ravel()]
    )
    y = (white * root).ravel()

    def left(rows):
        return np.linalg.lstsq(rows.T, y, rcond=None)[1][0]

    scale = np.linalg.lstsq(columns.T, -y, rcond=None)[0][1]
    assert 0 < scale < 1.5  # inside what screening allows, so that both solve one problem
    assert found.explained[0] == pytest.approx(0.5 * (left(columns[:1]) - left(columns)), rel=1e-6)


def test_the_needed_force_is_the_one_that_was_applied():
    """A constant torque that the model lacks is found in every window, on its joint."""
    data = record(force=lambda _: 0.2)
    cut = cut_recordings(data, 0, 0, 160)
    fitter = Fitter(cut.fit, cut.horizons)
    replay = Replay(nominal(), None, [])
    start = replay.residuals(np.zeros((1, 0)), cut.fit, cut.horizons)[0]
    scatter = learn_scatter(1e-4 * np.random.default_rng(0).normal(size=start.shape), 0, np.full(start.shape[1:], 1e-6))
    fit: Fit = fitter.start(replay, np.zeros((1, 0)), scatter)
    forces = needed_forces(fit, fitter, scatter, np.array([1.0, 1.0]))
    assert forces.value[:, 1] == pytest.approx(0.2, rel=0.02)  # the response is linear over a quarter second to 1-2 %
    assert np.abs(forces.value[:, 0]).max() < 0.02


def test_windows_are_as_loud_as_their_noise():
    """Windows with ten times the noise come out ten times as loud, to what twelve draws can say; alike ones as one."""
    rng = np.random.default_rng(12)
    size = np.where(np.arange(400) % 4 == 0, 10.0, 1.0)[:, None, None]
    floor = np.full((2, 4), 1e-3)
    draws = size * rng.normal(size=(12, 400, 2, 4))
    loud = loudness(draws, size * rng.normal(size=(400, 2, 4)), floor).size
    ratio = loud[::4].mean((0, 1, 2)) / loud[1::4].mean((0, 1, 2))
    assert ratio == pytest.approx(10.0, rel=0.15)  # drawn together by psi'(6) = 0.18 of a variance of logs of 4
    alike = loudness(rng.normal(size=(12, 400, 2, 4)), rng.normal(size=(400, 2, 4)), floor).size
    assert alike == pytest.approx(1.0, abs=0.15)  # the draws alone would scatter by 0.2
    assert (alike**2).mean(0) == pytest.approx(1.0, rel=0.02)
    # noise below what is believed of a residual makes no difference
    assert loudness(1e-5 * draws, size * rng.normal(size=(400, 2, 4)), floor).size == pytest.approx(1.0, abs=1e-3)
    # residuals that do not follow the noise are not the noise's
    assert loudness(draws, rng.normal(size=(400, 2, 4)), floor).size == pytest.approx(1.0, abs=0.2)  # slope 0 +- 0.03


def test_halves_show_the_gap_alike():
    """Of two episodes that show something, one is fitted and one held out, whatever the seed; three are left to it."""
    cut = cut_recordings(record(episodes=6, rows=200), 0, 0, 160)
    episode = np.concatenate([cut.fit.episode, cut.held.episode])
    gap = np.where(np.isin(episode, [1, 4]), 9.0, 1.0)
    for seed in range(8):
        held = alike_halves((every := joined(cut.fit, cut.held)), gap, seed, every)
        assert held is not None
        assert held.shared is None
        assert len(held.episodes) == 3
        assert np.isin([1, 4], held.episodes).sum() == 1
    few = cut_recordings(record(episodes=4, rows=45), 0, 0, 160)  # 4 x 11 windows: either half must hold 20
    for seed in range(8):
        held = alike_halves((every := joined(few.fit, few.held)), np.ones(len(every)), seed, every)
        assert held is None or len(cut_recordings(record(episodes=4, rows=45), 0, 0, 160, held=held).fit) >= 20
    three = cut_recordings(record(episodes=3, rows=300), 0, 0, 160)
    every = joined(three.fit, three.held)
    assert alike_halves(every, np.ones(len(every)), 0, every) is None


@pytest.mark.parametrize("episodes", [3, 4, 7])
def test_an_episode_that_alone_shows_the_gap_is_shared(episodes):
    """Three windows of one episode show all there is: whatever the seed, both halves have some of them, and no row."""
    data = record(episodes=episodes, rows=400)
    cut = cut_recordings(data, 0, 0, 160)
    episode, row = (np.concatenate([getattr(cut.fit, n), getattr(cut.held, n)]) for n in ("episode", "row"))
    loud = (episode == 1) & np.isin(row, np.sort(row[episode == 1])[[2, 5, 6]])
    gap = np.where(loud, 1e4 * (1 + row), 1.0)
    for seed in range(8):
        held = alike_halves((every := joined(cut.fit, cut.held)), gap, seed, every)
        assert held is not None
        again = cut_recordings(data, 0, 0, 160, held=held)
        sides = [np.isin(row[loud], half.row[half.episode == 1]).sum() for half in (again.fit, again.held)]
        assert sorted(sides) == [1, 2]
        first, last = (half[np.flatnonzero(half.episode == 1)] for half in (again.fit, again.held))
        assert first.row.max() + first.horizon < last.row.min()
        assert not set(again.fit.episode) & set(again.held.episode) - {1}
        assert [name for name in again.held_out if "row" in name] == [f"{data.names[1]} from row {held.row}"]
        rows = again.rows.row[again.rows.episode == 1]
        assert rows.min() >= held.row


@pytest.mark.parametrize("episodes", [1, 2, 7])
def test_halves_change_places(episodes):
    """What was held out is fitted, and the other way round; episodes and rows are named, none is in both."""
    data = record(episodes=episodes, rows=400)
    one, other = (cut_recordings(data, 0, 0, 160, swapped=swapped) for swapped in (False, True))
    places = [
        {(e, r) for e, r in zip(h.episode, h.row, strict=True)} for h in (one.fit, one.held, other.fit, other.held)
    ]
    assert places[:2] == places[:1:-1]
    if episodes == 1:
        assert [names.held_out for names in (one, other)] == [("0 from row 199",), ("0 up to row 199",)]
    else:
        assert sorted(one.held_out + other.held_out) == sorted(data.names)


def test_a_diverged_window_is_bad_but_finite():
    """NaN residuals cost more than any sound window, and stay finite."""
    scatter: Scatter = unit_scatter(500)
    sound = np.zeros((3, 2, 4))
    lost = sound.copy()
    lost[1] = np.nan
    density = scatter.log_density(lost)
    assert np.isfinite(density).all()
    assert density[1] < density[0] - 1


@pytest.mark.parametrize("rows", [[6000, 200], [1000, 30], [3000, 60, 60]])
def test_short_episodes_beside_a_long_one_do_no_harm(rows):
    """What one long recording alone would be enough for is enough with short ones beside it, whatever the seed."""
    data = record(episodes=1, rows=max(rows))
    (whole,) = data
    parts = [replace(whole, name=str(i), **{f: getattr(whole, f)[:n] for f in FIELDS}) for i, n in enumerate(rows)]
    for seed in range(3):
        cut = cut_recordings(Dataset(parts), 0, seed, 160)
        assert min(len(cut.fit), len(cut.held)) >= FEWEST


def test_halves_leave_either_half_long_windows():
    """Where all long windows would lie in one half, nothing is chosen, as there would be nothing to hold out."""
    data = record(episodes=6, rows=200)
    cut = cut_recordings(data, 0, 0, 160)
    every = joined(cut.fit, cut.held)
    chosen = alike_halves(every, np.ones(len(every)), 0, every)
    assert chosen is not None
    one_sided = every[np.flatnonzero(~chosen.late(every))]
    assert alike_halves(every, np.ones(len(every)), 0, one_sided) is None


@pytest.mark.parametrize(("rows", "lead", "first"), [(400, 25, 26), (60, 25, 10), (60, 0, 0)])
def test_short_episodes_leave_out_what_they_can_spare(rows, lead, first):
    """In windows 26 rows apart the first; of eleven that are five apart two, as three would be more than a fifth."""
    data = record(episodes=20, rows=rows)
    every, cut = (cut_recordings(data, 0, 0, 1000, rows_left) for rows_left in (0, lead))
    assert [min(half.row.min() for half in (c.fit, c.held)) for c in (every, cut)] == [0, first]
    whole, left = (len(c.fit) + len(c.held) for c in (every, cut))
    assert left >= 0.8 * whole


def test_memory_is_that_of_the_windows_that_are_used():
    """Four times as long a recording with a long history takes no four times the memory."""
    peaks = []
    for rows in (1000, 4000):
        (whole,) = record(episodes=1, rows=1000)
        repeated = {f: np.concatenate([getattr(whole, f)] * (rows // 1000)) for f in FIELDS[1:]}
        data = Dataset([replace(whole, time=0.01 * np.arange(rows), **repeated)])
        tracemalloc.start()
        cut_recordings(data, 400, 0, 20)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]


def test_names_of_episodes_are_kept(tmp_path):
    """Numbers as the recordings' files have them; what is no number, or is written in another way, stays text."""
    names = ["7", "007", "²", "12", "a"]
    report = replace(gap_report(arm(), "effects"), held_out_episodes=names)
    assert json.loads(report.save(tmp_path).read_text())["held_out_episodes"] == [7, "007", "²", 12, "a"]
