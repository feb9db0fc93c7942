"""Measuring a distribution against the truth."""

import io
import json
import sys

import numpy as np
import pytest
import torch
from rich.console import Console
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from nfpde.corner import corner
from nfpde.distribution import ParameterDistribution
from nfpde.errors import BadInput, SpaceMismatch
from nfpde.evaluate import evaluate
from nfpde.flow import GaussianMixture, build_flow
from nfpde.ot import emd
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.truth import Population, Truth

SPACE = ParameterSpace([Parameter("mass", low=2.0, high=6.0, unit="kg"), Parameter("damping", low=0.0, high=0.1)])
POPULATION = Population(np.ones(1), np.array([[4.0, 0.05]]), np.diag([0.04, 2.5e-5])[None])


def gaussian(centre, scale, space=SPACE):
    """A Gaussian in z around the physical point `centre`."""
    d = len(space)
    mean = torch.tensor(space.to_unconstrained(centre))[None]
    return ParameterDistribution(
        space, GaussianMixture(torch.ones(1), mean, scale**2 * torch.eye(d, dtype=torch.float64)[None])
    )


def make_truth(n=6, population=POPULATION):
    rng = np.random.default_rng(5)
    return Truth(SPACE, POPULATION.sample(n, SPACE, rng), [f"e{i}" for i in range(n)], population)


def test_distances_agree_with_an_assignment():
    """With as many samples as episodes, optimal transport is the best assignment, which SciPy solves."""
    truth, estimate = make_truth(40), gaussian([3.0, 0.03], 1.0)
    result = evaluate(estimate, truth, samples=40)
    for width, got in (
        (1.0, result.to_episodes["estimate"].physical),
        (SPACE.width, result.to_episodes["estimate"].box),
    ):
        cost = cdist(result.xi / width, truth.xi / width)
        assert got == pytest.approx(cost[linear_sum_assignment(cost)].mean(), rel=1e-9)


def test_distance_to_one_episode_is_the_mean_distance_of_the_samples():
    """All mass must go to the single point."""
    truth = Truth(SPACE, np.array([[4.0, 0.05]]), ["only"])
    result = evaluate(gaussian([3.0, 0.03], 1.0), truth, samples=500)
    expected = np.linalg.norm(result.xi - truth.xi, axis=1).mean()
    assert result.to_episodes["estimate"].physical == pytest.approx(expected, rel=1e-9)
    assert result.to_population == {}
    assert set(result.to_episodes) == {"estimate", "uniform"}


def test_a_robot_counts_once_however_many_episodes_it_has():
    """Of robots with nine episodes and one: distances, coverage and gain are those of one episode each."""
    robots = np.array([[5.0, 0.03], [3.0, 0.08]])
    z = torch.from_numpy(SPACE.to_unconstrained(robots))
    sharp = GaussianMixture(torch.ones(2), z, 1e-12 * torch.eye(2, dtype=torch.float64).tile(2, 1, 1))
    estimate = ParameterDistribution(SPACE, sharp)
    truths = [Truth(SPACE, np.repeat(robots, n, axis=0), [f"{i}" for i in range(sum(n))]) for n in ((1, 1), (9, 1))]
    one, many = (evaluate(estimate, truth, samples=500) for truth in truths)
    assert many.episodes == 10
    assert one.to_json() == many.to_json() | {"episodes": 2}
    # an exact answer is off by the shares of 500 draws alone, of which four standard errors are 0.09 in 2 kg
    assert many.to_episodes["estimate"].physical < 0.18
    out = io.StringIO()
    Console(file=out, width=80).print(many)
    assert "10 episodes of 2 different robots," in out.getvalue()


def test_rows_are_in_the_order_that_their_closeness_demands():
    """The population beats a wide estimate, which beats a wrong one; the rows are all there."""
    truth = make_truth(20)
    wrong = gaussian([2.1, 0.095], 0.1)
    result = evaluate(gaussian([4.0, 0.05], 0.5), truth, initial=wrong, samples=300)
    for table in (result.to_episodes, result.to_population):
        assert list(table) == ["estimate", "initial", "uniform", "population"]
        for unit in ("physical", "box"):
            ranks = [getattr(table[k], unit) for k in ("population", "estimate", "uniform", "initial")]
            assert ranks == sorted(ranks)


def test_coverage_is_the_share_inside_the_intervals():
    """The median counts as covered, points far outside do not; each parameter on its own."""
    truth = Truth(SPACE, np.array([[4.0, 0.05], [4.0, 0.099], [5.9, 0.05], [4.0, 0.001]]), list("abcd"))
    result = evaluate(gaussian([4.0, 0.05], 0.1), truth, samples=500)
    assert result.coverage_50 == [0.75, 0.5]
    assert result.coverage_90 == [0.75, 0.5]


def test_coverage_of_the_right_distribution_is_right():
    """True parameters drawn from the estimate itself fall inside its intervals as often as they should."""
    estimate = gaussian([4.0, 0.05], 0.7)
    n = 800
    truth = Truth(SPACE, estimate.sample(n, seed=9), [str(i) for i in range(n)])
    result = evaluate(estimate, truth, samples=1000)
    # four standard errors of a share out of 800, and of the quantiles of 1000 samples
    for shares, expected in ((result.coverage_50, 0.5), (result.coverage_90, 0.9)):
        error = 4 * np.sqrt(expected * (1 - expected) * (1 / n + 1 / 1000))
        np.testing.assert_allclose(shares, expected, atol=error)


