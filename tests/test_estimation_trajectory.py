"""The episode-level estimator: against closed forms, on robots with known parameters, and its calibration."""

import json
from typing import Any, cast

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.stats import binom, t

import nfpde
from nfpde.benchmarks import collect, robot
from nfpde.estimation.trajectory import (
    LocalPosterior,
    TrajectoryEstimator,
    make_problem,
    smoothing_matrix,
)
from nfpde.estimation.trajectory.levenberg import linearise, start
from nfpde.estimation.trajectory.noise import Noise, Scatter
from nfpde.estimation.trajectory.population import BANDWIDTHS, leave_one_out
from nfpde.estimation.trajectory.sharpening import Kernels
from nfpde.estimation.trajectory.student import GAUSSIAN, learn_student

torch.set_num_threads(1)

SPACE = nfpde.ParameterSpace(
    [nfpde.Parameter("gain", low=-10.0, high=10.0), nfpde.Parameter("drift", low=-10, high=10)]
)
DT = 0.1


def linear_step(x, u, xi):
    """A first-order system that is linear in its parameters: x' = x + dt (gain u + drift)."""
    return x + DT * (xi[:, :1] * u + xi[:, 1:2])


def linear_simulator():
    return nfpde.CallableSimulator(linear_step, SPACE, positions=["x"])


def linear_episode(name, xi, rng, rows=40, noise=0.0, robot=None):
    """One recording of the linear system; noise on what is measured next, not on the state that goes on."""
    u = rng.normal(size=(rows, 1))
    x = np.concatenate([[[0.0]], np.cumsum(DT * (xi[0] * u[:-1] + xi[1]), axis=0)])
    # every second row is a clean start, so that windows of one step have independent residuals
    x[1::2] += noise * rng.normal(size=x[1::2].shape)
    time = DT * np.arange(rows)
    return nfpde.Episode(name, time, x, np.empty((rows, 0)), u, robot=robot)


def estimate(simulator, dataset, seed=0, **settings):
    estimator = TrajectoryEstimator(make_problem(simulator, dataset, 1), nfpde.TrajectoryConfig(**settings), seed)
    while not estimator.done:
        estimator.step()
    return estimator


def test_posterior_of_a_linear_system_is_the_least_squares_one():
    """Mode and covariance equal the closed form of linear regression, with the noise that was put in."""
    rng = np.random.default_rng(0)
    true, sigma = np.array([1.5, -0.7]), 0.05
    # the windows are single transitions with white noise on their ends
    u, starts = rng.normal(size=(400, 1)), rng.normal(size=(400, 1))
    episodes = []
    for i in range(400):
        end = starts[i] + DT * (true[0] * u[i] + true[1]) + sigma * rng.normal(size=1)
        states = np.array([starts[i], end])
        episodes.append(nfpde.Episode(f"{i}", [0, DT], states, np.empty((2, 0)), [u[i], u[i]], robot="one"))
    estimator = estimate(linear_simulator(), nfpde.Dataset(episodes))
    (posterior,) = estimator.posteriors()
    design = DT * np.column_stack([u, np.ones(400)])
    target = np.array([e.qpos[1, 0] - e.qpos[0, 0] for e in episodes])
    expected, *_ = np.linalg.lstsq(design, target, rcond=None)
    found = SPACE.to_physical(posterior.means[0])
    slope = np.diag(SPACE.width * 0.25 * (1 - np.tanh(posterior.means[0] / 2) ** 2))
    covariance = slope @ posterior.covariances[0] @ slope
    closed = sigma**2 * np.linalg.inv(design.T @ design)
    # the box is 200 posterior widths wide, so the prior moves the mode little; the tails of 400 residuals are learned
    # too, and weigh them a little unlike least squares: a quarter of a standard error. The noise, hence the
    # covariance, is known to sqrt(2 / 400) = 7 %: three of those
    np.testing.assert_allclose(found, expected, atol=0.25 * np.sqrt(closed.diagonal().min()))
    np.testing.assert_allclose(covariance, closed, rtol=0.21, atol=0.02 * closed.max())


def test_truth_of_clean_recordings_is_found_exactly():
    """Without noise, four Hoppers are found to a ten-thousandth of the box: only rounding errors stand in between."""
    hopper = robot("hopper")
    dataset, truth = collect(hopper, "mixture", episodes=4, seed=3)
    simulator = nfpde.MujocoSimulator(hopper.path, hopper.space)
    estimator = estimate(simulator, dataset, starts=2)
    best = np.array([hopper.space.to_physical(p.means[0]) for p in estimator.posteriors()])
    assert estimator.converged
    assert np.abs((best - truth.xi) / hopper.space.width).max() < 1e-4


