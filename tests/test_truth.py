"""True parameters of simulated recordings."""

import json

import numpy as np
import pytest
import scipy.stats

from nfpde.errors import BadInput, SpaceMismatch
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.truth import Population, Truth

SPACE = ParameterSpace([Parameter("mass", low=2.0, high=6.0, unit="kg"), Parameter("damping", low=0.0, high=1.0)])
POPULATION = Population(
    np.array([0.3, 0.7]),
    np.array([[3.0, 0.2], [5.5, 0.6]]),
    np.array([[[0.04, 0.01], [0.01, 0.01]], [[1.0, 0.0], [0.0, 0.04]]]),
)
XI = np.array([[3.0, 0.1], [4.0, 0.3 - 0.2 / 3]])


def test_saved_and_loaded_is_the_same_to_the_bit(tmp_path):
    """All numbers, names and the space come back, with and without a population and a data set."""
    for population, dataset in ((POPULATION, "5ca1ab1e"), (None, None)):
        truth = Truth(SPACE, XI, ["a", "b"], population, dataset)
        truth.save(tmp_path / "deep" / "truth.json")
        back = Truth.load(tmp_path / "deep" / "truth.json")
        assert back.space == SPACE
        assert back.episodes == ("a", "b")
        assert back.dataset == dataset
        np.testing.assert_array_equal(back.xi, XI)
        if population is None:
            assert back.population is None
        else:
            assert back.population is not None
            for name in ("weights", "means", "covariances"):
                np.testing.assert_array_equal(getattr(back.population, name), getattr(population, name))


def test_over_another_space_it_says_the_same():
    """Order and bounds are the other space's; the population stays cut to its own bounds, whatever the others are."""
    other = ParameterSpace([Parameter("damping", low=-1.0, high=2.0), Parameter("mass", low=0.0, high=9.0, name="m")])
    truth = Truth(SPACE, XI, ["a", "b"], POPULATION, "5ca1ab1e")
    turned = truth.over(other)
    assert (turned.space, turned.episodes, turned.dataset) == (other, ("a", "b"), "5ca1ab1e")
    np.testing.assert_array_equal(turned.xi, XI[:, ::-1])
    assert turned.population is None
    own, drawn = (truth.draw_population(500, np.random.default_rng(0), s) for s in (None, other))
    assert own is not None
    assert drawn is not None
    np.testing.assert_array_equal(drawn, own[:, ::-1])
    assert (SPACE.low <= own).all()
    assert (own <= SPACE.high).all()
    assert Truth(SPACE, XI, ["a", "b"]).draw_population(5, np.random.default_rng(0)) is None


def test_parameters_that_names_alone_tell_apart_keep_their_columns():
    """Own simulators may have two of one field; masses are the same whether their inertia goes along or not."""
    first = ParameterSpace([Parameter("gain", low=0.0, high=1.0, name=n) for n in ("left", "right")])
    second = ParameterSpace([Parameter("gain", low=0.0, high=2.0, name=n) for n in ("right", "left")])
    np.testing.assert_array_equal(Truth(first, np.array([[0.1, 0.9]]), ["a"]).over(second).xi, [[0.9, 0.1]])
    first, second = (ParameterSpace([Parameter("body_mass", "rod", 0.0, 1.0, scale_inertia=s)]) for s in (True, False))
    assert Truth(first, np.array([[0.5]]), ["a"]).over(second).space == second
    with pytest.raises(SpaceMismatch, match="only the others none"):
        Truth(ParameterSpace([*first, Parameter("x", low=0.0, high=1.0)]), np.full((1, 2), 0.5), ["a"]).over(first)


@pytest.mark.parametrize(
    ("second", "error", "text"),
    [
        (
            Parameter("friction", low=0.0, high=1.0),
            SpaceMismatch,
            "only the truth has damping, only the others",
        ),
        (
            Parameter("damping", low=0.0, high=1.0, relative=True),
            SpaceMismatch,
            "component and relative count",
        ),
        (Parameter("damping", low=0.2, high=1.0), BadInput, r"row 0: damping = 0\.1 lies outside \[0\.2, 1\]"),
    ],
)
def test_over_spaces_that_do_not_fit(second, error, text):
    """Other parameters, the same in another sense, and bounds that leave the truth out."""
    with pytest.raises(error, match=text):
        Truth(SPACE, XI, ["a", "b"]).over(ParameterSpace([SPACE[0], second]))


def test_population_draws_follow_the_truncated_mixture():
    """Draws stay in the box, repeat under a seed, and have the marginal of the mixture cut to the box."""
    xi = POPULATION.sample(5000, SPACE, np.random.default_rng(0))
    np.testing.assert_array_equal(xi, POPULATION.sample(5000, SPACE, np.random.default_rng(0)))
    assert xi.shape == (5000, 2)
    assert SPACE.check(xi) is not None
    line = np.linspace(0.0, 1.0, 400)
    masses = np.linspace(2.0, 6.0, 400)
    points = np.stack(np.meshgrid(masses, line, indexing="ij"), -1)
    parts = zip(POPULATION.weights, POPULATION.means, POPULATION.covariances, strict=True)
    density = np.sum([w * scipy.stats.multivariate_normal(m, c).pdf(points) for w, m, c in parts], axis=0)
    for axis, grid in ((1, masses), (0, line)):
        cdf = np.cumsum(density.sum(axis))
        column = xi[:, 0 if axis == 1 else 1]
        # 1.63 / sqrt(n) is the 99 % level of the Kolmogorov-Smirnov distance; 0.004 for the grid
        assert scipy.stats.kstest(column, lambda v, g=grid, c=cdf: np.interp(v, g, c / c[-1])).statistic < 0.0275


