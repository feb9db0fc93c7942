"""Smoothed populations: what smoothing adds is taken from the centres, and robots not seen are predicted better."""

import numpy as np
import pytest
from scipy.special import logsumexp

from nfpde.estimation.trajectory import LocalPosterior, smoothing_matrix
from nfpde.estimation.trajectory.gaussians import Gaussians
from nfpde.estimation.trajectory.population import BANDWIDTHS
from nfpde.estimation.trajectory.sharpening import Kernels
from nfpde.ot import emd


def known(places, variances: float | np.ndarray = 1e-6):
    """Robots with one mode each at `places` (G, D), known to `variances`, broadcast to (G, D)."""
    places = np.asarray(places, float)
    variances = np.broadcast_to(variances, places.shape)
    return [
        LocalPosterior(np.ones(1), z[None], np.diag(v)[None], np.diag(1 / v)[None])
        for z, v in zip(places, variances, strict=True)
    ]


def moments(mixture):
    """Mean (D,) and covariance (D, D) of Gaussians."""
    mean = mixture.weights @ mixture.means
    steps = mixture.means - mean
    return mean, np.einsum("k,kij->ij", mixture.weights, mixture.covariances) + steps.T @ (
        steps * mixture.weights[:, None]
    )


@pytest.mark.parametrize("features", [1, 2, 5])
def test_smoothing_keeps_the_variance_and_the_mean(features):
    """Of a Gaussian's draws: at least four fifths of what plain smoothing adds is taken back, and no more."""
    rng = np.random.default_rng(features)
    places = rng.normal(size=(600, features)) * np.linspace(1, 3, features)
    share = 0.3**2
    kernel = share * np.diag(places.var(0))
    mean, covariance = moments(Kernels.of(known(places), kernel).mixture())
    # what is left is of second order in the kernel's share of the variance; plain smoothing leaves 1 of 1 share
    left = (np.diag(covariance) / places.var(0) - 1) / share
    assert np.abs(left).max() < 0.2, left
    # draws are not quite symmetric, nor are the moves: a tenth of the mean's standard error
    assert (np.abs(mean - places.mean(0)) < 0.1 * places.std(0) / np.sqrt(600)).all()
    # correlations of the draws are nothing to be smoothed away: they are chance here
    assert np.abs(np.corrcoef(places.T) - covariance / np.sqrt(np.outer(*[np.diag(covariance)] * 2))).max() < 0.02


def test_kernels_wider_than_all_robots_stand_at_their_mean():
    """One Gaussian with the kernel's covariance is left, however many robots there are."""
    places = np.random.default_rng(0).normal(size=(12, 3))
    mixture = Kernels.of(known(places), 1e8 * np.eye(3)).mixture()
    np.testing.assert_allclose(mixture.means, np.tile(places.mean(0), (12, 1)), atol=1e-7)


def test_two_robots_keep_their_unbiased_variance():
    """The closed form of a pair: nearness w, mean of the pair w / (1 + w) away, half the squared distance kept."""
    distance, kernel = 2.0, 0.9
    (left,), (right,) = Kernels.of(known([[0.0], [distance]], 1e-12), np.array([[kernel]])).moves()
    w = np.exp(-(distance**2) / (4 * kernel))
    expected = (1 - np.sqrt(1 - kernel / (0.5 * distance**2))) * w / (1 + w) * distance
    # a variance of 1e-12 is left to each
    np.testing.assert_allclose([left, right], [expected, -expected], rtol=1e-9)


def test_kinds_of_robot_stay_apart():
    """Two clouds a hundred of their widths apart: neither's mean moves toward the other, and each keeps its width."""
    rng = np.random.default_rng(1)
    clouds = np.stack([0.1 * rng.normal(size=(40, 2)), [10.0, 3.0] + 0.1 * rng.normal(size=(40, 2))])
    kernels = Kernels.of(known(clouds.reshape(80, 2), 1e-8), 0.02**2 * np.eye(2))
    moves = kernels.moves().reshape(2, 40, 2)
    assert (np.abs(moves.mean(1)) < 0.1 * 0.1 / np.sqrt(40)).all()
    alone = [Kernels.of(known(c, 1e-8), 0.02**2 * np.eye(2)).moves() for c in clouds]
    # the other cloud is exp(-1e4) near
    np.testing.assert_allclose(moves, alone, atol=1e-12)


