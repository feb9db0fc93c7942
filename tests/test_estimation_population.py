"""Importance samples and populations: against quadrature and closed forms, on robots that inform each other."""

import json

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from scipy.special import logsumexp
from scipy.stats import binom, multivariate_normal

import nfpde
from nfpde.estimation.trajectory import LocalPosterior, make_problem
from nfpde.estimation.trajectory.compete import SMOOTHED, Candidate, Competition
from nfpde.estimation.trajectory.em import fit_mixture, spread_out
from nfpde.estimation.trajectory.gaussians import Gaussians, joined
from nfpde.estimation.trajectory.likelihood import Quadratic
from nfpde.estimation.trajectory.noise import Noise, Scatter
from nfpde.estimation.trajectory.pool import Pool, box_log_density, effective
from nfpde.estimation.trajectory.sampling import corrected, temperature, widened
from nfpde.estimation.trajectory.stages import TwoStages
from tests.linear_robots import DT, both_stages, linear_simulator, moments, sharp

torch.set_num_threads(1)


def some_gaussians(rng, k=3, d=2):
    roots = rng.normal(size=(k, d, d))
    weights = rng.uniform(0.5, 1, k)
    return Gaussians(weights / weights.sum(), rng.normal(size=(k, d)), roots @ roots.swapaxes(1, 2) + 0.1 * np.eye(d))


def test_density_of_a_mixture_is_scipys():
    """Every component, its weight and their sum, against scipy.stats."""
    rng = np.random.default_rng(0)
    g, z = some_gaussians(rng), rng.normal(size=(20, 2))
    parts = [
        np.log(w) + multivariate_normal(m, c).logpdf(z)
        for w, m, c in zip(g.weights, g.means, g.covariances, strict=True)
    ]
    np.testing.assert_allclose(g.log_density(z), np.asarray(logsumexp(parts, axis=0)), rtol=1e-10)


def moments_of(g):
    mean = g.weights @ g.means
    steps = g.means - mean
    return mean, np.einsum("k,kij->ij", g.weights, g.covariances) + (steps.T * g.weights) @ steps


def test_draws_have_the_moments_of_the_mixture():
    """Mean and covariance of 20 000 draws, to five standard errors of their largest entry."""
    rng = np.random.default_rng(1)
    g = some_gaussians(rng)
    z = g.sample(20_000, rng)
    mean, covariance = moments_of(g)
    np.testing.assert_allclose(z.mean(0), mean, atol=5 * np.sqrt(covariance.max() / 20_000))
    np.testing.assert_allclose(np.cov(z.T), covariance, atol=5 * 2 * covariance.max() / np.sqrt(20_000))


@pytest.mark.parametrize("most", [1, 4, 12])
def test_a_reduced_mixture_keeps_its_moments(most):
    """Also where two components are the same; those that are light are left out first."""
    rng = np.random.default_rng(20)
    g = some_gaussians(rng, k=12, d=3)
    twice = Gaussians(g.weights, g.means[[0, 0, *range(2, 12)]], g.covariances)
    reduced = twice.reduced(most)
    assert len(reduced.weights) <= most
    np.testing.assert_allclose(reduced.weights.sum(), 1.0)
    for found, wanted in zip(moments_of(reduced), moments_of(twice), strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-12)
    np.testing.assert_array_equal(twice.reduced(most, 0.1).weights, twice.heaviest(12, 0.1).reduced(most).weights)


@pytest.mark.parametrize("seed", range(5))
def test_the_mode_is_the_top_above_the_heaviest_component(seed):
    """Where a general optimiser ends that starts at its centre too."""
    g = some_gaussians(np.random.default_rng(seed), k=5, d=3)
    found = minimize(lambda z: -g.log_density(z[None])[0], g.means[int(g.weights.argmax())], tol=1e-10)
    np.testing.assert_allclose(g.mode(), found.x, atol=0.01)


def test_a_sharp_light_component_is_not_the_mode():
    g = Gaussians(np.array([0.9, 0.1]), np.array([[0.0], [5.0]]), np.array([[[1.0]], [[1e-6]]]))
    np.testing.assert_allclose(g.mode(), [0.0], atol=1e-6)


