"""Where fits start, and coordinates in which effects are straight."""

from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.gap.fit import Fitter
from nfpde.gap.noise import learn_scatter
from nfpde.gap.replay import Replay
from nfpde.parameters import Parameter, ParameterSpace

ANYTHING: Any = None
FITTER = Fitter(ANYTHING, (1, 2))

ARM = """
<mujoco><worldbody><body name="link"><joint name="hinge" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 .3 0 .1" size=".02" mass="1"/></body></worldbody></mujoco>
"""


class Line(Replay):
    """A replay whose residuals are `start` and `slopes` times its parameters."""

    effects = ()

    def __init__(self, start, slopes, low, high):
        self.start, self.slopes, self.low, self.high = start, np.array(slopes), np.array(low), np.array(high)

    def residuals(self, xi, windows, horizons, force=None):
        return self.start + np.einsum("md,dnvc->mnvc", xi, self.slopes)


def test_parameters_give_back_what_they_stood_in_for():
    """The guess nearest to the truth is worse than none until the base's parameter returns; it is chosen all the same.

    Effect and parameter do the same but for a tenth: with the effect missing, the parameter is bent by all of it.
    """
    rng = np.random.default_rng(3)
    common, apart = rng.normal(size=(2, 80, 2, 4))
    slopes, truth = np.array([common, common + 0.1 * apart]), np.array([0.3, 0.2])
    target = -np.einsum("d,dnvc->nvc", truth, slopes) + 1e-4 * rng.normal(size=common.shape)
    base = Line(target, slopes[:1], [0.0], [1.0])
    both = Line(target, slopes, [0.0, 0.0], [1.0, 1.0])
    scatter = learn_scatter(0.01 * rng.normal(size=(400, 2, 4)), 0, 1e-5 * np.ones((2, 4)))
    fit = FITTER.linearise(FITTER.improve(FITTER.start(base, np.array([[0.4]]), scatter), 10))
    assert fit.xi[0] == pytest.approx(0.5, abs=0.02)
    guesses = np.array([[fit.xi[0], v] for v in (0.0, 0.2, 0.4)])
    plain = FITTER.best(both, guesses, scatter, 1)
    assert plain[0, 1] == 0.0
    reacted = FITTER.best(both, guesses, scatter, 1, fit)
    assert reacted[0] == pytest.approx(truth, abs=0.01)
    assert reacted[1:] == pytest.approx(plain)


class Counting(Line):
    """A line whose windows are numbers, and that counts what is asked of it."""

    asked = 0

    def residuals(self, xi, windows, horizons, force=None):
        self.asked += len(xi) * len(windows)
        return super().residuals(xi, windows, horizons, force)[:, windows]


@pytest.mark.parametrize(("count", "guesses", "part"), [(400, 200, True), (400, 40, False), (30, 200, False)])
@pytest.mark.parametrize("yields", [False, True])
def test_many_guesses_are_compared_on_a_part_of_many_windows_first(count, guesses, part, yields):
    """Those that are best of all are found by less than half of the work, and the order is that of all windows."""
    rng = np.random.default_rng(5)
    slopes, truth = rng.normal(size=(2, count, 2, 4)), np.array([0.3, 0.2])
    target = -np.einsum("d,dnvc->nvc", truth, slopes) + 0.05 * rng.normal(size=(count, 2, 4))
    both = Counting(target, slopes, [0.0, 0.0], [1.0, 1.0])
    scatter = learn_scatter(0.05 * rng.normal(size=(400, 2, 4)), 0, 1e-5 * np.ones((2, 4)))
    numbers: Any = np.arange(count)
    fitter = Fitter(numbers, (1, 2))
    base = None
    if yields:
        alone = Counting(target, slopes[:1], [0.0], [1.0])
        base = fitter.linearise(fitter.improve(fitter.start(alone, np.array([[0.4]]), scatter), 10))
    xi = np.column_stack([np.full(guesses, 0.3), rng.permutation(np.linspace(0, 1, guesses))])
    found, work = fitter.best(both, xi, scatter, 3, base), both.asked
    stay = xi[np.argsort(fitter.costs(both, xi, scatter))[:3]]
    assert found[-3:] == pytest.approx(stay)
    if yields:
        # the base's parameter at its best beside each value: costs are a parabola about the truth
        nearest = np.argsort(np.abs(xi[:, 1] - 0.2))[:3]
        error = 0.05 / np.sqrt(target.size)  # of a value that slopes of size one tell
        assert sorted(found[:3, 1]) == pytest.approx(sorted(xi[nearest, 1]), abs=4 * error)
    assert (work < 0.5 * guesses * count) is part


