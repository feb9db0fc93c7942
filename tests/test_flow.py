"""Densities over z and the sigmoid box."""

import math
from typing import Any

import numpy as np
import pytest
import scipy.stats
import torch

from nfpde.errors import BadInput
from nfpde.flow import INITIAL_SCALE, Density, GaussianMixture, build_flow, make_density
from nfpde.parameters import Parameter, ParameterSpace

torch.set_num_threads(1)  # the tensors are small: more threads only wait for each other

SPACE = ParameterSpace([Parameter("a", low=-1.0, high=3.0), Parameter("b", low=0.0, high=1e-3)])
KINDS = [
    ("nsf", 1),
    ("realnvp", 2),
    ("nsf", 2),
    ("maf", 2),
    ("realnvp", 5),
    ("sheared", 2),
    ("sheared", 4),
    ("mixture", 1),
    ("mixture", 3),
]


def seeded(seed):
    return torch.Generator().manual_seed(seed)


def make(kind, features, seed=0) -> Any:
    """A density away from its start: random weights, not the near-identity ones."""
    g = seeded(seed)
    if kind == "mixture":
        a = torch.randn(3, features, features, generator=g, dtype=torch.float64)
        means = 2 * torch.randn(3, features, generator=g, dtype=torch.float64)
        return GaussianMixture(torch.tensor([0.2, 0.5, 0.3]), means, a @ a.mT + 0.1 * torch.eye(features))
    sheared = kind == "sheared"
    kind = "realnvp" if sheared else kind
    flow = build_flow(features, kind, transforms=3, hidden_features=(16, 16), sheared=sheared, seed=seed)
    with torch.no_grad():
        for p in flow.parameters():
            p.add_(0.1 * torch.randn(p.shape, generator=g, dtype=torch.float64))
    return flow


# --- densities


@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_density_follows_the_protocol(kind, features):
    """Shapes, float64, and a config and state that rebuild it bit for bit."""
    density = make(kind, features)
    assert isinstance(density, Density)
    assert density.features == features
    z = density.sample(7, seeded(1))
    assert z.shape == (7, features)
    assert z.dtype == torch.float64
    assert not z.requires_grad
    assert density.log_prob(z.reshape(7, 1, features)).shape == (7, 1)
    twin = make_density(density.config())
    twin.load_state_dict(density.state_dict())
    assert torch.equal(twin.log_prob(z), density.log_prob(z))
    assert torch.equal(twin.sample(7, seeded(1)), z)


@pytest.mark.parametrize(("kind", "features"), [k for k in KINDS if k[1] <= 2])
def test_density_integrates_to_one(kind, features):
    """The density summed over a grid that holds all of it is one."""
    density = make(kind, features)
    samples = density.sample(2000, seeded(0))
    reach = 1.5 * float(samples.abs().max())
    line = torch.linspace(-reach, reach, 40001 if features == 1 else 301, dtype=torch.float64)
    grid = line[:, None] if features == 1 else torch.cartesian_prod(line, line)
    with torch.no_grad():
        total = density.log_prob(grid).exp().sum() * (line[1] - line[0]) ** features
    # kinks of ReLU networks and splines limit the sum over the grid to about three digits
    assert float(total) == pytest.approx(1.0, abs=3e-3)


