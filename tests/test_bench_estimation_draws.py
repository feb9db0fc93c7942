"""What the distance to fresh draws of a population can tell."""

import numpy as np
import pytest

import nfpde
from nfpde.bench.estimation.draws import NARROWER, REDRAWN, redrawn, yardsticks
from nfpde.distribution import ParameterDistribution
from nfpde.estimation.trajectory.population import prior_density
from nfpde.truth import Population, Truth


def truth_of(features, robots=5):
    """Robots drawn from a Gaussian far inside its box, a tenth of which is a standard deviation."""
    space = nfpde.ParameterSpace([nfpde.Parameter(f"p{i}", low=-5.0, high=5.0) for i in range(features)])
    population = Population(np.ones(1), np.zeros((1, features)), np.eye(features)[None])
    xi = population.sample(robots, space, np.random.default_rng(0))
    return Truth(space, xi, [f"{i}" for i in range(robots)], population)


def test_in_one_dimension_the_truth_is_rated_best():
    """Many draws of one number are close to the distribution: all that is narrower is farther, by (1 - s) E|x|."""
    found = yardsticks(truth_of(1), 2000)
    assert len(found["truth"]) == len(found["moments"]) == REDRAWN
    assert max(found["truth"]) < found["narrowed"]["0.5"]
    # the exact cost between N(0, 1) and N(0, s) is (1 - s) sqrt(2 / pi); the means of twice 2000 draws differ by 0.03
    for share in NARROWER:
        assert found["narrowed"][f"{share:g}"] == pytest.approx((1 - share) * np.sqrt(2 / np.pi), abs=0.1)


def test_in_many_dimensions_something_narrower_is_rated_better():
    """Draws of 30 numbers are all far from each other, and nearer to what lies in the middle."""
    found = yardsticks(truth_of(30), 300)
    assert found["narrowed"]["0.7"] < min(found["truth"])


def test_few_robots_tell_little_of_where_the_population_is():
    """The mean of five robots is off by a fifth of the variance: their own moments are farther than the truth."""
    found = yardsticks(truth_of(4), 500)
    assert min(found["moments"]) > max(found["truth"])


def test_draws_are_drawn_anew():
    """Every distance is of draws of its own; a box is farther from the population than the population is."""
    truth = truth_of(3)
    box = ParameterDistribution(truth.space, prior_density(3))
    found = redrawn(box, truth, 300)
    assert len(set(found)) == REDRAWN
    assert min(found) > max(yardsticks(truth, 300)["truth"])


def test_nothing_is_said_of_a_population_that_is_not_known():
    """Where only the robots are known there are no fresh draws."""
    truth = truth_of(2)
    alone = Truth(truth.space, truth.xi, truth.episodes)
    assert redrawn(ParameterDistribution(truth.space, prior_density(2)), alone, 10) == []
    assert yardsticks(alone, 10) == {"truth": [], "moments": [], "narrowed": {}}