def test_log_density_gain_counts_from_the_uniform_distribution():
    """A Gaussian in z has the gain of the formula at its centre; a true parameter on a bound gives -inf."""
    truth = Truth(SPACE, np.array([[4.0, 0.05]]), ["only"])
    sharp = evaluate(gaussian([4.0, 0.05], 0.1), truth, samples=10)
    # at z = 0 a Gaussian of width s has density 1 / (s sqrt(2 pi)), and the box has slope width / 4
    expected = 2 * np.log(4 / (0.1 * np.sqrt(2 * np.pi)))
    assert sharp.log_density_gain == pytest.approx(expected, rel=1e-9)
    on_bound = evaluate(gaussian([4.0, 0.05], 0.1), Truth(SPACE, np.array([[2.0, 0.05]]), ["only"]), samples=10)
    assert on_bound.log_density_gain == -np.inf
    assert on_bound.to_json()["log_density_gain"] is None


def test_evaluation_repeats():
    """Equal seeds give equal figures, another seed others."""
    truth, estimate = make_truth(), gaussian([3.0, 0.03], 1.0)
    first, again, other = (evaluate(estimate, truth, samples=50, seed=s).to_json() for s in (1, 1, 2))
    assert first == again
    assert first != other


def test_json_table_and_picture(tmp_path):
    """The JSON is valid, the table shows all rows and units, the picture is a PNG."""
    result = evaluate(gaussian([4.0, 0.05], 0.5), make_truth(), samples=50)
    content = json.loads(json.dumps(result.to_json(), allow_nan=False))
    distance = content["optimal_transport"]["to_population"]["estimate"]
    assert distance == {
        "physical": result.to_population["estimate"].physical,
        "box": result.to_population["estimate"].box,
    }
    assert set(content["coverage"]) == {"mass", "damping"}
    out = io.StringIO()
    Console(file=out, width=80).print(result)
    for text in ("to robots", "to population", "in boxes", "uniform", "damping", "nats", "50 samples"):
        assert text in out.getvalue()
    assert result.draw(tmp_path / "picture.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("seed", [-1, 2**63, 1.0, True, "0"])
def test_seeds_out_of_range_are_refused(seed):
    """Before anything is drawn, with both ends of the range."""
    with pytest.raises(BadInput, match=f"seed is {seed!r}; it must be an integer from 0 to 9223372036854775807"):
        evaluate(gaussian([4.0, 0.05], 1.0), make_truth(), seed=seed)


def test_other_spaces_are_refused():
    """Estimate and truth must be about the same parameters; estimate and initial distribution of one space."""
    other = ParameterSpace([SPACE[0], Parameter("friction", low=0.0, high=0.1)])
    with pytest.raises(SpaceMismatch, match=r"only the truth has damping, only the others friction"):
        evaluate(ParameterDistribution(other, build_flow(2)), make_truth())
    wider = ParameterSpace([SPACE[0], Parameter("damping", low=0.0, high=0.2)])
    with pytest.raises(SpaceMismatch, match=r"damping.*high is 0\.2 here and 0\.1 there"):
        evaluate(gaussian([4.0, 0.05], 1.0), make_truth(), initial=ParameterDistribution(wider, build_flow(2)))
    with pytest.raises(BadInput, match="samples must be at least 2, got 1"):
        evaluate(gaussian([4.0, 0.05], 1.0), make_truth(), samples=1)


def test_a_fit_may_have_other_bounds_and_another_order():
    """Distances are in physical units, so that they are those of the same samples in the truth's own space."""
    turned = ParameterSpace(
        [Parameter("damping", low=-0.3, high=0.2), Parameter("mass", low=0.0, high=20.0, unit="kg")]
    )
    estimate = ParameterDistribution(turned, build_flow(2))
    truth = make_truth()
    result = evaluate(estimate, truth, samples=200)
    xi = estimate.sample(200, 0)[:, ::-1]
    assert result.names == ["damping", "mass"]
    assert result.to_episodes["estimate"].physical == pytest.approx(emd(xi, truth.xi).cost, rel=1e-9)  # order of sums


@pytest.mark.parametrize(("low", "high", "drawn"), [(3.5, 4.6, True), (3.9999999, 4.0000001, False)])
def test_a_picture_in_narrower_bounds_than_the_populations(tmp_path, monkeypatch, low, high, drawn):
    """What of the population lies outside of the fit's bounds is left out, all of it where none lies inside."""
    shown = {}

    def watched(xi, path, **given):
        shown.update(given)
        return corner(xi, path, **given)

    monkeypatch.setattr(sys.modules["nfpde.evaluate"], "corner", watched)
    narrow = ParameterSpace([Parameter("mass", low=low, high=high, unit="kg"), SPACE[1]])
    truth = Truth(SPACE, np.array([[4.0, 0.05]]), ["only"], POPULATION)
    result = evaluate(gaussian([4.0, 0.05], 0.5, narrow), truth, samples=50)
    assert result.draw(tmp_path / "picture.png").read_bytes()[:4] == b"\x89PNG"
    assert (shown["population"] is not None) == drawn
    if drawn:
        # a normal distribution of standard deviation 0.2, cut 2.5 below and 3 above its mean
        assert 0.98 < len(shown["population"]) / 2000 < 1