PLACES = {f"position_{a}": (-0.4, 0.6) for a in "xyz"}


@pytest.fixture
def loaded():
    """A link with a free mass and a load somewhere."""
    space = ParameterSpace([Parameter("body_mass", "link", 0.5, 2.0, scale_inertia=False)])
    return Replay(mujoco.MjModel.from_xml_string(ARM), space, [effect("payload", "link", mass=(0, 3), **PLACES)])


def test_coordinates_of_a_load_lead_back(loaded):
    """Shares of the bounds and back, at bounds and inside; a load of no mass is in the middle."""
    xi = np.array([[0.5, 3.0, -0.4, 0.6, 0.1], [2.0, 1e-6, 0.2, 0.1, -0.3], [1.0, 0.7, 0.5, -0.1, 0.0]])
    u = loaded.inward(xi)
    assert ((u >= 0) & (u <= 1)).all()
    assert loaded.outward(u) == pytest.approx(xi, rel=1e-9, abs=1e-9)
    assert loaded.outward(loaded.inward(np.array([1.0, 0.0, 0.5, 0.5, 0.5]))) == pytest.approx([1, 0, 0.1, 0.1, 0.1])


def test_a_moment_beyond_reach_is_brought_to_the_bound(loaded):
    """A light load cannot have a large first moment: its place is the bound, every other value stays."""
    u = loaded.inward(np.array([1.0, 0.01, 0.1, 0.1, 0.1]))
    assert loaded.outward(u + np.array([0, 0, 0.2, 0, 0])) == pytest.approx([1.0, 0.01, 0.6, 0.1, 0.1])


def test_slopes_of_a_loads_coordinates(loaded):
    """Position is the moment over the mass: the derivatives are those of a quotient."""
    mass, arm = 0.7, np.array([0.4, -0.2, -0.1])
    slopes = loaded.outward_slopes(np.array([1.0, mass, *(0.1 + arm)]))
    expected = np.zeros((5, 5))
    expected[0, 0], expected[1, 1] = 1.5, 3.0
    expected[2:, 1] = -3.0 * arm / mass
    expected[2:, 2:] = np.eye(3) * 2 * 3.0 * 0.5 / mass
    assert slopes == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_loads_together_have_their_mass_and_centre():
    """One load in place of two and a half: mass and centre of mass of the link are those with all of them."""
    load = effect("payload", "link", mass=(0, 3), **PLACES)
    values, shares = np.array([[0.2, 0.5, 0.0, 0.1], [0.3, -0.1, 0.4, 0.2]]), np.array([1.0, 0.5])

    def carrying(*loads):
        model = mujoco.MjModel.from_xml_string(ARM)
        for values in loads:
            load.bind(model).write_model(model, np.array(values))
        return model.body_mass[1], model.body_ipos[1]

    mass, centre = carrying(load.together(values, shares))
    expected_mass, expected_centre = carrying(values[0], [0.15, *values[1, 1:]])
    assert mass == pytest.approx(expected_mass)
    assert centre == pytest.approx(expected_centre)


def test_coordinates_of_a_spring_are_those_its_torque_is_linear_in():
    """There and back again, and the sum of two springs in one: the same torque everywhere."""
    spring = effect("joint_spring", "hinge", stiffness=(0.0, 10.0), rest=(-2.0, 1.0))
    values = np.array([[3.0, -1.2], [0.5, 0.9], [10.0, -2.0]])
    assert spring.bent(spring.straightened(values)) == pytest.approx(values)
    low, high = spring.straight_bounds()
    assert ((spring.straightened(values) >= low) & (spring.straightened(values) <= high)).all()
    shares, q = np.array([0.5, 1.0, 0.2]), np.linspace(-2, 2, 9)
    stiffness, rest = spring.together(values, shares)
    expected = (shares * values[:, 0]) @ (values[:, 1:] - q)
    assert stiffness * (rest - q) == pytest.approx(expected)
    assert spring.bent(np.array([0.0, 0.0])) == pytest.approx([0.0, -0.5])  # no spring rests in the middle
