"""Sizes that are screened where contacts are, and what they are for."""

import math
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.effects import DataScales, all_candidates, effect
from nfpde.gap.fit import Fitter
from nfpde.gap.noise import learn_scatter
from nfpde.gap.replay import Replay
from nfpde.gap.screen import screen
from nfpde.gap.sizes import SMALLEST, STEP, finer
from tests.test_gap_contacts import BLOCK, pushes

ANYTHING: Any = None


def test_every_effect_is_tried_small_on_both_sides_in_steps_of_four():
    """Of every direction that is screened, and its opposite, sizes reach down to a hundredth of the bounds."""
    model = mujoco.MjModel.from_xml_string(BLOCK)
    scales = DataScales.of(model, pushes(0.5, noise=1e-4))
    asked = 0
    for candidate in all_candidates(model, scales):
        values = candidate.screened(scales)
        more = finer(candidate, values)
        low, high = (np.array([getattr(p, side) for p in candidate.parameters]) for side in ("low", "high"))
        assert ((low <= more) & (more <= high)).all()
        neutral = np.array([q.neutral for q in candidate.quantities])
        sized = np.array([not q.shape_only for q in candidate.quantities])
        if not np.isfinite(neutral[sized]).all():
            assert len(more) == 0
            continue
        every = ((np.vstack([values, more]) - neutral) / (high - low))[:, sized]
        for value in values:
            way = ((value - neutral) / (high - low))[sized]
            along = every @ way / (way @ way)
            on_line = np.linalg.norm(every - np.outer(along, way), axis=1) < 1e-9
            for side in (1.0, -1.0):
                mirrored = np.where(sized, neutral + side * 1e-6 * (value - neutral), value)
                if ((low <= mirrored) & (mirrored <= high)).all():
                    sizes = np.sort(side * along[on_line & (side * along > 0)]) * np.abs(way).max()
                    assert sizes[0] <= SMALLEST * (1 + 1e-9)
                    own = np.abs(along[: len(values)][on_line[: len(values)]]).min() * np.abs(way).max()
                    small = sizes[sizes <= own * (1 + 1e-9)]
                    assert (small[1:] <= STEP * small[:-1] * (1 + 1e-9)).all()
                    asked += 1
    assert asked > 50


def test_what_points_elsewhere_or_has_another_shape_has_sizes_of_its_own():
    """Gains have two sides that are screened, a force has one; a payload's place stays where it is."""
    gains = effect("servo_gain", "bend", kp_scale=(0.2, 5.0), kv_scale=(0.2, 5.0))
    more = finer(gains, np.array([[0.85, 1.0], [1.8, 1.0]]))
    # of the way between the bounds they are 1/32 and 1/6: one step and three lead to a hundredth and below
    expected = [1 - 0.15 / 4, *(1 + 0.8 / 4.0 ** np.arange(1, 4))]
    np.testing.assert_allclose(more, np.stack([expected, np.ones(4)], axis=1))
    push = effect("external_force", "block", force_x=(-100.0, 100.0), force_y=(-100.0, 100.0), force_z=(-100.0, 100.0))
    more = finer(push, np.array([[6.0, 0.0, 0.0]]))
    assert sorted(more[:, 0].tolist()) == [-6.0, -1.5, 1.5]
    assert not more[:, 1:].any()
    place = {f"position_{axis}": (-0.1, 0.1) for axis in "xyz"}
    load = effect("payload", "block", mass=(0.0, 1.0), **place)
    more = finer(load, np.array([[0.02, 0.0, 0.0, 0.05], [0.03, 0.0, 0.0, -0.05]]))
    np.testing.assert_allclose(more, [[0.005, 0.0, 0.0, 0.05], [0.0075, 0.0, 0.0, -0.05]])
    assert len(finer(effect("torque_limit", "drive", limit=(0.1, 9.0)), np.array([[1.0]]))) == 0


class Slipping(Replay):
    """Residuals that an effect of a size up to .1 takes away in proportion, and a larger one throws all over."""

    effects = ()

    def __init__(self, start: np.ndarray, right: float, thrown: np.ndarray) -> None:
        self.start, self.right, self.thrown = start, right, thrown
        self.low, self.high = np.zeros(1), np.ones(1)

    def residuals(self, xi, windows, horizons, force=None):
        return np.stack([self.start * (1 - x / self.right) if x <= 0.1 else self.start + self.thrown for (x,) in xi])