def test_credible_regions_cover_the_truth():
    """Over 120 robots with noise, 50 % and 90 % regions hold the truth about as often as they say."""
    rng = np.random.default_rng(1)
    true = SPACE.uniform(120, rng) * 0.5
    episodes = []
    for i, xi in enumerate(true):
        for k in range(12):
            u, start = rng.normal(size=1), rng.normal(size=1)
            end = start + DT * (xi[0] * u + xi[1]) + 0.1 * rng.normal(size=1)
            episodes.append(nfpde.Episode(f"{i}/{k}", [0, DT], [start, end], np.empty((2, 0)), [u, u], robot=f"{i}"))
    estimator = estimate(linear_simulator(), nfpde.Dataset(episodes), starts=2)
    z = SPACE.to_unconstrained(true)
    squares = np.array(
        [
            (z[i] - p.means[0]) @ np.linalg.solve(p.covariances[0], z[i] - p.means[0])
            for i, p in enumerate(estimator.posteriors())
        ]
    )
    for share, limit in ((0.5, 2 * np.log(2)), (0.9, 2 * np.log(10))):  # quantiles of chi squared with 2 degrees
        hits = int((squares < limit).sum())
        # a correct method leaves this interval once in a thousand
        assert binom.ppf(0.0005, 120, share) <= hits <= binom.ppf(0.9995, 120, share), (share, hits)


def test_both_modes_of_an_ambiguous_robot_are_kept():
    """Where the sign of a parameter does not matter, both signs come out, with half the weight each."""
    space = nfpde.ParameterSpace([nfpde.Parameter("speed", low=-4.0, high=4.0)])
    simulator = nfpde.CallableSimulator(lambda x, u, xi: x + DT * xi**2 * u, space, positions=["x"])
    rng = np.random.default_rng(2)
    episodes = []
    for i in range(60):
        u, start = rng.normal(size=1), rng.normal(size=1)
        end = start + DT * 4.0 * u + 0.01 * rng.normal(size=1)
        episodes.append(nfpde.Episode(f"{i}", [0, DT], [start, end], np.empty((2, 0)), [u, u], robot="one"))
    (posterior,) = estimate(simulator, nfpde.Dataset(episodes), starts=8).posteriors()
    modes = np.sort(space.to_physical(posterior.means)[:, 0])
    np.testing.assert_allclose(modes, [-2.0, 2.0], atol=0.05)
    np.testing.assert_allclose(posterior.weights, 0.5, atol=0.05)


def test_a_jump_is_no_information():
    """A simulation that jumps between two places says nothing precise about where it jumped."""
    space = nfpde.ParameterSpace([nfpde.Parameter("level", low=-4.0, high=4.0)])

    def step(x, u, xi):
        return x + 0.5 * (xi > space.to_physical(5e-5)) + 0.01 * xi * u

    simulator = nfpde.CallableSimulator(step, space, positions=["x"])
    rng = np.random.default_rng(3)
    episodes = [
        nfpde.Episode(f"{i}", [0, DT], [[0.0], [0.01 * rng.normal()]], np.empty((2, 0)), [[1.0], [1.0]], robot="one")
        for i in range(30)
    ]
    problem = make_problem(simulator, nfpde.Dataset(episodes), 1)
    noise = Noise.alike(Scatter(np.zeros(0), np.eye(1) * 1e-4), problem.members)
    candidates = start(problem, np.zeros((1, 1)), np.array([0]), noise)
    linearise(problem, candidates, noise, np.array([0]), careful=True)
    careful = float(candidates.data_information[0, 0, 0])
    linearise(problem, candidates, noise, np.array([0]))
    assert careful < 1e-4 * float(candidates.data_information[0, 0, 0])


def test_noise_is_learned_through_outliers():
    """Nine clean residuals in ten decide the scatter; a tenth of wild ones lowers the degrees of freedom instead."""
    rng = np.random.default_rng(4)
    root = np.array([[1.0, 0.0], [0.8, 0.6]])
    r = rng.normal(size=(2000, 2)) @ root.T
    clean = learn_student([r], 0, np.full(2, 1e-9))
    wild = r.copy()
    wild[::10] *= 100.0
    robust = learn_student([wild], 0, np.full(2, 1e-9))
    scatter = np.linalg.inv(clean.whitener @ clean.whitener.T)
    # 2000 samples give variances to 3 %; the t's scatter is a little below the covariance
    np.testing.assert_allclose(scatter, root @ root.T, rtol=0.15, atol=0.05)
    assert clean.degrees >= 20 > 4 >= robust.degrees
    assert np.linalg.norm(np.linalg.inv(robust.whitener)) < 3 * np.linalg.norm(np.linalg.inv(clean.whitener))