@pytest.mark.parametrize(("kind", "features"), [k for k in KINDS if k[0] != "mixture"])
def test_flow_log_prob_is_the_change_of_variables_of_its_sampler(kind, features):
    """The log density at a sample is the noise's, less the log determinant of noise -> sample by autograd."""
    flow = make(kind, features)
    n = 5
    noise = torch.randn(n, features, generator=seeded(3), dtype=torch.float64)
    z = flow.rsample(n, seeded(3))

    def push(u):
        return flow.loc + flow.log_scale.exp() * flow.flow().transform.inv(u)

    jacobian = torch.stack([torch.autograd.functional.jacobian(push, u) for u in noise])
    normal = -0.5 * (noise**2).sum(-1) - 0.5 * features * math.log(2 * math.pi)
    expected = normal - torch.linalg.slogdet(jacobian)[1]
    # the inverse of a spline solves a quadratic: some digits are lost
    torch.testing.assert_close(flow.log_prob(z), expected, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize(("kind", "features"), [("nsf", 1), ("realnvp", 2), ("maf", 2), ("nsf", 3)])
def test_every_weight_learns_from_likelihood_and_from_samples(kind, features):
    """log_prob and rsample give every parameter a gradient."""
    flow = make(kind, features)
    for value in (flow.log_prob(flow.sample(50, seeded(0))).sum(), (flow.rsample(50, seeded(0)) ** 3).sum()):
        flow.zero_grad()
        value.backward()
        for name, p in flow.named_parameters():
            assert p.grad is not None, name
            assert float(p.grad.abs().sum()) > 0, name


@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_sampling_repeats_and_leaves_the_global_generator_alone(kind, features):
    """Equal seeds give equal samples and weights, other seeds others; torch's own generator does not move."""
    before = torch.get_rng_state()
    first, second, third = make(kind, features, 4), make(kind, features, 4), make(kind, features, 5)
    a, b = first.sample(20, seeded(1)), second.sample(20, seeded(1))
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(a, b)
    assert not torch.equal(a, first.sample(20, seeded(2)))
    assert not torch.equal(a, third.sample(20, seeded(1)))
    torch.manual_seed(99)
    assert torch.equal(make(kind, features, 4).sample(20, seeded(1)), a)


@pytest.mark.parametrize("kind", ["realnvp", "nsf", "maf"])
def test_flow_starts_as_an_almost_even_cover_of_the_box(kind):
    """At the start each marginal of sigmoid(z) is near uniform, whatever the seed."""
    for seed in range(3):
        z = build_flow(4, kind, seed=seed).sample(4000, seeded(seed))
        unit = torch.sigmoid(z).numpy()
        for column in unit.T:
            # sup distance of the two distributions functions: 0.024 from the normal in place of the logistic (next
            # test), 1.63 / sqrt(4000) = 0.026 from sampling at the 99 % level, some for "near" the identity
            assert scipy.stats.kstest(column, "uniform").statistic < 0.024 + 0.026 + 0.03


def test_initial_scale_is_the_closest_normal_to_a_uniform_box():
    """Of the normals, this scale has the least divergence from the uniform's logistic z, and it is 0.014 nats."""
    z = np.linspace(-60, 60, 600001)
    logistic = scipy.stats.logistic.pdf(z)

    def divergence(scale):
        gap = scipy.stats.logistic.logpdf(z) - scipy.stats.norm.logpdf(z, scale=scale)
        return (logistic * gap).sum() * (z[1] - z[0])

    best = divergence(INITIAL_SCALE)
    assert best < min(divergence(INITIAL_SCALE * 1.01), divergence(INITIAL_SCALE / 1.01))
    assert best == pytest.approx(0.014, abs=5e-4)
    xi = np.linspace(1e-6, 1 - 1e-6, 100001)
    gap = scipy.stats.norm.cdf(np.log(xi / (1 - xi)), scale=INITIAL_SCALE) - xi
    assert np.abs(gap).max() < 0.024


@pytest.mark.parametrize(
    ("kind", "features"), [("nsf", 1), ("realnvp", 2), ("maf", 6), ("realnvp", 30), ("mixture", 2)]
)
def test_far_points_have_a_finite_log_density(kind, features):
    """Out to |z| = 745, where float64's sigmoid ends, log_prob and its gradient are finite and very low."""
    density = make(kind, features)
    near = density.log_prob(torch.zeros(features, dtype=torch.float64))
    for far in (40.0, -40.0, 745.0, -745.0):
        z = torch.full((features,), far, dtype=torch.float64, requires_grad=True)
        value = density.log_prob(z)
        assert bool(torch.isfinite(value))
        assert value < near - 50
        assert bool(torch.isfinite(torch.autograd.grad(value, z)[0]).all())


@pytest.mark.parametrize(("kind", "features"), [("nsf", 1), ("realnvp", 2)])
def test_flow_learns_two_peaks(kind, features):
    """Fitted by maximum likelihood, a flow comes closer to a two-peaked density than any single Gaussian can."""
    target = GaussianMixture(
        torch.ones(2),
        torch.tensor([-2.0, 2.0])[:, None].repeat(1, features),
        0.25 * torch.eye(features).repeat(2, 1, 1),
    )
    z, test = target.sample(1000, seeded(0)), target.sample(2000, seeded(1))
    flow = build_flow(features, kind, seed=0)
    flow.start_at(z.mean(0), torch.atleast_2d(torch.cov(z.T)))
    optimizer = torch.optim.Adam(flow.parameters(), lr=1e-2)
    for _ in range(100):
        optimizer.zero_grad()
        (-flow.log_prob(z).mean()).backward()
        optimizer.step()
    gaussian = GaussianMixture(torch.ones(1), z.mean(0)[None], torch.atleast_2d(torch.cov(z.T))[None])
    with torch.no_grad():
        best, got, plain = (float(d.log_prob(test).mean()) for d in (target, flow, gaussian))
    assert got > plain + 0.5 * (best - plain)
    assert got < best + 0.05  # 2000 test points: the mean's standard error is about 0.02


@pytest.mark.parametrize("sheared", [True, False])
def test_a_flow_starts_at_a_gaussian(sheared):
    """Log densities are the Gaussian's, its correlations included where it is sheared, but for the start's per cent."""
    g = seeded(3)
    a = torch.randn(4, 4, generator=g, dtype=torch.float64)
    mean, covariance = torch.randn(4, generator=g, dtype=torch.float64), a @ a.mT + 0.1 * torch.eye(4)
    flow = build_flow(4, "realnvp", sheared=sheared)
    flow.start_at(mean, covariance)
    width = covariance if sheared else torch.diag(covariance.diagonal())
    expected = GaussianMixture(torch.ones(1), mean[None], width[None])
    z = expected.sample(200, g)
    log_density = expected.log_prob(z).numpy()
    with torch.no_grad():
        found = flow.log_prob(z).numpy()
    np.testing.assert_allclose(found, log_density, atol=0.2)
    assert np.mean(found - log_density) == pytest.approx(0, abs=0.02)


def test_mixture_agrees_with_scipy():
    """Log densities as from SciPy's multivariate normals, sample moments as from the formula."""
    mixture = make("mixture", 3)
    weights = np.array([0.2, 0.5, 0.3])
    covariances = (mixture.scale_tril @ mixture.scale_tril.mT).numpy()
    means = mixture.means.numpy()
    z = np.random.default_rng(0).normal(size=(20, 3)) * 3
    parts = [scipy.stats.multivariate_normal(m, c).pdf(z) for m, c in zip(means, covariances, strict=True)]
    expected = np.log(np.tensordot(weights, parts, 1))
    # the weights came as float32
    np.testing.assert_allclose(mixture.log_prob(torch.tensor(z)).numpy(), expected, rtol=1e-6)
    samples = mixture.sample(40000, seeded(0)).numpy()
    mean = weights @ means
    spread = np.einsum("k,kij->ij", weights, covariances) + np.cov(means.T, aweights=weights, ddof=0)
    # five standard errors of the mean; the covariance's largest entry is known to about 1 %
    assert (np.abs(samples.mean(0) - mean) < 5 * np.sqrt(np.diag(spread) / 40000)).all()
    np.testing.assert_allclose(np.cov(samples.T), spread, atol=0.05 * spread.max())


def test_mixture_without_weight_is_never_drawn():
    """A component of weight zero changes nothing."""
    eye = torch.eye(1).repeat(3, 1, 1)
    mixture = GaussianMixture(torch.tensor([0.0, 1.0, 0.0]), torch.tensor([[-99.0], [0.0], [99.0]]), eye)
    assert float(mixture.sample(1000, seeded(0)).abs().max()) < 10
    single = GaussianMixture(torch.ones(1), torch.zeros(1, 1), eye[:1])
    z = torch.linspace(-3, 3, 5, dtype=torch.float64)[:, None]
    assert torch.equal(mixture.log_prob(z), single.log_prob(z))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((torch.ones(2), torch.zeros(1, 2), torch.eye(2)[None]), r"do not fit means \(1, 2\)"),
        ((torch.ones(1), torch.zeros(2), torch.eye(2)[None]), r"means \(K, D\), got"),
        ((-torch.ones(1), torch.zeros(1, 2), torch.eye(2)[None]), "non-negative with a positive sum"),
        ((torch.ones(1), torch.zeros(1, 2) / 0, torch.eye(2)[None]), r"means\[0\] holds a number that is not finite"),
        ((torch.ones(1), torch.zeros(1, 2), torch.ones(1, 2, 2)), r"covariances\[0\] is not positive definite"),
        ((torch.ones(1), torch.zeros(1, 2), torch.tensor([[[1, 0.5], [0, 1]]])), r"covariances\[0\] is not symm"),
    ],
)
def test_mixture_refuses(arguments, text):
    """What is no mixture is refused, with the component named."""
    with pytest.raises(BadInput, match=text):
        GaussianMixture(*arguments)


