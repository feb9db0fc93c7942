"""What the words say of combinations, several values and few moments is what the numbers say."""

import re

import numpy as np
import pytest

import nfpde
from nfpde.estimation.trajectory.advice import _information
from nfpde.estimation.trajectory.identify import Knowledge, _percent, describe_knowledge
from nfpde.estimation.trajectory.modes import LocalPosterior
from nfpde.estimation.trajectory.noise import Noise, Scatter
from nfpde.estimation.trajectory.problem import make_problem


def space_of(*names: str, low: float = -1.0, high: float = 6.0, units: str | list[str] = "kg"):
    given = [units] * len(names) if isinstance(units, str) else units
    return nfpde.ParameterSpace(
        [nfpde.Parameter(n, low=low, high=high, unit=u) for n, u in zip(names, given, strict=True)]
    )


def known(space, value, covariance):
    value = np.array(value)
    return Knowledge(space, value, covariance, value[None], np.sqrt(np.diag(covariance))[None])


def tied(v, loose, sharp):
    """A covariance of which the combination v is told, with a standard error `sharp`, and all else is `loose`."""
    v = np.asarray(v)
    unit = v / np.linalg.norm(v)
    return loose**2 * (np.eye(len(v)) - np.outer(unit, unit)) + sharp**2 / (v @ v) * np.outer(unit, unit)


def said(words):
    """The combination that words name, and the percent that they say."""
    text, rest = words.split(" is known to ")
    signs = re.findall(r"(^|[+-] )([0-9.e-]+ )?([a-z])", text)
    v = [(-1.0 if sign == "- " else 1.0) * float(number or 1) for sign, number, _ in signs]
    return np.array(v), float(rest.split(" %")[0])


@pytest.mark.parametrize("factor", [1.0, 1.001, 0.8, 1.2, 1.2345, 2.0, -1.2, -0.9])
def test_the_error_of_two_is_that_of_what_is_printed(factor):
    """It is within twice the least, and nobody is told that a + b is known where a + 1.2 b is."""
    space, covariance, value = space_of("a", "b"), tied([1.0, factor], 0.5, 1e-3), [3.0, 2.0]
    (row,) = known(space, value, covariance).pairs()
    v, percent = said(row["words"])
    error = np.sqrt(v @ covariance @ v)
    assert error < 2.1e-3
    np.testing.assert_allclose(percent, 100 * error / abs(v @ value), rtol=0.05)


@pytest.mark.parametrize("factor", [1.0, 1.2])
def test_the_error_of_three_is_that_of_what_is_printed(factor):
    """Coefficients are left out where leaving them out says as much."""
    space, value = space_of("a", "b", "c"), [3.0, 2.0, 4.0]
    covariance = tied([1.0, factor, 1.0], 0.5, 1e-3)
    words = known(space, value, covariance).group()
    v, percent = said(words)
    assert (factor == 1.0) == words.startswith("a + b + c is known")
    np.testing.assert_allclose(percent, 100 * np.sqrt(v @ covariance @ v) / abs(v @ value), rtol=0.05)
    assert np.sqrt(v @ covariance @ v) < 2.1e-3


@pytest.mark.parametrize("power", [1.0, 1.2])
def test_a_ratio_is_said_where_it_is_known(power):
    """In logs: a / b^1.2 known says little of a / b."""
    space, x, y = space_of("a", "b", low=1.0, units=["kg", "Nm"]), 3.0, 2.0
    logs = tied([1.0, -power], 0.1, 1e-4)
    covariance = logs * np.outer([x, y], [x, y])
    (row,) = known(space, [x, y], covariance).pairs()
    assert ("a / b" in row["words"]) == (power == 1.0)
    if power == 1.0:
        np.testing.assert_allclose(said(row["words"].replace("a / b", "a"))[1], 0.01, rtol=0.05)


def test_rounding_errors_ask_for_no_coefficients():
    """What is known to more digits than words show is a plain sum."""
    (row,) = known(space_of("a", "b"), [3.0, 2.0], tied([1.0, 1.0 + 1e-7], 0.5, 1e-12)).pairs()
    assert row["words"].startswith("a + b is known to better than 0.001 %")


def test_several_sharp_values_are_told():
    """A robot of which recordings leave two values, each known well, counts as one that tells the parameter."""
    space = space_of("offset", low=-3.0, high=3.0, units="m")
    z = space.to_unconstrained([[-2.0], [2.0]])
    slope = 6.0 * np.exp(-z) / (1 + np.exp(-z)) ** 2
    fisher = (slope / 0.01)[:, :, None] ** 2
    both = Knowledge.of(space, LocalPosterior(np.array([0.5, 0.5]), z, 1 / fisher, fisher))
    found = describe_knowledge([both, both])["parameters"]["offset"]
    assert found["words"] == both.words(0) == "-2 or 2, each known to 0.01 m"
    assert found["told"] == 2


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_moments_tell_what_they_tell(count):
    """Where they are too few to leave out the loudest, the mean information is that of all, and not of none."""
    space = nfpde.ParameterSpace([nfpde.Parameter("gain", low=0.0, high=2.0)])
    simulator = nfpde.CallableSimulator(lambda x, u, xi: x + 0.1 * xi * u, space, ["x"])
    u = np.arange(1.0, count + 2)[:, None]
    x = 0.1 * (np.cumsum(u, axis=0) - u)
    episode = nfpde.Episode("a", 0.1 * np.arange(count + 1), x, np.empty((count + 1, 0)), u)
    problem = make_problem(simulator, nfpde.Dataset([episode]), 1)
    noise = Noise.alike(Scatter(np.zeros(0), np.full((1, 1), 0.01**2)), problem.members)
    found = _information(problem, problem.windows, np.ones(1), [0], noise)
    # the end moves by 0.1 x 2 u a width of the bounds
    slopes = 0.2 * u[:-1] / problem.unit / 0.01
    np.testing.assert_allclose(found, (slopes**2).mean(), rtol=1e-5)


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.123, "12 %"), (0.994, "99 %"), (0.997, "1e2 %"), (1.2345, "123 %"), (0.00123, "0.12 %"), (12.3, "1230 %")],
)
def test_percents_are_plain_numbers(share, text):
    """Two digits that count below a hundred, and no power of ten from there on."""
    assert _percent(share) == text.replace("1e2", "100")


def test_errors_of_a_hundred_and_more_are_plain_numbers():
    """With a unit too, alone and of a combination."""
    space = space_of("a", "b", low=-1e5, high=1e5, units="N")
    told = known(space, [1.0, 1.0], np.diag([150.4**2, 99.7**2]))
    assert [told.words(i) for i in (0, 1)] == ["known to 150 N", "known to 100 N"]
    (row,) = known(space, [0.0, 0.0], tied([1.0, 1.0], 9000.0, 234.0)).pairs()
    assert "a + b is known to 234 N" in row["words"]
