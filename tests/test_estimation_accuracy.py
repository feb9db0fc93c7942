"""Errors of robots beside their Cramer-Rao bounds: against arithmetic, and on robots of whom the bound is known."""

import numpy as np
import torch
from rich.console import Console

import nfpde
from nfpde.estimation.accuracy import accuracy
from nfpde.truth import Truth
from tests.linear_robots import SPACE, linear_simulator, moments

torch.set_num_threads(1)


def row(name, episodes, **parameters):
    found = {n: {"value": value, "cramer_rao": bound} for n, (value, bound) in parameters.items()}
    return {"robot": name, "episodes": episodes, "parameters": found}


def shown(found):
    console = Console(width=100)
    with console.capture() as captured:
        console.print(found)
    return captured.get()


def test_errors_and_bounds_by_hand():
    """Robots of several episodes count once; those whose truth is not known, or not one, do not."""
    space = nfpde.ParameterSpace([nfpde.Parameter(n, low=0.0, high=9.0, unit="kg") for n in "ab"])
    truth = Truth(space, np.array([[1.0, 2.0], [1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), ["0", "1", "2", "3"])
    rows = [
        row("x", ["0", "1"], a=(1.3, 0.1), b=(2.0, None)),
        row("y", ["2"], a=(2.6, 0.2), b=(4.5, 0.5)),
        row("both", ["2", "3"], a=(3.0, 1.0), b=(4.0, 1.0)),
        row("unknown", ["9"], a=(3.0, 1.0), b=(4.0, 1.0)),
    ]
    found = accuracy(rows, truth)
    assert found is not None
    assert found.robots == ["x", "y"]
    np.testing.assert_allclose(found.error, [[0.3, 0.0], [-0.4, 0.5]])
    assert found.to_json()["x"]["b"] == {"error": 0.0, "cramer_rao": None}
    a, b = (next(line.split() for line in shown(found).splitlines() if line.split()[:1] == [n]) for n in "ab")
    # sqrt((.09 + .16) / 2), sqrt((.01 + .04) / 2), sqrt((9 + 4) / 2)
    assert a[1:] == ["kg", "0.354", "0.158", "2.55", "2", "of", "2"]
    assert b[1:] == ["kg", "0.354", "0.5", "1.00", "1", "of", "2"]
    assert accuracy(rows[3:], truth) is None
    assert accuracy([], truth) is None
    assert accuracy([{k: v for k, v in rows[0].items() if k != "episodes"}], truth) is None


def test_an_efficient_estimator_reaches_the_bound():
    """Linear robots with noise: errors are as large as their bounds, to what 60 numbers tell of a variance."""
    rng = np.random.default_rng(0)
    xi = rng.uniform(-2, 2, (30, 2))
    episodes = [e for i, true in enumerate(xi) for e in moments(f"{i}", true, rng, 20, 0.05)]
    result = nfpde.fit(linear_simulator(), nfpde.Dataset(episodes), quiet=True)
    names = [e.name for e in episodes]
    found = accuracy(result.info["robots"], Truth(SPACE, np.array([xi[int(e.robot)] for e in episodes]), names))
    assert found is not None
    assert len(found.robots) == 30
    ratio = np.sqrt(np.mean((found.error / found.bound) ** 2))
    # four standard errors of a root mean square, 1 / sqrt(2 n); others that inform may bring it lower
    assert 0.7 < ratio < 1 + 4 / np.sqrt(120)
