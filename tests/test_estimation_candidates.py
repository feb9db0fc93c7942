"""The two candidates, their gradients, and the temperature that the data ask for."""

import numpy as np
import pytest
import torch
from scipy.stats import norm

from nfpde.estimation import candidates
from nfpde.estimation.ascent import responsibility
from nfpde.estimation.candidates import cai
from nfpde.flow import build_flow
from nfpde.sim import LOSS_LIMIT


def softmax(losses, beta):
    """As numpy arrays, with which expectations are written here."""
    return candidates.softmax(torch.as_tensor(losses), beta).numpy()


def effective_samples(weights):
    return candidates.effective_samples(torch.as_tensor(weights)).numpy()


def next_beta(losses, beta, channels, floor):
    return candidates.next_beta(torch.as_tensor(losses), beta, channels, floor)


def test_cai_is_eq_10():
    """The log likelihood is minus the loss."""
    losses = torch.rand(3, 4, generator=torch.Generator().manual_seed(0))
    assert torch.equal(cai(losses), -losses)


def test_softmax_by_hand():
    """Two samples, one transition: weights in the ratio exp(-(l1 - l2) / beta)."""
    weights = softmax(np.array([[1.0], [1.0 + 0.5 * np.log(3.0)]]), 0.5)
    np.testing.assert_allclose(weights, [[0.75], [0.25]], rtol=1e-14)


@pytest.mark.parametrize("beta", [1e-300, 1e-3, 1.0, 1e12, 1e300])
@pytest.mark.parametrize("size", [0.0, 1e-300, 1.0, LOSS_LIMIT])
def test_softmax_weights_sum_to_one(size, beta):
    """For tiny and huge losses and temperatures alike, without NaN and without a warning."""
    losses = size * np.random.default_rng(1).random((50, 7))
    weights = softmax(losses, beta)
    assert (weights >= 0).all()
    # 50 additions in double precision
    np.testing.assert_allclose(weights.sum(0), 1.0, rtol=50 * np.finfo(float).eps)


def test_softmax_depends_on_differences_only():
    """A transition that nothing explains weighs its samples like any other."""
    losses = np.random.default_rng(2).integers(0, 1024, (20, 5)) / 256
    # exact in binary: the sums have no rounding
    np.testing.assert_array_equal(softmax(losses + 2.0**30, 0.3), softmax(losses, 0.3))


def test_effective_samples_between_one_and_all():
    """Equal weights count all samples, a single one counts once, k equal ones count k."""
    weights = np.array([[0.25, 1.0, 0.5], [0.25, 0.0, 0.5], [0.25, 0.0, 0.0], [0.25, 0.0, 0.0]])
    np.testing.assert_allclose(effective_samples(weights), [4.0, 1.0, 2.0])


def flow_and_samples(seed):
    """A flow that is no longer near its start, samples of it, and losses of them (M, N) on N points."""
    flow = build_flow(2, hidden_features=(8,), transforms=2, seed=seed)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for p in flow.parameters():
            p.add_(0.1 * torch.randn(p.shape, generator=generator, dtype=p.dtype))
    z = flow.sample(40, generator)
    points = torch.randn(15, 2, generator=generator, dtype=torch.float64)
    return flow, z, ((z[:, None] - points) ** 2).sum(2)


def gradient(flow, value):
    return torch.cat([g.flatten() for g in torch.autograd.grad(value, list(flow.parameters()))])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_fishers_identity(seed):
    """At the old weights, Eq. 8 with Eq. 11 has the gradient of the marginal log likelihood, Eq. 5.

    The responsibilities are its only trace of the losses.
    """
    flow, z, losses = flow_and_samples(seed)
    beta = 0.7
    log_prob = flow.log_prob(z)
    weight = torch.from_numpy(softmax(losses.numpy(), beta).sum(1))
    eq_8 = gradient(flow, responsibility(log_prob - log_prob.detach(), weight))
    ratio = torch.exp(flow.log_prob(z) - log_prob.detach())
    likelihood = (ratio[:, None] * torch.exp(-losses / beta)).mean(0)
    eq_5 = gradient(flow, torch.log(likelihood).sum())
    assert float(eq_5.abs().max()) > 1e-3
    # sums of 600 terms of either sign: rounding relative to the largest entry
    torch.testing.assert_close(eq_8, eq_5, rtol=1e-10, atol=1e-12 * float(eq_5.abs().max()))


def test_cai_is_below_the_marginal_likelihood():
    """The mean of minus the losses is a lower bound of the log mean of exp(-losses), Eq. 6 (Jensen)."""
    _, _, losses = flow_and_samples(3)
    marginal = torch.log(torch.exp(-losses).mean(0)).sum()
    assert float(cai(losses).mean(0).sum()) < float(marginal)