def test_posterior_with_a_population_for_prior_is_bayes_rule():
    """Quadratic likelihood times mixture, normalised, against the same product on a fine grid."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(2, 2))
    quadratic = Quadratic(
        np.array([[0.5, -0.3]]), np.zeros(1), np.array([[0.2, -0.4]]), (root @ root.T + np.eye(2))[None]
    )
    population = some_gaussians(rng)
    axis = np.linspace(-8, 8, 400)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    logs = quadratic.log_likelihood(grid) + population.log_density(grid)
    exact = np.exp(logs - np.asarray(logsumexp(logs))) / (axis[1] - axis[0]) ** 2
    # sums over a grid far finer than anything in the integrand are exact to rounding
    np.testing.assert_allclose(np.exp(quadratic.times(population).log_density(grid)), exact, atol=1e-9)


def test_evidence_is_the_integral_over_the_population():
    """Held-out likelihoods from importance samples equal quadrature over z, for a narrow and a wide population."""
    space = nfpde.ParameterSpace([nfpde.Parameter("gain", low=-4.0, high=4.0)])
    simulator = nfpde.CallableSimulator(lambda x, u, xi: x + DT * xi * u, space, positions=["x"])
    rng = np.random.default_rng(3)
    episodes = []
    for k in range(6):
        u, start = rng.normal(size=1), rng.normal(size=1)
        end = start + DT * 1.0 * u + 0.1 * rng.normal(size=1)
        episodes.append(nfpde.Episode(f"{k}", [0, DT], [start, end], np.empty((2, 0)), [u, u], robot="one"))
    problem = make_problem(simulator, nfpde.Dataset(episodes), 1)
    noise = Noise.alike(Scatter(np.zeros(0), np.eye(1) * (0.1 / problem.unit) ** 2), problem.members)
    grid = np.linspace(-9, 9, 4001)[:, None]
    residuals = problem.residuals(space.to_physical(grid), np.zeros(len(grid), int))
    exact = -0.5 * noise.totals(np.zeros(len(grid), int), residuals)

    def integral(log_prior):
        return float(logsumexp(exact + log_prior) + np.log(grid[1, 0] - grid[0, 0]))

    pool = Pool.empty(1, 1)
    for width in (0.5, 2.0):  # two rounds of different proposals, weighed together
        proposal = Gaussians(np.ones(1), np.full((1, 1), 0.3), np.full((1, 1, 1), width**2))
        pool.add(problem, noise, [proposal], 2000, rng)
    own = LocalPosterior(np.ones(1), np.zeros((1, 1)), np.ones((1, 1, 1)), np.ones((1, 1, 1)))
    ratios = pool.ratios([Quadratic.of(own)], 10.0)
    assert ratios.sampled.all()
    for centre, width in ((0.5, 0.2), (-0.5, 1.0)):
        population = Gaussians(np.ones(1), np.full((1, 1), centre), np.full((1, 1, 1), width**2))
        expected = integral(population.log_density(grid)) - integral(box_log_density(grid))
        logs = ratios.log_ratio[0] + population.log_density(ratios.z[0])
        # four standard errors of a weighted mean with that many effective draws
        error = 4 / np.sqrt(effective(logs))
        assert ratios.log_evidence(0, population) == pytest.approx(expected, abs=error)


def test_a_likelihood_too_sharp_to_sample_is_laplaces():
    """Where a handful of draws would take all the weight, the quadratic likelihood stands in, and it is said."""
    rng = np.random.default_rng(4)
    wide = LocalPosterior(np.ones(1), np.zeros((1, 1)), np.ones((1, 1, 1)), 0.5 * np.ones((1, 1, 1)))
    proposal = widened(Gaussians(wide.weights, wide.means, wide.covariances))
    z = proposal.sample(200, rng)[None]
    pool = Pool(z, -0.5 * (z[..., 0] / 1e-5) ** 2, [(200, [proposal])])
    ratios = pool.ratios([Quadratic.of(wide)], 10.0)
    assert ratios.effective[0] < 10
    assert not ratios.sampled[0]
    logs = ratios.log_ratio[0] + box_log_density(z[0])
    assert effective(logs) > 100
    assert logsumexp(logs) == pytest.approx(0.0, abs=1e-9)


def test_temperature_leaves_as_many_draws_as_asked_for():
    """Weights that are even need no tempering; others are flattened just enough."""
    z = np.zeros((500, 1))
    assert temperature(np.zeros(500), z, 50.0) == 1.0
    logs = -0.5 * np.linspace(-100, 100, 500) ** 2
    exponent = temperature(logs, z, 50.0)
    assert 0 < exponent < 1
    assert effective(exponent * logs) == pytest.approx(50.0, rel=1e-3)


def test_corrected_posterior_has_the_moments_of_its_draws():
    """With many draws of the true posterior, a wrong Gaussian moves to it."""
    rng = np.random.default_rng(5)
    wrong = Gaussians(np.ones(1), np.zeros((1, 2)), np.eye(2)[None])
    z = np.array([0.4, -0.2]) + rng.normal(size=(20_000, 2)) * [0.5, 2.0]
    found = corrected(wrong, z, np.full(len(z), 1 / len(z)), chain=False)
    np.testing.assert_allclose(found.means[0], [0.4, -0.2], atol=5 * 2 / np.sqrt(20_000))
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariances[0])), [0.5, 2.0], rtol=0.03)


def test_shares_of_links_are_laplaces_until_draws_tell():
    """Of a hundred links 30 draws tell little, of two modes 1000 all; Laplace's shares of modes count for nothing."""
    rng = np.random.default_rng(7)
    links = Gaussians(np.full(100, 0.01), np.linspace(-5, 5, 100)[:, None], np.full((100, 1, 1), 0.01))
    z = rng.uniform(-5, 5, size=(30, 1))
    found = corrected(links, z, np.full(30, 1 / 30), chain=True)
    # at most a draw in a hundred and thirty falls to a link whose share was one in a hundred
    assert found.weights.min() >= 100 / 130 * 0.01
    assert found.weights.max() < 0.01 + 5 / 130
    modes = Gaussians(np.array([0.999, 0.001]), np.array([[-10.0], [10.0]]), np.ones((2, 1, 1)))
    z = rng.normal(size=(1000, 1)) + np.where(np.arange(1000) < 500, -10.0, 10.0)[:, None]
    np.testing.assert_allclose(corrected(modes, z, np.full(1000, 1e-3), chain=False).weights, 0.5, atol=0.01)