def test_build_flow_chooses_and_refuses():
    """The kind auto takes splines for one parameter; what cannot be built is refused."""
    assert build_flow(1).kind == "nsf"
    assert build_flow(2).kind == "realnvp"
    for kind in ("realnvp", "maf"):
        with pytest.raises(BadInput, match=f"a {kind} flow of one parameter is an affine map .* use 'nsf'"):
            build_flow(1, kind)
    with pytest.raises(BadInput, match="unknown flow kind 'glow'; there are: auto, realnvp, nsf, maf"):
        build_flow(2, "glow")  # pyright: ignore[reportArgumentType]
    wrong: list[dict[str, Any]] = [{"transforms": 0}, {"hidden_features": ()}, {"hidden_features": (8, 0)}]
    for sizes in wrong:
        with pytest.raises(BadInput, match=f"{next(iter(sizes))} must be made of integers of at least 1"):
            build_flow(2, **sizes)
    with pytest.raises(BadInput, match="features must be made of"):
        build_flow(0)
    with pytest.raises(BadInput, match="unknown density kind 'glow'; there are: gaussian_mixture, realnvp"):
        make_density({"kind": "glow"})
    with pytest.raises(BadInput, match="sizes of a realnvp density cannot be read"):
        make_density({"kind": "realnvp", "width": 3})
    with pytest.raises(BadInput, match="features and components must be integers of at least 1, got 2 and -1"):
        make_density({"kind": "gaussian_mixture", "features": 2, "components": -1})