class Line:
    """A replay without free parameters."""

    def inward(self, xi: np.ndarray) -> np.ndarray:
        return xi


@pytest.mark.parametrize("touches", [False, True])
def test_what_gains_at_a_small_size_only_is_found_where_contacts_are(touches):
    """Screened at .5 alone it explains next to nothing; with smaller sizes it ranks first, and a fit starts there."""
    rng = np.random.default_rng(6)
    start = 5.0 * rng.normal(size=(60, 1, 2))
    scatter = learn_scatter(start, 0, 1e-6 * np.ones((1, 2)))
    slips, other = (effect("coulomb_friction", t, torque=(0.0, 1.0)) for t in ("elbow", "shoulder"))
    thrown, share = 30 * rng.normal(size=start.shape), 0.1 * start + rng.normal(size=start.shape)
    replays = {"elbow": Slipping(start, 0.04, thrown), "shoulder": Slipping(start, math.inf, -share)}
    base: Any = SimpleNamespace(
        replay=Line(), xi=np.zeros(0), scatter=scatter, residuals=start, slopes=np.zeros((0, *start.shape))
    )
    tried = [(e, np.array([[0.5]])) for e in (other, slips)]
    with_effect: Any = lambda e: replays[e.place]  # noqa: E731
    found = screen(Fitter(ANYTHING, (1, 2)), base, tried, with_effect, touches=touches)
    assert (found[0].effect is slips) is touches
    if touches:
        assert 0.5 / STEP**2 in found[0].starts[0][1].ravel()


RIGHT = 0.04


class Yielding(Replay):
    """Residuals of a parameter, and of an effect that takes away what is missing and adds what the parameter undoes.

    Up to a size of .1; a larger one throws all over.
    """

    effects = ()

    def __init__(self, noise: np.ndarray, missing: np.ndarray, undone: np.ndarray, count: int) -> None:
        self.noise, self.missing, self.undone = noise, missing, undone
        self.thrown = 30 * np.random.default_rng(5).normal(size=noise.shape)
        self.low, self.high = np.zeros(count), np.ones(count)

    def residuals(self, xi, windows, horizons, force=None):
        parts = np.hstack([xi[:, :1], xi[:, 1:] / RIGHT, np.zeros((len(xi), 1))])[:, :2]
        linear = [self.noise + (1 - x) * self.missing + (x - p) * self.undone for p, x in parts]
        return np.stack(
            [r + (self.thrown if x > 0.1 / RIGHT else 0.0) for r, x in zip(linear, parts[:, 1], strict=True)]
        )


def yielding():
    """A base whose parameter stands at its bound, as if the effect were not there, and its replays without and with."""
    rng = np.random.default_rng(7)
    noise, missing, undone = rng.normal(size=(3, 60, 1, 2)) * np.array([0.1, 1.0, 4.0])[:, None, None, None]
    alone, both = (Yielding(noise, missing, undone, count) for count in (1, 2))
    fitter, scatter = Fitter(ANYTHING, (1, 2)), learn_scatter(missing, 0, 1e-6 * np.ones((1, 2)))
    return fitter, fitter.linearise(fitter.start(alone, np.zeros((1, 1)), scatter)), both


def test_parameters_make_up_for_what_an_effect_changes_as_far_as_slopes_foretell():
    """As it is, it adds four times what it takes away; with the parameter where it belongs, it leaves noise alone."""
    fitter, base, both = yielding()
    size = 0.9 * RIGHT
    grid = np.stack([np.linspace(0, 1, 1001), np.full(1001, size)], axis=1)
    costs = fitter.costs(both, grid, base.scatter)
    assert costs[0] > base.cost > costs.min()
    xi = np.array([[0.0, size]])
    foretold = fitter.foretold(both, xi, both.residuals(xi, ANYTHING, ANYTHING), base, base.scatter)
    # one step, with weights of where it began: within a hundredth of what there is to gain
    assert foretold[0] == pytest.approx(costs.min(), abs=0.01 * (base.cost - costs.min()))


