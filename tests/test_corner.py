"""Pictures of distributions."""

from typing import Any

import matplotlib
import numpy as np
import pytest
import scipy.stats
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nfpde.corner import corner
from nfpde.corner.content import make_content
from nfpde.corner.layout import grid, strongest_pairs, triangle
from nfpde.corner.panels import regions
from nfpde.distribution import ParameterDistribution
from nfpde.errors import BadInput
from nfpde.flow import build_flow
from nfpde.parameters import Parameter, ParameterSpace


def make_space(d):
    return ParameterSpace([Parameter("body_mass", f"a_rather_long_link_name_{i}", 1.0, 3.0 + i) for i in range(d)])


def texts(figure):
    """All labels a figure shows."""
    found = []
    for ax in figure.findobj(Axes):
        found += [ax.get_xlabel(), ax.get_ylabel()]
    return found


def content(d, **options):
    space = make_space(d)
    xi = space.uniform(300, np.random.default_rng(0))
    arguments = {"truth": None, "population": None, "nominal": None, "zoom": False}
    return make_content(space, xi, **{**arguments, **options})


@pytest.mark.parametrize("d", [1, 2, 11])
def test_a_png_is_written(tmp_path, d):
    """The file is a PNG of some size, in a new folder; neither the style nor the backend of the caller changes."""
    space = make_space(d)
    rng = np.random.default_rng(1)
    before = dict(matplotlib.rcParams)
    path = corner(
        ParameterDistribution(space, build_flow(d)),
        tmp_path / "new" / "corner.png",
        truth=space.uniform(5, rng),
        population=space.uniform(400, rng),
        nominal=np.where(np.arange(d) == 0, np.nan, space.low + 0.5),
        samples=500,
    )
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = (int.from_bytes(data[k : k + 4], "big") for k in (16, 20))
    assert min(width, height) > 300
    assert dict(matplotlib.rcParams) == before


def test_triangle_shows_every_parameter_and_pair():
    """Diagonal and lower triangle are drawn, the rest is empty; limits hold the box, labels hold names and units."""
    d = 3
    truth = make_space(d).uniform(4, np.random.default_rng(0))
    drawn = content(d, truth=truth)
    figure = triangle(drawn)
    axes = np.array(figure.axes).reshape(d, d)
    for row in range(d):
        for column in range(d):
            ax = axes[row, column]
            assert ax.axison == (column <= row)
            if column <= row:
                low, high = ax.get_xlim()
                assert low < drawn.space.low[column] < drawn.space.high[column] < high
            if column < row:
                low, high = ax.get_ylim()
                assert low < drawn.space.low[row] < drawn.space.high[row] < high
                points = next(line for line in ax.lines if line.get_marker() == "o")
                np.testing.assert_array_equal(points.get_xydata(), truth[:, [column, row]])
    label = axes[-1, 0].get_xlabel()
    assert label.replace("\n", "") == "body_massa_rather_long_link_name_0 [kg]"
    assert max(map(len, label.split("\n"))) < 23


def test_grid_shows_all_marginals_and_the_strongest_pairs():
    """With many parameters every one has a marginal, and a strongly correlated pair is among the pairs."""
    space = make_space(14)
    xi = space.uniform(400, np.random.default_rng(0))
    xi[:, 13] = space.low[13] + (xi[:, 2] - space.low[2])
    figure = grid(make_content(space, xi, None, None, None, False))
    shown = [t.replace("\n", "").removesuffix(" [kg]").removesuffix("[kg]") for t in texts(figure)]
    for name in space.names:
        assert name.replace(":", "") in shown
    assert strongest_pairs(xi, 1)[0] == pytest.approx((2, 13, 1.0))