def test_a_population_without_a_robot_never_saw_it():
    """Taken out of the sums, against kernels made of the others alone; robots with several modes among them."""
    rng = np.random.default_rng(2)
    robots = known(rng.normal(size=(7, 3)), rng.uniform(0.01, 2, (7, 3)))
    two = LocalPosterior(
        np.array([0.7, 0.3]), rng.normal(size=(2, 3)), np.stack([np.eye(3)] * 2), np.stack([np.eye(3)] * 2)
    )
    robots.insert(3, two)
    smoothing = np.diag([0.3, 0.1, 0.5])
    kernels = Kernels.of(robots, smoothing)
    for left_out in range(8):
        others = Kernels.of([r for i, r in enumerate(robots) if i != left_out], smoothing).mixture()
        found = kernels.mixture(without=left_out)
        for name in ("weights", "means", "covariances"):
            np.testing.assert_allclose(getattr(found, name), getattr(others, name), rtol=1e-10, atol=1e-12)


def test_units_do_not_matter():
    """Parameters in other units give the same bandwidth, and the same population in those units."""
    rng = np.random.default_rng(3)
    places, variances = rng.normal(size=(9, 3)), rng.uniform(0.01, 1, (9, 3))
    unit = np.array([1e-2, 1.0, 1e3])
    matrix, bandwidth = smoothing_matrix(known(places, variances))
    scaled, same = smoothing_matrix(known(places * unit, variances * unit**2))
    assert bandwidth == same
    np.testing.assert_allclose(scaled, matrix * np.outer(unit, unit), rtol=1e-9)
    here = Kernels.of(known(places, variances), matrix).mixture()
    there = Kernels.of(known(places * unit, variances * unit**2), scaled).mixture()
    np.testing.assert_allclose(there.means, here.means * unit, rtol=1e-9, atol=1e-12)


def test_the_order_of_robots_does_not_matter():
    """The same robots in another order are the same population."""
    rng = np.random.default_rng(4)
    robots, order = known(rng.normal(size=(9, 2)), 0.1), rng.permutation(9)
    here = Kernels.of(robots, 0.2 * np.eye(2)).moves()
    there = Kernels.of([robots[i] for i in order], 0.2 * np.eye(2)).moves()
    np.testing.assert_allclose(there, here[order], atol=1e-13)


def test_alike_robots_and_single_ones_stay_where_they_are():
    """Nothing is drawn anywhere where all stand on one place, or one stands alone; no number is made up."""
    for places in (np.full((5, 2), 0.3), np.array([[0.3, -1.0]])):
        for smoothing in (np.zeros((2, 2)), np.eye(2)):
            mixture = Kernels.of(known(places), smoothing).mixture()
            np.testing.assert_allclose(mixture.means, places, atol=1e-14)
    matrix, bandwidth = smoothing_matrix(known(np.full((5, 2), 0.3)))
    assert np.isfinite(matrix).all()
    assert bandwidth in BANDWIDTHS


def test_modes_of_a_robot_move_together():
    """A second mode keeps its step from the first, and neither weights nor shapes change."""
    rng = np.random.default_rng(5)
    robots = known(rng.normal(size=(6, 2)), 0.01)
    means = np.array([[0.5, 0.5], [-3.0, 2.0]])
    shapes = np.stack([0.01 * np.eye(2), 0.3 * np.eye(2)])
    robots.append(LocalPosterior(np.array([0.8, 0.2]), means, shapes, shapes))
    mixture = Kernels.of(robots, 0.2 * np.eye(2)).mixture()
    moved = mixture.means[-2:] - means
    assert np.abs(moved).max() > 0.01
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-15)
    np.testing.assert_allclose(mixture.weights[-2:], np.array([0.8, 0.2]) / 7)
    np.testing.assert_allclose(mixture.covariances[-2:], shapes + 0.2 * np.eye(2))


