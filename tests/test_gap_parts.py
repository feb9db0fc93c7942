"""The parts of the diagnosis, each against mathematics or another implementation."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.stats import multivariate_t, ttest_1samp, wilcoxon

from nfpde.dataset import Dataset
from nfpde.effects import effect
from nfpde.errors import BadDataset
from nfpde.gap.fit import PRIOR, Fit, Fitter
from nfpde.gap.halves import alike_halves
from nfpde.gap.levels import Yardstick
from nfpde.gap.loud import loudness
from nfpde.gap.noise import Scatter, floor_of, learn_scatter
from nfpde.gap.recordings import cut_recordings, joined
from nfpde.gap.replay import Replay
from nfpde.gap.screen import screen
from nfpde.gap.trial import Court, Trial, block_test
from nfpde.gap.where import needed_forces
from nfpde.parameters import Parameter, ParameterSpace
from tests.gap_straight import ByGain
from tests.gap_systems import nominal, record

ANYTHING: Any = None


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
    space = ParameterSpace([Parameter("body_mass", "fore", low=0.5, high=2.0)])
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
        held = alike_halves(joined(cut.fit, cut.held), gap, seed)
        assert held is not None
        assert held.shared is None
        assert len(held.episodes) == 3
        assert np.isin([1, 4], held.episodes).sum() == 1
    few = cut_recordings(record(episodes=4, rows=45), 0, 0, 160)  # 4 x 11 windows: either half must hold 20
    for seed in range(8):
        held = alike_halves(joined(few.fit, few.held), np.ones(len(few.fit) + len(few.held)), seed)
        assert held is None or len(cut_recordings(record(episodes=4, rows=45), 0, 0, 160, held=held).fit) >= 20
    three = cut_recordings(record(episodes=3, rows=300), 0, 0, 160)
    assert alike_halves(joined(three.fit, three.held), np.ones(len(three.fit) + len(three.held)), 0) is None


@pytest.mark.parametrize("episodes", [3, 4, 7])
def test_an_episode_that_alone_shows_the_gap_is_shared(episodes):
    """Three windows of one episode show all there is: whatever the seed, both halves have some of them, and no row."""
    data = record(episodes=episodes, rows=400)
    cut = cut_recordings(data, 0, 0, 160)
    episode, row = (np.concatenate([getattr(cut.fit, n), getattr(cut.held, n)]) for n in ("episode", "row"))
    loud = (episode == 1) & np.isin(row, np.sort(row[episode == 1])[[2, 5, 6]])
    gap = np.where(loud, 1e4 * (1 + row), 1.0)
    for seed in range(8):
        held = alike_halves(joined(cut.fit, cut.held), gap, seed)
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


def test_a_diverged_window_is_bad_but_finite():
    """NaN residuals cost more than any sound window, and stay finite."""
    scatter: Scatter = unit_scatter(500)
    sound = np.zeros((3, 2, 4))
    lost = sound.copy()
    lost[1] = np.nan
    density = scatter.log_density(lost)
    assert np.isfinite(density).all()
    assert density[1] < density[0] - 1


def trial(effect, density, residuals):
    """A trial that leaves the same residuals in both halves."""
    fit: Any = SimpleNamespace(residuals=residuals, cost=-float(density.sum()))
    return Trial(effect, fit, density, residuals, density)


def test_what_leaves_the_gap_is_not_named():
    """Of two candidates the one that closes the gap is accepted, though the other fits better; alone it is refused."""
    rng = np.random.default_rng(8)
    block = np.arange(40) // 4
    held, gained = 3 * rng.normal(size=(40, 2, 4)), rng.uniform(1, 2, 40)
    court = Court(block, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0))
    yardstick = Yardstick(np.ones((2, 4)), rng.normal(size=(1, 40, 2, 4)))
    selection = ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick)
    friction = effect("coulomb_friction", "elbow", torque=(0.0, 1.0))
    damping = effect("viscous_damping", "elbow", damping=(0.0, 1.0))
    base = trial(None, np.zeros(40), held)
    idle = trial(friction, 5 * gained, held)
    useful = trial(damping, gained, held / 3)
    found = selection.accept(base, [idle, useful], selection._gap(base))
    assert found is not None
    assert found[1].effect is damping
    assert selection.accept(base, [idle], selection._gap(base)) is None


def test_a_second_effect_need_not_be_large_beside_the_first():
    """A hundredth of the first gap, and most of what is left, is accepted; what hides in the noise is not."""
    rng = np.random.default_rng(9)
    noise, first_gap = rng.normal(size=(40, 2, 4)), 1000.0
    court = Court(np.arange(40) // 4, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0))
    selection = ByGain(ANYTHING, None, 1, court, [], yardstick=Yardstick(np.ones((2, 4)), noise[None]))
    friction = effect("coulomb_friction", "elbow", torque=(0.0, 1.0))
    for size, named in ((3.0, True), (1.02, False)):
        left = trial(None, np.zeros(40), size * noise)
        found = selection.accept(left, [trial(friction, rng.uniform(1, 2, 40), noise)], first_gap)
        assert (found is not None) is named


@pytest.mark.parametrize(("size", "at_floor"), [(1.2, True), (1.4, False)])
def test_beside_contacts_the_floors_own_error_is_not_explained(size, at_floor, monkeypatch):
    """What may be an error of the floor, half of it, is left alone beside contacts; in smooth motion it is not."""
    noise = np.random.default_rng(11).normal(size=(40, 2, 4))
    noise /= np.sqrt((noise**2).mean())
    monkeypatch.setattr("nfpde.gap.acceptance.noise_of", lambda *a: 0.5 * noise[None])
    left, yardstick = trial(None, np.zeros(40), size * noise), Yardstick(np.ones((2, 4)), noise[None], 0.0)
    for sigma in (np.ones(4), None):
        court = Court(np.arange(40) // 4, ANYTHING, Fitter(ANYTHING, (1,)), np.zeros((2, 4)), np.zeros(0))
        selection = ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=sigma)
        assert selection.at_floor(left) is (sigma is not None and at_floor)
    monkeypatch.setattr("nfpde.gap.acceptance.noise_of", lambda *a: 2.0 * noise[None])
    assert ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=np.ones(4)).at_floor(left)


@pytest.mark.parametrize(("few", "named"), [(40.0, True), (50.0, True), (90.0, False), (400.0, False)])
def test_most_windows_must_gain_more_than_a_few_lose(few, named):
    """Squares of 1 are halved in 36 windows of 40, and from 25 become `few` in the others, which make up the mean.

    The geometric mean falls by the factor .5**.9 * (few / 25)**.1, and the mean of 3.4 becomes (18 + 4 few) / 40.
    The product of the factors is below one up to a `few` of 54.
    """
    last = (np.arange(40) >= 36)[:, None, None]
    before, after = np.where(last, 25.0, 1.0), np.where(last, few, 0.5)
    residuals = [np.sqrt(squares) * np.ones((40, 1, 2)) for squares in (before, after)]
    yardstick = Yardstick(np.ones((1, 2)), np.zeros((1, 40, 1, 2)), 0.0)
    selection = ByGain(ANYTHING, None, 1, ANYTHING, [], yardstick=yardstick)
    current, found = (trial(None, np.zeros(40), r) for r in residuals)
    assert selection.shrinks(found, current, 3.4) is named


@pytest.mark.parametrize("contacts", [True, False])
@pytest.mark.parametrize(("left", "named"), [(0.9, False), (3.0, True)])
def test_what_rounding_may_do_is_nobodys_work(left, named, contacts):
    """Without noise a gap is counted in rounding: one of that size is next to nothing, one of its threefold may be."""
    rounding, still = np.full((1, 2), 1e-9), np.zeros((1, 400, 1, 2))
    yardstick = Yardstick.of(still, still[0], 0.0, rounding)
    assert float(yardstick.floor.mean()) == pytest.approx(1.0)
    # the mean of 800 squares of normal numbers errs by sqrt(2 / 800)
    assert yardstick.rounding == pytest.approx(1.0, abs=5 * np.sqrt(2 / 800))
    sigma = np.zeros(2) if contacts else None
    selection = ByGain(ANYTHING, None, 1, ANYTHING, [], yardstick=yardstick, sigma=sigma)
    before, after = (trial(None, np.zeros(400), 1e-9 * np.sqrt(gap) + still[0]) for gap in (left, 0.1))
    assert selection.shrinks(after, before, 14.0) is named
    noisy = Yardstick.of(still + 1.0, still[0], 0.0, rounding)
    assert noisy.rounding < 1e-17


@pytest.mark.parametrize(
    ("size", "behind", "contacts", "equal"),
    [(1.02, 3.0, True, True), (1.02, 3.0, False, False), (1.8, 1e-4, True, False), (1.8, 1e-4, False, True)],
)
def test_beside_contacts_equals_are_told_by_what_they_leave(size, behind, contacts, equal, monkeypatch):
    """Who leaves as little as the best is its equal whatever the density says, who leaves much more is not."""
    rng = np.random.default_rng(12)
    noise = rng.normal(size=(40, 2, 4))
    noise /= np.sqrt((noise**2).mean())
    monkeypatch.setattr("nfpde.gap.acceptance.noise_of", lambda *a: noise[None])
    one, other = (
        effect(n, "elbow", **q)
        for n, q in (("coulomb_friction", {"torque": (0, 1)}), ("armature", {"inertia": (0, 1)}))
    )
    density = rng.uniform(9, 11, 40)
    trials = [trial(one, density, noise), trial(other, density - behind - 1e-6 * rng.normal(size=40), size * noise)]
    court = Court(np.arange(40) // 4, ANYTHING, Fitter(ANYTHING, (1,)), np.zeros((2, 4)), np.zeros(0))
    yardstick = Yardstick(np.ones((2, 4)), noise[None], 0.0)
    selection = ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=np.ones(4) if contacts else None)
    found = selection.accept(trial(None, np.zeros(40), 4.0 * noise), trials, 16.0)
    assert found is not None
    assert found[1].effect is one
    assert (trials[1] in found[1].rivals) is equal
    assert (trials[1] in found[1].close) is (size < 1.5)  # 1.8 leaves 3.2 of 16, the best 1


@pytest.mark.parametrize(("explained", "equal"), [(0.2, False), (0.8, True)])
def test_who_explains_next_to_nothing_is_no_equal_of_who_explains_little(explained, equal):
    """Beside contacts an error of the floor is a tenth of it, and of a gap of 1.06 the best leaves 1.0."""
    rng = np.random.default_rng(13)
    one, other = (
        effect(n, "elbow", **{q: (0, 1)}) for n, q in (("coulomb_friction", "torque"), ("armature", "inertia"))
    )
    noise = np.ones((40, 2, 4))
    density = rng.uniform(9, 11, 40)
    left = 1.06 - 0.06 * explained
    trials = [trial(one, density, noise), trial(other, density - 5.0, np.sqrt(left) * noise)]
    court = Court(np.arange(40) // 4, ANYTHING, Fitter(ANYTHING, (1,)), np.zeros((2, 4)), np.zeros(0))
    yardstick = Yardstick(np.ones((2, 4)), noise[None], 0.0)
    selection = ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=np.ones(4))
    assert selection._equal(1.06, trials[0], trials[1], False) is equal


@pytest.mark.parametrize(("size", "contacts", "named"), [(3.0, True, 0), (1.02, True, 1), (3.0, False, 1)])
def test_beside_contacts_fewer_parameters_are_preferred_where_they_explain_the_same(size, contacts, named, monkeypatch):
    """Of a gap of 16 the best leaves 1, and who has fewer parameters and as much density leaves 9, or next to 1."""
    rng = np.random.default_rng(14)
    noise = rng.normal(size=(40, 2, 4))
    noise /= np.sqrt((noise**2).mean())
    monkeypatch.setattr("nfpde.gap.acceptance.noise_of", lambda *a: noise[None])
    bounds = {"coulomb": (0.0, 1.0), "static": (0.0, 1.0), "speed": (0.01, 1.0)}
    effects = [effect("stribeck_friction", "elbow", **bounds), effect("coulomb_friction", "elbow", torque=(0.0, 1.0))]
    density = rng.uniform(9, 11, 40)
    apart = rng.normal(size=40)
    densities = density, density - 1e-4 + 0.1 * (apart - apart.mean())
    trials = [trial(e, d, s * noise) for e, d, s in zip(effects, densities, (1.0, size), strict=True)]
    court = Court(np.arange(40) // 4, ANYTHING, Fitter(ANYTHING, (1,)), np.zeros((2, 4)), np.zeros(0))
    yardstick = Yardstick(np.ones((2, 4)), noise[None], 0.0)
    selection = ByGain(ANYTHING, None, 1, court, [], yardstick=yardstick, sigma=np.ones(4) if contacts else None)
    found = selection.accept(trial(None, np.zeros(40), 4.0 * noise), trials, 16.0)
    assert found is not None
    assert found[1].effect is effects[named]


def test_a_sure_effect_is_named_beside_a_better_fit_that_is_not_sure():
    """Where most density is gained in one block alone, the candidate that gains in every block is accepted."""
    rng = np.random.default_rng(10)
    block = np.arange(40) // 4
    held = 3 * rng.normal(size=(40, 2, 4))
    court = Court(block, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0))
    selection = ByGain(
        ANYTHING, None, 1, court, [], yardstick=Yardstick(np.ones((2, 4)), rng.normal(size=(1, 40, 2, 4)))
    )
    friction = effect("coulomb_friction", "elbow", torque=(0.0, 1.0))
    damping = effect("viscous_damping", "elbow", damping=(0.0, 1.0))
    base = trial(None, np.zeros(40), held)
    lucky = trial(friction, np.where(block == 0, 40.0, rng.normal(size=40)), held / 3)
    steady = trial(damping, rng.uniform(1, 2, 40), held / 3)
    found = selection.accept(base, [lucky, steady], selection._gap(base))
    assert found is not None
    assert found[1].effect is damping
    assert selection.accept(base, [lucky], selection._gap(base)) is None