def test_tails_are_believed_where_they_pay():
    """Few Gaussian residuals are seldom given tails; many with tails always are."""
    few, many = 0, 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        few += learn_student([rng.normal(size=(30, 2))], 0, np.full(2, 1e-9)).degrees < GAUSSIAN
        heavy = rng.normal(size=(300, 2)) / np.sqrt(rng.chisquare(3, size=(300, 1)) / 3)
        many += learn_student([heavy], 0, np.full(2, 1e-9)).degrees < GAUSSIAN
    # a gain of log(30) / 2 nats is chance once in thirty; the best of seven tails is somewhat more often, and six
    # standard deviations above that are one in four
    assert few < 15
    assert many == 60


@pytest.mark.parametrize("degrees", [2.5, 6.0])
def test_information_in_tails_is_fishers(degrees):
    """Of a location under Student's t: by quadrature of the squared score; the spread is the distribution's own."""
    n, size, law = 400, 0.3, cast(Any, t(degrees))
    draws = size * law.ppf((np.arange(n) + 0.5) / n)  # as t-distributed as 400 numbers can be
    x = np.concatenate([[0.0], np.cumsum(np.random.default_rng(0).permutation(draws))])[:, None]
    space = nfpde.ParameterSpace([nfpde.Parameter("shift", low=-4.0, high=4.0)])
    simulator = nfpde.CallableSimulator(lambda x, u, xi: x + xi, space, positions=["x"])
    episode = nfpde.Episode("a", DT * np.arange(n + 1), x, np.empty((n + 1, 0)), np.zeros((n + 1, 1)))
    problem = make_problem(simulator, nfpde.Dataset([episode]), 1)
    scatter = Scatter(np.zeros(0), np.diag((size / problem.unit) ** 2), degrees)
    noise = Noise.alike(scatter, problem.members)
    found = start(problem, np.zeros((1, 1)), np.array([0]), noise)
    linearise(problem, found, noise, np.array([0]))

    def squared_score(y):
        return ((degrees + 1) * y / (degrees + y**2)) ** 2 * law.pdf(y)

    fisher = n * quad(squared_score, -np.inf, np.inf)[0] / size**2 * (8.0 / 4) ** 2  # of z: d xi / d z is 8 / 4
    # the heaviest tails are cut off where 400 draws end, which weighs the core by 0.5 % more
    assert found.data_information[0, 0, 0] == pytest.approx(fisher, rel=0.01)
    assert scatter.spread == pytest.approx(law.std())


def test_parameters_that_do_nothing_cost_nothing():
    """The bounds of the others are what they are without them: they use up no degree of freedom."""
    rng, episodes, bounds = np.random.default_rng(3), [], []
    for i in range(40):
        u, begin = rng.normal(size=1), rng.normal(size=1)
        ends = begin + DT * (2.0 * u + 0.5) + 0.05 * rng.normal(size=1)
        episodes.append(nfpde.Episode(f"{i}", [0, DT], [begin, ends], np.empty((2, 0)), [u, u], robot="one"))
    for idle in (0, 12):
        space = nfpde.ParameterSpace([*SPACE, *(nfpde.Parameter(f"idle{i}", low=-1.0, high=1.0) for i in range(idle))])
        simulator = nfpde.CallableSimulator(linear_step, space, positions=["x"])
        (posterior,) = estimate(simulator, nfpde.Dataset(episodes)).posteriors()
        bounds.append(np.sqrt(np.diag(np.linalg.inv(posterior.fisher[0][:2, :2]))))
    # rounds end where the noise moves by less than a hundredth
    np.testing.assert_allclose(bounds[1], bounds[0], rtol=0.02)


def test_noise_never_falls_below_the_floor():
    """Perfect residuals leave the floor."""
    noise = learn_student([np.zeros((50, 3))], 0, np.full(3, 1e-9))
    np.testing.assert_allclose(np.linalg.svd(noise.whitener, compute_uv=False), 1e9)


def spikes(means, width=1e-3):
    return [LocalPosterior(np.ones(1), m[None], np.eye(len(m))[None] * width**2, np.eye(len(m))) for m in means]


def test_smoothing_predicts_robots_not_seen():
    """The bandwidth maximises the leave-one-out likelihood, covers the kinds of robots and keeps them apart."""
    rng = np.random.default_rng(5)
    centres = np.array([[-2.0, 0.0], [2.0, 1.0]])
    means = np.repeat(centres, 6, axis=0) + 0.1 * rng.normal(size=(12, 2))
    posteriors = spikes(means)
    matrix, bandwidth = smoothing_matrix(posteriors)
    kernel = matrix / bandwidth**2
    scores = [leave_one_out(posteriors, b * b * kernel) for b in BANDWIDTHS]
    assert bandwidth == BANDWIDTHS[int(np.argmax(scores))]
    width = np.sqrt(matrix.diagonal())
    assert 0.03 < width[0] < 0.5, "between a spike and the distance of the two kinds"
    fresh = np.repeat(centres, 500, axis=0) + 0.1 * rng.normal(size=(1000, 2))
    smoothed, spiky = (Kernels.of(posteriors, s).mixture() for s in (matrix, 0 * matrix))
    assert smoothed.log_density(fresh).mean() > spiky.log_density(fresh).mean()


