"""Wide bounds: where the search begins, how far it goes, and what is said where it found nothing."""

import numpy as np
import pytest
import torch

import nfpde
from nfpde.estimation import tell, write_report
from nfpde.estimation.trajectory.cautions import no_better
from nfpde.estimation.trajectory.places import over_decades, spread_over_decades, spread_over_width

torch.set_num_threads(1)

DT, TRUE = 0.05, np.array([[1.0, 0.05], [1.1, 0.06]])


def swing(state, ctrl, xi):
    """A pendulum with a push, its mass and its damping."""
    q, v = state.T
    v = v + DT * (ctrl[:, 0] - xi[:, 1] * v - np.sin(q)) / xi[:, 0]
    return np.column_stack([q + DT * v, v])


def recordings(noise=0.003, rows=41, seed=0):
    rng, episodes = np.random.default_rng(seed), []
    for g, xi in enumerate(TRUE):
        u, x = rng.uniform(-1, 1, (rows, 1)), rng.normal(size=(rows, 2))
        for t in range(rows - 1):
            x[t + 1] = swing(x[t : t + 1], u[t : t + 1], xi[None])[0]
        x += noise * rng.normal(size=x.shape)
        episodes.append(nfpde.Episode(f"{g}", DT * np.arange(rows), x[:, :1], x[:, 1:], u))
    return nfpde.Dataset(episodes)


def fitted(mass, damping, data=None, **settings):
    space = nfpde.ParameterSpace([nfpde.Parameter("mass", None, *mass), nfpde.Parameter("damping", None, *damping)])
    simulator = nfpde.CallableSimulator(swing, space, ["q"], ["v"], ["u"])
    config = nfpde.TrajectoryConfig(**settings)
    return nfpde.fit(simulator, data or recordings(), config=config, quiet=True)


def values(result):
    table = [[r["parameters"][n] for n in ("mass", "damping")] for r in result.info["robots"]]
    return np.array([[[p["value"], p["std"]] for p in row] for row in table])


@pytest.fixture(scope="module")
def narrow():
    return values(fitted((0.5, 2.0), (0.0, 1.0)))


@pytest.mark.parametrize(
    ("mass", "damping"),
    [((0.01, 1000.0), (0.0, 1.0)), ((0.5, 2.0), (0.0, 1e4)), ((0.01, 1000.0), (0.0, 10.0)), ((0.001, 1e5), (0.0, 1e3))],
    ids=["mass", "damping", "both", "both far"],
)
def test_bounds_that_span_decades_change_nothing(mass, damping, narrow):
    """The same robots are found in them as in narrow ones, as precisely, with no words about bounds."""
    result = fitted(mass, damping)
    found = values(result)
    # the narrow bounds' prior is next to nothing beside 40 windows, and draws tell a mean to a fifth of its error
    np.testing.assert_array_less(np.abs(found - narrow)[:, :, 0], 0.5 * narrow[:, :, 1])
    np.testing.assert_allclose(found[:, :, 1], narrow[:, :, 1], rtol=0.5)
    assert result.info["converged"]
    assert result.info["cautions"] == []
    assert all(p["leans_on"] is None for r in result.info["robots"] for p in r["parameters"].values())


def test_places_are_spread_over_the_decades_of_those_that_span_them():
    """Of bounds on one side of zero a decade apart; the others have theirs spread over the width."""
    bounds = [(0.01, 1000.0), (0.0, 5.0), (-20.0, -1.0), (-1000.0, 1000.0), (3.0, 20.0)]
    space = nfpde.ParameterSpace([nfpde.Parameter(f"p{i}", None, low, high) for i, (low, high) in enumerate(bounds)])
    assert over_decades(space).tolist() == [True, True, True, False, False]
    xi = space.to_physical(spread_over_decades(space, 64, 0))
    assert ((xi > space.low) & (xi < space.high)).all()
    for i, decades in ((0, (-2, 3)), (1, (np.log10(5) - 6, np.log10(5))), (2, (0, np.log10(20)))):
        shares = (np.log10(np.abs(xi[:, i])) - decades[0]) / (decades[1] - decades[0])
        # quasi-random: every eighth of the inner part has its share of the 64
        counts, _ = np.histogram(shares, 8, (0.1, 0.9))
        assert counts.min() >= 6
    shares = (xi[:, 3:] - space.low[3:]) / space.width[3:]
    assert shares.min() > 0.09
    assert shares.max() < 0.91
    plain = (space.to_physical(spread_over_width(space, 4, 0)) - space.low) / space.width
    assert plain.min() > 0.09
    assert plain.max() < 0.91


def test_bounds_within_a_decade_cost_no_simulation(monkeypatch):
    """Nothing is spread there, and results are what they were; beyond a decade places are simulated once."""
    asked = []
    monkeypatch.setattr(
        "nfpde.estimation.trajectory.places.spread_over_decades", lambda *a: asked.append(a) or spread_over_decades(*a)
    )
    fitted((0.5, 2.0), (0.02, 0.15))
    assert not asked
    fitted((0.5, 2.0), (0.0, 0.15))
    assert len(asked) == 1


def test_as_far_as_is_searched_is_said(monkeypatch):
    """A damping that lies closer to its bound than is searched leans on it, however sharp its posterior looks."""
    for module in ("levenberg", "describe"):
        monkeypatch.setattr(f"nfpde.estimation.trajectory.{module}.FARTHEST", 9.0)
    result = fitted((0.5, 2.0), (0.0, 1e4))
    value, std = values(result)[:, 1].T
    assert (value > TRUE[:, 1] + 5 * std).any(), "1.2 is where the search ends"
    assert all(robot["parameters"]["damping"]["leans_on"] == "low" for robot in result.info["robots"])


def test_nothing_found_is_said(tmp_path, monkeypatch):
    """Where the search begins too far away and parameters look untold the result says so, in the report as well."""
    monkeypatch.setattr("nfpde.estimation.trajectory.estimator.better_over_decades", lambda *a: None)
    lost = fitted((0.01, 1e5), (0.0, 10.0))
    assert {row["told"] for row in lost.info["tells"]["parameters"].values()} == {0}
    (words,) = lost.info["cautions"]
    assert "no better than by the middle of the bounds" in words
    assert any(words in line for line in tell(lost))
    write_report(lost, tmp_path)
    assert words in (tmp_path / "report.html").read_text()


def test_better_is_more_than_chance():
    """Two parameters gain 9.2 in twice the log likelihood once in a hundred."""
    for windows, ratio, expected in ((100, 1.04, True), (100, 1.06, False), (1000, 1.004, True), (1000, 1.006, False)):
        errors = {"q": {"before": 1.0, "after": 1.0}, "v": {"before": ratio, "after": 1.0}}
        assert no_better(errors, windows, 2) == expected
    assert no_better({"q": {"before": 0.0, "after": 0.0}}, 10, 2)