def test_strongest_pairs_agree_with_scipy():
    """Rank correlations are Spearman's, strongest first; a parameter that never varies has none."""
    rng = np.random.default_rng(3)
    xi = rng.normal(size=(200, 4)) @ rng.normal(size=(4, 4))
    pairs = strongest_pairs(xi, 6)
    assert len(pairs) == 6
    strengths = [abs(r) for _, _, r in pairs]
    assert strengths == sorted(strengths, reverse=True)
    for i, j, r in pairs:
        expected, _ = scipy.stats.spearmanr(xi[:, i], xi[:, j])
        assert r == pytest.approx(expected, abs=1e-12)
    xi[:, 1] = 2.0
    assert all(r == 0.0 for i, j, r in strongest_pairs(xi, 6) if 1 in (i, j))


def test_regions_hold_their_share_of_the_samples():
    """The 50 % and 90 % regions of a normal hold that share of new draws of it."""
    space = ParameterSpace([Parameter("a", low=-10.0, high=10.0), Parameter("b", low=-10.0, high=10.0)])
    rng = np.random.default_rng(0)
    x, y, density, levels = regions(rng.normal(size=(20000, 2)), space, 0, 1)
    new = rng.normal(size=(5000, 2))
    column = np.clip(np.searchsorted((x[1:] + x[:-1]) / 2, new[:, 0]), 0, len(x) - 1)
    row = np.clip(np.searchsorted((y[1:] + y[:-1]) / 2, new[:, 1]), 0, len(y) - 1)
    inside = [float((density[row, column] >= level).mean()) for level in levels]
    # smoothing and cells of a sixth of a standard deviation widen the regions by some per cent
    assert inside[0] == pytest.approx(0.9, abs=0.03)
    assert inside[1] == pytest.approx(0.5, abs=0.05)


def test_zoom_shows_the_range_of_the_samples():
    """Limits are those of all that is drawn, with a margin, and not the box's."""
    space = make_space(1)
    drawn = make_content(space, [[1.5], [1.6]], [[1.7]], None, None, True)
    low, high = drawn.limits[0]
    assert 1.4 < low < 1.5
    assert 1.7 < high < 1.75
    point = make_content(space, [[1.5], [1.5]], None, None, None, True)
    low, high = point.limits[0]
    assert low < 1.5 < high


def test_samples_at_one_point_can_be_drawn():
    """All samples equal, in the box or on its corner, still make a figure."""
    space = make_space(2)
    for xi in (space.low, space.high, (space.low + space.high) / 2):
        figure = triangle(make_content(space, np.tile(xi, (5, 1)), None, None, None, False))
        assert isinstance(figure, Figure)
        figure.canvas.draw()


def test_corner_refuses_what_it_cannot_draw(tmp_path):
    """Arrays that do not fit, points outside the box and a missing space are named."""
    path = tmp_path / "x.png"
    space = make_space(2)
    good = space.uniform(10, np.random.default_rng(0))
    with pytest.raises(BadInput, match=r"samples need their parameters: corner\(samples, path, space="):
        corner(good, path)
    with pytest.raises(BadInput, match="has its own space"):
        corner(ParameterDistribution(space, build_flow(2)), path, space=space)
    with pytest.raises(BadInput, match=r"samples: .*must have shape \(n, 2\), got \(10, 1\)"):
        corner(good[:, :1], path, space=space)
    with pytest.raises(BadInput, match="at least 2 samples, got 1"):
        corner(good[:1], path, space=space)
    with pytest.raises(BadInput, match=r"truth: row 0: .* lies outside"):
        corner(good, path, space=space, truth=[[0.0, 2.0]])
    with pytest.raises(BadInput, match="population: row 0"):
        corner(good, path, space=space, population=[[np.nan, 2.0]])
    with pytest.raises(BadInput, match="at least 2 draws of it, got 1"):
        corner(good, path, space=space, population=good[:1])
    with pytest.raises(BadInput, match=r"nominal must have shape \(2,\)"):
        corner(good, path, space=space, nominal=[1.0])
    nonsense: Any = [["a", "b"]]
    with pytest.raises(BadInput, match="truth: parameter vectors must be numbers"):
        corner(good, path, space=space, truth=nonsense)
    with pytest.raises(BadInput, match=r"nominal must be 2 numbers, one a parameter, got \[\['a', 'b'\]\]"):
        corner(good, path, space=space, nominal=nonsense)
    assert not path.exists()