@pytest.mark.parametrize("tied", [True, False])
def test_mixture_finds_two_kinds_of_robot(tied):
    """Centres, widths and shares of two clouds of sharply known robots."""
    rng = np.random.default_rng(6)
    points = np.concatenate([[-3.0, 0.0] + 0.2 * rng.normal(size=(60, 2)), [3.0, 1.0] + 0.2 * rng.normal(size=(30, 2))])
    found = fit_mixture(sharp(points), np.arange(90), spread_out(points, 2), 0.04 * np.eye(2), tied=tied)
    order = np.argsort(found.means[:, 0])
    # five standard errors of a mean of 30; half a robot is added to each share
    np.testing.assert_allclose(found.means[order], [[-3, 0], [3, 1]], atol=5 * 0.2 / np.sqrt(30))
    np.testing.assert_allclose(found.weights[order], [2 / 3, 1 / 3], atol=0.01)
    np.testing.assert_allclose(np.sqrt(np.einsum("kii->ki", found.covariances)), 0.2, rtol=0.4)


def test_the_smoothed_posteriors_stay_where_nothing_is_surely_better():
    """A gain within its standard error over the robots does not replace them; a sure one does."""
    one = Gaussians(np.ones(1), np.zeros((1, 1)), np.ones((1, 1, 1)))
    rng = np.random.default_rng(7)
    base = rng.normal(size=10)

    def winner(gain):
        rows = [Candidate(SMOOTHED, one, [one], base), Candidate("other", one, [one], base + gain)]
        return Competition(rows, np.zeros(10, int)).winner.name

    spread = np.tile([1.0, -1.0], 5)
    assert winner(spread + 0.1) == SMOOTHED
    assert winner(0.1 * spread + 0.1) == "other"
    assert winner(-0.5 + 0 * spread) == SMOOTHED
    # one robot that the smoothed posteriors miss by far does not hide what the other gains of all others
    gain = np.full(10, 0.5)
    gain[3] = 500.0
    base = base - gain
    assert winner(gain) == "other"