def test_one_robot_gives_its_own_posterior():
    """Nothing is known of other robots, and nothing is made up."""
    matrix, bandwidth = smoothing_matrix(spikes(np.zeros((1, 3))))
    assert bandwidth == 0.0
    assert not matrix.any()


def test_episodes_of_one_robot_are_pooled():
    """Labels bind episodes together; without labels every episode is a robot."""
    rng = np.random.default_rng(6)
    pairs = [linear_episode(f"{i}", (1.0, 0.5), rng, robot=f"r{i // 2}") for i in range(4)]
    problem = make_problem(linear_simulator(), nfpde.Dataset(pairs), 1)
    assert problem.names == ("r0", "r1")
    assert [len(m) for m in problem.members] == [78, 78]
    loose = [linear_episode(f"{i}", (1.0, 0.5), rng) for i in range(4)]
    assert len(make_problem(linear_simulator(), nfpde.Dataset(loose), 1).members) == 4


def test_fit_says_what_each_robot_is_known_to_be(tmp_path):
    """A parameter that the recordings say nothing about is reported so, and its bound is null."""
    rng = np.random.default_rng(7)
    episodes = [linear_episode("pushed", (1.0, 0.5), rng), linear_episode("at rest", (1.0, 0.5), rng)]
    rest = episodes[1]
    still = nfpde.Episode("at rest", rest.time, 0.05 * rest.time[:, None] / DT, np.empty((40, 0)), np.zeros((40, 1)))
    result = nfpde.fit(
        linear_simulator(), nfpde.Dataset([episodes[0], still]), method="trajectory", out=tmp_path, quiet=True
    )
    pushed, unmoved = result.info["robots"]
    assert pushed["parameters"]["gain"]["known"] > 0.99
    assert unmoved["parameters"]["gain"]["known"] < 0.1
    assert unmoved["parameters"]["gain"]["cramer_rao"] is None
    assert unmoved["parameters"]["drift"]["value"] == pytest.approx(0.5, abs=1e-4)
    again = nfpde.FitResult.load(tmp_path)
    assert again.episodes is not None
    assert result.episodes is not None
    assert again.episodes.sample(10, seed=1).tolist() == result.episodes.sample(10, seed=1).tolist()
    assert json.loads((tmp_path / "fit.json").read_text())["robots"] == result.info["robots"]


@pytest.mark.parametrize("number", [np.float64, np.float32])
def test_an_interrupted_estimate_goes_on_to_the_same_numbers(number):
    """State and restore after every round, against a run that never stopped; in single precision, too.

    There the width of differences follows what is known so far.
    """

    class Rounded(nfpde.CallableSimulator):
        rounding = float(np.finfo(number).eps)

    def step(x, u, xi):
        return linear_step(x, u, xi).astype(number).astype(float)

    simulator = Rounded(step, SPACE, positions=["x"])
    rng = np.random.default_rng(8)
    dataset = nfpde.Dataset([linear_episode(f"{i}", (1.0 + i, 0.5), rng, noise=0.02) for i in range(3)])
    whole = estimate(simulator, dataset)
    problem = make_problem(simulator, dataset, 1)
    parts = TrajectoryEstimator(problem, nfpde.TrajectoryConfig(), 0)
    while not parts.done:
        parts.step()
        state = parts.state()
        parts = TrajectoryEstimator(problem, nfpde.TrajectoryConfig(), 0)
        parts.restore(state[0], json.loads(json.dumps(state[1])))
    for a, b in zip(whole.posteriors(), parts.posteriors(), strict=True):
        assert a.means.tolist() == b.means.tolist()
        assert a.covariances.tolist() == b.covariances.tolist()


def test_settings_of_another_method_are_refused():
    """An argument that would do nothing is an error."""
    rng = np.random.default_rng(9)
    dataset = nfpde.Dataset([linear_episode("a", (1.0, 0.5), rng)])
    with pytest.raises(nfpde.NfpdeError, match="the method trajectory takes a TrajectoryConfig, got a NfpdeConfig"):
        nfpde.fit(linear_simulator(), dataset, method="trajectory", config=nfpde.NfpdeConfig(), quiet=True)