def test_population_of_points_gives_its_points():
    """Covariances of zero are allowed: every draw is one of the means."""
    points = Population(np.array([0.5, 0.5]), XI, np.zeros((2, 2, 2)))
    xi = points.sample(50, SPACE, np.random.default_rng(0))
    assert {tuple(row) for row in xi} == {tuple(row) for row in XI}
    assert points.sample(0, SPACE, np.random.default_rng(0)).shape == (0, 2)


def test_population_outside_the_box_is_refused():
    """Rejection that would never end stops with the count."""
    outside = Population(np.ones(1), np.array([[20.0, 0.5]]), 0.01 * np.eye(2)[None])
    with pytest.raises(BadInput, match=r"only 0 of .* draws of the population fall inside the box"):
        outside.sample(5, SPACE, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (([1.0], [1.0, 2.0], np.eye(2)[None]), r"weights \(K,\), means \(K, D\) and covariances"),
        (([0.5], [[1.0, 2.0]], np.eye(2)[None]), "non-negative with sum 1"),
        (([1.0], [[1.0, np.nan]], np.eye(2)[None]), "population.means holds a number that is not finite"),
        (([1.0], [[1.0, 2.0]], [[[1.0, 2.0], [2.0, 1.0]]]), r"covariances\[0\] is not symmetric and positive"),
        (([1.0], [[1.0, 2.0]], [[[1.0, 0.5], [0.0, 1.0]]]), r"covariances\[0\] is not symmetric and positive"),
    ],
)
def test_population_refuses(arguments, text):
    """What is no mixture is refused."""
    with pytest.raises(BadInput, match=text):
        Population(*arguments)


MALFORMED = [
    ("xi", [[1.0], [1.0, 2.0]], "xi must be numbers in lists of equal length"),
    ("xi", [["3", "0.1"], ["4", "0.2"]], r"xi must hold numbers and nothing else, got \[\['3', '0.1'\]"),
    ("xi", None, "xi must hold numbers and nothing else, got None"),
    ("xi", 3, r"true parameters: .*shape \(n, 2\), got \(1, 1\)"),
    ("xi", [[3.0, 0.1], [4.0, float("nan")]], "xi holds a number that is not finite"),
    ("episodes", 5, "episodes must be a list of texts, .*; got 5"),
    ("episodes", "ab", "episodes must be a list of texts, .*; got 'ab'"),
    ("episodes", [["a"], ["b"]], "episodes must be a list of texts"),
    ("space", 5, "space: expected an object with a list 'parameters'"),
    ("space", {"parameters": [3]}, "space, parameter 0: expected a table, got 3"),
    ("dataset", 5, "dataset must be a text, the content hash of the recordings; got 5"),
    ("population", 5, "population must be an object with the entries weights, means, covariances; found: 5"),
    ("population", {"weights": [1.0]}, "population must be an object with .* means, covariances; found: weights"),
    ("population", {"weights": "a", "means": [], "covariances": []}, "population.weights must hold numbers"),
    ("population", {"weights": [1.0], "means": [[]], "covariances": [[]]}, r"population needs weights \(K,\)"),
]


def test_truth_refuses(tmp_path):
    """Values outside the box, names that do not fit and broken files are named."""
    with pytest.raises(BadInput, match=r"true parameters: row 1: mass = 7 lies outside \[2, 6\]"):
        Truth(SPACE, np.array([[3.0, 0.1], [7.0, 0.1]]), ["a", "b"])
    with pytest.raises(BadInput, match="2 true parameter vectors and 1 episode names"):
        Truth(SPACE, XI, ["a"])
    with pytest.raises(BadInput, match="names must be unique"):
        Truth(SPACE, XI, ["a", "a"])
    three = Population(np.ones(1), np.zeros((1, 3)), np.eye(3)[None])
    with pytest.raises(BadInput, match="the population has 3 parameters, the space 2"):
        Truth(SPACE, XI, ["a", "b"], three)
    path = tmp_path / "truth.json"
    with pytest.raises(BadInput, match=r"truth\.json cannot be read"):
        Truth.load(path)
    Truth(SPACE, XI, ["a", "b"]).save(path)
    good = json.loads(path.read_text())
    for content, text in [
        ("{", "is not JSON"),
        (json.dumps({**good, "schema_version": 9}), "schema_version is 9"),
        (json.dumps({k: v for k, v in good.items() if k != "xi"}), "the entry 'xi' is missing"),
        *((json.dumps({**good, name: value}), rf"truth\.json: .*{text}") for name, value, text in MALFORMED),
    ]:
        path.write_text(content)
        with pytest.raises(BadInput, match=text):
            Truth.load(path)