@pytest.fixture(scope="module")
def informed():
    """Twelve robots of one kind; the recordings of the last never push, and cannot tell its gain."""
    rng = np.random.default_rng(8)
    true = np.array([2.0, -1.0]) + 0.3 * rng.normal(size=(12, 2))
    episodes = [e for i, xi in enumerate(true) for e in moments(f"r{i}", xi, rng, 20, 0.02, push=float(i < 11))]
    result = nfpde.fit(linear_simulator(), nfpde.Dataset(episodes), quiet=True)
    return true, result


def test_others_inform_the_robot_that_cannot_tell(informed):
    """Its own recordings say nothing of the gain; the population narrows it to what robots differ by."""
    true, result = informed
    last = result.info["robots"][11]["parameters"]["gain"]
    assert last["known"] < 0.1
    assert last["words"] == "not told by these recordings"
    assert last["cramer_rao"] is None
    assert last["known_with_others"] > 0.7
    assert last["5%"] < true[11, 0] < last["95%"]
    assert result.info["population"]["informs_robots"]
    assert result.info["population"]["held_out"] >= result.info["population"]["held_out_smoothed"]


def test_population_covers_the_robots_and_no_more(informed):
    """Its mean is theirs, and its width between what they differ by and thrice that."""
    true, result = informed
    std = true.std(0, ddof=1)
    # the smoothing, and the robot that cannot tell, make it wider; five standard errors for the mean
    np.testing.assert_allclose(result.distribution.mean(), true.mean(0), atol=5 * 0.3 / np.sqrt(12))
    assert (result.distribution.std() > 0.7 * std).all()
    assert (result.distribution.std() < 3 * std).all()


def test_one_robot_is_its_own_population():
    """Nothing informs it, and both answers are its posterior."""
    rng = np.random.default_rng(9)
    result = nfpde.fit(linear_simulator(), nfpde.Dataset(moments("one", (1.0, 0.5), rng, 30)), quiet=True)
    assert result.info["population"]["candidates"] == []
    assert not result.info["population"]["informs_robots"]
    assert result.episodes is not None
    assert result.episodes.sample(50, seed=1).tolist() == result.distribution.sample(50, seed=1).tolist()


def test_both_stages_go_on_after_an_interruption():
    """State and restore after every round of both, through JSON, against a run that never stopped."""
    rng = np.random.default_rng(10)
    dataset = nfpde.Dataset([e for i in range(4) for e in moments(f"{i}", (1.0 + i, 0.5), rng)])
    whole, together = both_stages(linear_simulator(), dataset)
    problem = make_problem(linear_simulator(), dataset, 1)
    parts = TwoStages(problem, nfpde.TrajectoryConfig(), 0)
    while not parts.done:
        parts.step()
        tensors, info = parts.state()
        parts = TwoStages(problem, nfpde.TrajectoryConfig(), 0)
        parts.restore(tensors, json.loads(json.dumps(info)))
    assert parts.together is not None
    assert len(parts.history) == len(whole.history)
    pairs = zip(together.robot_posteriors(), parts.together.robot_posteriors(), strict=True)
    for a, b in [*pairs, (together.population, parts.together.population)]:
        assert a.means.tolist() == b.means.tolist()
        assert a.covariances.tolist() == b.covariances.tolist()


def test_a_finished_fit_is_read_back(tmp_path):
    """The same call on its folder draws nothing anew and writes the same bytes, counts and seconds included."""
    rng = np.random.default_rng(21)
    dataset = nfpde.Dataset([e for i in range(3) for e in moments(f"{i}", (1.0 + i, 0.5), rng)])
    nfpde.fit(linear_simulator(), dataset, out=tmp_path, quiet=True)
    files = [tmp_path / "fit.json", tmp_path / "distribution" / "flow.safetensors"]
    written = [f.read_bytes() for f in files]
    nfpde.fit(linear_simulator(), dataset, out=tmp_path, quiet=True)
    assert [f.read_bytes() for f in files] == written
    with pytest.raises(nfpde.NfpdeError, match=r"resolution: saved nothing, now 0\.1"):
        nfpde.fit(linear_simulator(), dataset, out=tmp_path, resolution=0.1, quiet=True)