@pytest.mark.parametrize("yields", [True, False])
def test_an_effect_whose_part_a_parameter_has_played_ranks_where_contacts_are(yields, monkeypatch):
    """Screened at a size that throws all over, it is found by a smaller one; by none if the parameter held still."""
    fitter, base, both = yielding()
    if not yields:
        monkeypatch.setattr(Fitter, "_react", lambda self, u, residuals, base, scatter: math.inf)
    what, other = (effect("coulomb_friction", t, torque=(0.0, 1.0)) for t in ("elbow", "shoulder"))
    slight = Yielding(both.noise + 0.9 * both.missing, 0.1 * RIGHT * both.missing, 0 * both.undone, 2)
    slight.thrown = np.zeros_like(slight.thrown)
    replays = {"elbow": both, "shoulder": slight}
    tried = [(e, np.array([[0.5]])) for e in (other, what)]
    with_effect: Any = lambda e: replays[e.place]  # noqa: E731
    found = screen(fitter, base, tried, with_effect, touches=True)
    assert (found[0].effect is what) is yields


class Pressing(Replay):
    """Residuals that an effect changes in proportion where it is positive, and not at all where it is negative."""

    effects = ()

    def __init__(self, start: np.ndarray, change: np.ndarray) -> None:
        self.start, self.change = start, change
        self.low, self.high = -np.ones(1), np.ones(1)

    def residuals(self, xi, windows, horizons, force=None):
        return np.stack([self.start + max(x, 0.0) * self.change for (x,) in xi])


@pytest.mark.parametrize("touches", [False, True])
def test_what_slopes_foretell_counts_beside_contacts_as_far_as_it_comes_true(touches):
    """What presses makes all worse, and a line through it says that lifting makes all good: it changes nothing.

    Another effect takes a fifth of what there is away, and slopes know it.
    """
    start = 5.0 * np.random.default_rng(8).normal(size=(60, 1, 2))
    scatter = learn_scatter(start, 0, 1e-6 * np.ones((1, 2)))
    presses, helps = (effect("joint_offset", t, offset=(-1.0, 1.0)) for t in ("elbow", "shoulder"))
    replays = {"elbow": Pressing(start, 4.0 * start), "shoulder": Slipping(start, 0.5, start)}
    base: Any = SimpleNamespace(
        replay=Line(), xi=np.zeros(0), scatter=scatter, residuals=start, slopes=np.zeros((0, *start.shape))
    )
    tried = [(e, np.array([[0.1]])) for e in (presses, helps)]
    with_effect: Any = lambda e: replays[e.place]  # noqa: E731
    first, second = screen(Fitter(ANYTHING, (1, 2)), base, tried, with_effect, touches=touches)
    assert first.effect is (helps if touches else presses)
    if touches:
        assert second.share <= 0


def test_what_slopes_foretell_is_tried():
    """Of three forces each one alone explains a third; together, as slopes foretell, they explain all."""
    rng = np.random.default_rng(9)
    parts = rng.normal(size=(3, 60, 1, 2))
    start = parts.sum(0)
    scatter = learn_scatter(start, 0, 1e-6 * np.ones((1, 2)))
    push = effect("external_force", "link", **{f"force_{axis}": (-4.0, 4.0) for axis in "xyz"})

    class Pushed(Replay):
        effects = ()

        def __init__(self) -> None:
            self.low, self.high = -4.0 * np.ones(3), 4.0 * np.ones(3)

        def residuals(self, xi, windows, horizons, force=None):
            return start - np.tensordot(xi, parts, 1)

    base: Any = SimpleNamespace(
        replay=Line(), xi=np.zeros(0), scatter=scatter, residuals=start, slopes=np.zeros((0, *start.shape))
    )
    with_effect: Any = lambda e: Pushed()  # noqa: E731
    found = screen(Fitter(ANYTHING, (1, 2)), base, [(push, np.eye(3))], with_effect, touches=True)[0]
    np.testing.assert_allclose(found.starts[0][1][-1], np.ones(3), atol=1e-6)