def test_wide_posteriors_are_counted_once():
    """Known no better than the population is wide, robots come out between their posteriors and plain smoothing."""
    rng = np.random.default_rng(6)
    places = rng.normal(size=(60, 2))
    wide = rng.uniform(0.5, 2, (60, 2))
    smoothing = 0.4**2 * np.eye(2)
    _, covariance = moments(Kernels.of(known(places, wide), smoothing).mixture())
    plain = places.var(0) + wide.mean(0) + np.diag(smoothing)
    assert (np.diag(covariance) < plain - 0.2 * np.diag(smoothing)).all()
    # the posteriors' own widths are never taken away, nor is the kernel
    assert (np.diag(covariance) > wide.mean(0) + np.diag(smoothing)).all()


def test_what_no_recording_tells_is_no_distance():
    """A parameter that only the bounds limit changes nothing in which robots are near in the others."""
    rng = np.random.default_rng(7)
    told = np.array([[-2.0], [2.0]])[rng.integers(2, size=20)] + 0.1 * rng.normal(size=(20, 1))
    # best values of the second parameter are chance, a hundredth of what is left open
    places = np.hstack([told, 0.02 * rng.normal(size=(20, 1))])
    variances = np.tile([1e-6, 4.0], (20, 1))
    both = Kernels.of(known(places, variances), np.diag([0.05**2, 0.01**2]))
    # the mean over two parameters, one of which has no distance, is that of one with a kernel twice as wide
    alone = Kernels.of(known(told), np.array([[2 * (0.05**2 + 1e-6) - 1e-6]]))
    np.testing.assert_allclose(both.nearness, alone.nearness, rtol=1e-3)
    assert (np.abs(both.moves()[:, 1]) < 0.1).all(), "within what is left open"


def plain_bandwidth(z):
    """The plain kernel estimate of robots at z (G, D), its bandwidth by the same likelihood and candidates."""
    spread, (n, d) = z.std(0, ddof=1), z.shape
    squares = (((z[:, None] - z) / spread) ** 2).sum(2)
    np.fill_diagonal(squares, np.inf)
    scores = [float(np.asarray(logsumexp(-0.5 * squares / b**2, axis=1)).mean()) - d * np.log(b) for b in BANDWIDTHS]
    covariance = np.diag((BANDWIDTHS[int(np.argmax(scores))] * spread) ** 2)
    return Gaussians(np.full(n, 1 / n), z, np.tile(covariance, (n, 1, 1)))


@pytest.mark.parametrize("kinds", [1, 3])
@pytest.mark.parametrize("features", [3, 8])
def test_robots_not_seen_are_predicted_better_than_by_plain_kernels(features, kinds):
    """Over 30 populations of one kind or three: likelihood of fresh robots and transport to them, paired.

    Likelihood no lower, within two standard errors of the mean gain; transport lower by more than two.
    """
    likelihood, transport = [], []
    for seed in range(30):
        rng = np.random.default_rng([seed, features, kinds])
        centres = 5 * rng.normal(size=(kinds, features))
        shapes = rng.uniform(0.5, 1.5, size=(kinds, features))
        own, fresh = rng.integers(kinds, size=12), rng.integers(kinds, size=150)
        z, unseen = (centres[i] + shapes[i] * rng.normal(size=(len(i), features)) for i in (own, fresh))
        smoothing, _ = smoothing_matrix(known(z, 1e-8))
        here, there = Kernels.of(known(z, 1e-8), smoothing).mixture(), plain_bandwidth(z)
        likelihood.append(here.log_density(unseen).mean() - there.log_density(unseen).mean())
        near, far = (emd(g.sample(300, np.random.default_rng(seed)), unseen).cost for g in (here, there))
        transport.append(1 - near / far)
    for gains, least in ((np.array(likelihood), -2), (np.array(transport), 2)):
        assert gains.mean() > least * gains.std(ddof=1) / np.sqrt(30), (gains.mean(), gains.std(ddof=1))