def test_a_state_is_read_back_with_one_thread(tmp_path, monkeypatch):
    """Whether the fit is finished or goes on: flows are trained there too, whose last digits hang on the threads."""
    rng = np.random.default_rng(22)
    dataset = nfpde.Dataset([e for i in range(2) for e in moments(f"{i}", (1.0 + i, 0.5), rng)])
    nfpde.fit(linear_simulator(), dataset, out=tmp_path, quiet=True)
    seen, restore = [], TwoStages.restore

    def watched(*arguments):
        seen.append(torch.get_num_threads())
        restore(*arguments)

    monkeypatch.setattr(TwoStages, "restore", watched)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        nfpde.fit(linear_simulator(), dataset, out=tmp_path, quiet=True)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert seen == [1]


def pendulum_step(state, u, xi):
    """A damped pendulum, semi-implicit Euler in five parts of a step."""
    angle, speed = state[:, 0], state[:, 1]
    for _ in range(5):
        speed = speed + DT / 5 * (-xi[:, 0] * np.sin(angle) - xi[:, 1] * speed + u[:, 0])
        angle = angle + DT / 5 * speed
    return np.stack([angle, speed], 1)


def pendulum_space():
    return nfpde.ParameterSpace(
        [nfpde.Parameter("stiffness", low=4.0, high=16.0), nfpde.Parameter("damping", low=0, high=2)]
    )


@pytest.mark.parametrize("informed", [False, True])
def test_credible_regions_of_pendulums_cover_the_truth(informed):
    """60 pendulums of one population: 50 % and 90 % regions, with and without the others, hold the truth as often.

    The regions are those of highest density: a truth lies in the one that holds the share of draws denser than it.
    """
    rng = np.random.default_rng(11)
    space = pendulum_space()
    true = np.array([9.0, 0.8]) + np.array([1.0, 0.15]) * rng.normal(size=(60, 2))
    episodes = []
    for i, xi in enumerate(true):
        for k in range(15):  # two rows each, so that noise on the end stays out of the next start
            u, state = rng.uniform(-3, 3, (1, 1)), rng.normal(size=(1, 2)) * [1.0, 2.0]
            end = pendulum_step(state, u, xi[None]) + 0.05 * rng.normal(size=(1, 2))
            rows = np.concatenate([state, end])
            episodes.append(nfpde.Episode(f"{i}/{k}", [0, DT], rows[:, :1], rows[:, 1:], [u[0], u[0]], robot=f"{i}"))
    simulator = nfpde.CallableSimulator(pendulum_step, space, ["angle"], ["speed"])
    _, together = both_stages(simulator, nfpde.Dataset(episodes), starts=2)
    assert together.informs
    found = (
        together.robot_posteriors()
        if informed
        else [Gaussians(p.weights, p.means, p.covariances) for p in together.posteriors]
    )
    z = space.to_unconstrained(true)
    ranks = np.array(
        [(p.log_density(p.sample(400, rng)) > p.log_density(z[i : i + 1])).mean() for i, p in enumerate(found)]
    )
    for share in (0.5, 0.9):
        hits = int((ranks < share).sum())
        # a correct method leaves this interval once in a thousand
        assert binom.ppf(0.0005, 60, share) <= hits <= binom.ppf(0.9995, 60, share), (share, hits)


def test_mixture_of_mixtures():
    """Shares multiply weights."""
    rng = np.random.default_rng(19)
    a, b = some_gaussians(rng, 2), some_gaussians(rng, 3)
    z = rng.normal(size=(5, 2))
    expected = 0.3 * np.exp(a.log_density(z)) + 0.7 * np.exp(b.log_density(z))
    np.testing.assert_allclose(np.exp(joined([a, b], np.array([0.3, 0.7])).log_density(z)), expected, rtol=1e-12)