def test_temperature_converges_to_twice_the_variance():
    """Points of N(0, 1 + sigma^2) explained by samples of N(0, 1): beta ends at 2 sigma^2.

    Both sets are quantiles instead of draws, so that only the M-point sums for integrals are left as an error.
    """
    sigma, n = 0.5, 2000
    xi, points = (norm.ppf((np.arange(k) + 0.5) / k, scale=s) for k, s in ((n, 1.0), (n // 10, np.sqrt(1 + sigma**2))))
    losses = (xi[:, None] - points) ** 2
    beta = None
    for _ in range(200):
        beta = next_beta(losses, beta, 1, 1.0)
    # the maximum of the likelihood lies where mean(points^2) = 1 + beta / 2; 200 quantiles miss some of the tails
    assert beta == pytest.approx(2 * ((points**2).mean() - 1), rel=0.01)
    assert beta == pytest.approx(2 * sigma**2, rel=0.05)


def test_temperature_counts_channels():
    """Two channels with the same noise need the same temperature as one: twice the loss, twice the channels."""
    rng = np.random.default_rng(4)
    sigma, n = 0.3, 600
    xi, true = rng.normal(size=(1500, 1)), rng.normal(size=n)
    points = true[:, None] + sigma * rng.normal(size=(n, 2))
    losses = ((xi[:, None, :] - points) ** 2).sum(2)
    beta = None
    for _ in range(60):
        beta = next_beta(losses, beta, 2, 1.0)
    # the variance from 2 n residuals, one of two used up by xi: standard error sqrt(2 / n) = 6 %; three of them
    assert beta == pytest.approx(2 * sigma**2, rel=0.18)


@pytest.mark.parametrize("floor", [2.0, 5.0, 30.0])
def test_temperature_keeps_the_floor_and_no_more(floor):
    """Half of the transitions keep the effective samples asked for, and a slightly lower temperature would not do."""
    # nine samples explain the transitions exactly: without the floor each would end with all the weight of its own
    xi = np.random.default_rng(5).random((100, 2))
    losses = ((xi[:, None] - xi[:9]) ** 2).sum(2)
    beta = None
    for _ in range(50):
        beta = next_beta(losses, beta, 2, floor)
    assert beta is not None
    assert np.median(effective_samples(softmax(losses, beta))) >= floor
    # the bisection stops at a relative width of 1e-3
    assert np.median(effective_samples(softmax(losses, beta * (1 - 2e-3)))) < floor


def test_floor_does_nothing_where_it_is_met():
    """A temperature that leaves enough samples is the one of the formula, 2 E[loss] / channels."""
    losses = 1.0 + 1e-3 * np.random.default_rng(6).random((50, 8))
    assert next_beta(losses, None, 4, 10.0) == pytest.approx(2 * losses.mean() / 4, rel=1e-14)
    explained = (softmax(losses, 2.0) * losses).sum(0).mean()
    assert next_beta(losses, 2.0, 4, 10.0) == pytest.approx(2 * explained / 4, rel=1e-14)


def one_zero():
    losses = np.full((20, 6), 3.0)
    losses[4] = 0.0
    return losses


@pytest.mark.parametrize(
    "losses",
    [np.zeros((20, 6)), np.full((20, 6), 1e-300), np.full((20, 6), 0.99 * LOSS_LIMIT), one_zero()],
    ids=["zero", "tiny", "nearly diverged", "one exact"],
)
@pytest.mark.parametrize("last", [None, 1e-290, 1.0, 1e12])
def test_degenerate_losses(losses, last):
    """The temperature stays positive and finite, its weights a distribution with enough effective samples."""
    for floor in (1.0, 5.0, 19.0):
        beta = next_beta(losses, last, 3, floor)
        assert 0 < beta < np.inf
        weights = softmax(losses, beta)
        np.testing.assert_allclose(weights.sum(0), 1.0, rtol=1e-14)
        # at the floor the bisection meets it to rounding
        assert np.median(effective_samples(weights)) >= floor * (1 - 1e-12)


@pytest.mark.parametrize("alive", [1, 7])
@pytest.mark.parametrize("floor", [1.0, 5.0])
@pytest.mark.parametrize("last", [None, 1e-290, 1.0, 1e12])
def test_samples_that_diverge_might_not_have_been_drawn(alive, floor, last):
    """Temperature and weights are those of the others alone: LOSS_LIMIT is no size of an error."""
    losses = np.random.default_rng(8).random((20, 6))
    losses[alive:] = LOSS_LIMIT
    beta = next_beta(losses, last, 3, floor)
    assert beta == pytest.approx(next_beta(losses[:alive], last, 3, floor), rel=2e-3)
    weights = softmax(losses, beta)
    assert (weights[alive:] == 0).all()
    np.testing.assert_allclose(weights[:alive], softmax(losses[:alive], beta), rtol=1e-14)


def test_a_transition_of_which_all_samples_diverge_weighs_nothing():
    """It is told apart, and has no part in any weight."""
    losses = torch.rand(20, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    losses[:, 1] = LOSS_LIMIT
    losses[4, 2] = LOSS_LIMIT
    assert candidates.sound(losses).tolist() == [True, False, True]
    assert softmax(losses, 0.1)[:, 1].tolist() == [0.0] * 20


def test_a_diverged_sample_is_the_worst_to_cai():
    """As bad as the worst of its transition that did not diverge, and not a million millions."""
    losses = torch.tensor([[1.0, 2.0], [LOSS_LIMIT, 3.0], [4.0, LOSS_LIMIT]], dtype=torch.float64)
    assert cai(losses).tolist() == [[-1.0, -2.0], [-4.0, -3.0], [-4.0, -3.0]]


def test_all_samples_can_be_asked_for():
    """A floor of all M samples takes a temperature at which they weigh alike."""
    losses = np.random.default_rng(7).random((10, 4))
    weights = softmax(losses, next_beta(losses, None, 1, 10.0))
    # effective samples of all M are only reached in the limit; this far up they are M to a part in M
    assert np.median(effective_samples(weights)) > 9.9
