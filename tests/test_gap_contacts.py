"""The diagnosis beside contacts, where small changes make jumps."""

from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import effect
from nfpde.gap.chart import Chart
from nfpde.gap.fit import Fitter
from nfpde.gap.gather import Gathering, spread
from nfpde.gap.noise import floor_of, learn_scatter
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.search import search, search_about, search_all
from nfpde.gap.sensors import sensor_noise
from nfpde.parameters import Parameter, ParameterSpace

ANYTHING: Any = None

BALL = """
<mujoco><option timestep="0.002"/>
<worldbody>
  <geom name="floor" type="plane" size="5 5 .1" solref="0.02 0.3"/>
  <body name="ball" pos="0 0 .1"><joint name="up" type="slide" axis="0 0 1"/>
    <geom type="sphere" size=".1" mass="1" solref="0.02 0.3"/></body>
</worldbody></mujoco>
"""


def drops(height=0.0, noise=(0.0, 0.0), fall=0.4, rows=200, seed=0, xml=BALL):
    """Recordings of a ball that falls on a floor at a height, and bounces."""
    rng = np.random.default_rng(seed)
    out = []
    for number in range(4):
        model = mujoco.MjModel.from_xml_string(xml.replace('type="plane"', f'type="plane" pos="0 0 {height}"'))
        data = mujoco.MjData(model)
        data.qpos[0] = height + fall * rng.uniform()
        qpos, qvel = np.empty((rows, 1)), np.empty((rows, 1))
        for row in range(rows):
            qpos[row], qvel[row] = data.qpos, data.qvel
            mujoco.mj_step(model, data, 5)
        qpos += noise[0] * rng.normal(size=qpos.shape)
        qvel += noise[1] * rng.normal(size=qvel.shape)
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, np.zeros((rows, 0))))
    return Dataset(out)


BLOCK = """
<mujoco><option timestep="0.002" cone="elliptic"/><default><geom friction=".5"/></default>
<worldbody>
  <geom name="floor" type="plane" size="5 5 .1"/>
  <body name="block" pos="0 0 .1"><joint name="along" type="slide" axis="1 0 0"/>
    <joint name="up" type="slide" axis="0 0 1"/><geom type="box" size=".1 .1 .1" mass="1"/></body>
</worldbody>
<actuator><motor joint="along"/></actuator></mujoco>
"""


def pushes(friction, rows=200, seed=0):
    """Recordings of a block that is pushed to and fro on a floor with a sliding coefficient."""
    rng = np.random.default_rng(seed)
    out = []
    for number in range(4):
        model = mujoco.MjModel.from_xml_string(BLOCK.replace('friction=".5"', f'friction="{friction}"'))
        data = mujoco.MjData(model)
        ctrl = 6 * np.sin(2 * np.pi * rng.uniform(0.5, 1.5) * 0.01 * np.arange(rows))[:, None] + rng.normal(0, 2)
        qpos, qvel = np.empty((rows, 2)), np.empty((rows, 2))
        for row in range(rows):
            qpos[row], qvel[row] = data.qpos, data.qvel
            data.ctrl[:] = ctrl[row]
            mujoco.mj_step(model, data, 5)
        qpos += 1e-4 * rng.normal(size=qpos.shape)
        qvel += 1e-3 * rng.normal(size=qvel.shape)
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, ctrl))
    return Dataset(out)


def prepared(data, replay, start):
    """Fitter and scatter of recordings, at free parameters to start from (1, D)."""
    cut = cut_recordings(data, 0, 0, 160)
    before = replay.residuals(start, cut.fit, cut.horizons)[0]
    return Fitter(cut.fit, cut.horizons), learn_scatter(before, 0, floor_of(before, np.ones_like(before))), before


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("height", [0.03, -0.03])
def test_search_crosses_where_slopes_mislead(height, seed):
    """A floor 30 mm off is found from guesses of a few, whatever the draw, to within half a millimetre."""
    replay = Replay(mujoco.MjModel.from_xml_string(BALL), None, [effect("ground_height", height=(-0.1, 0.1))])
    data = drops(height=height, noise=(1e-4, 1e-3), seed=seed)
    fitter, scatter, before = prepared(data, replay, np.zeros((1, 1)))
    found = search(fitter, replay, 0, np.array([[0.003], [-0.003]]), scatter, seed)
    assert found.xi[0] == pytest.approx(height, abs=5e-4)
    assert spread(found.residuals, scatter.floor) < spread(before, scatter.floor)


@pytest.mark.parametrize("seed", range(3))
def test_search_finds_how_slippery_a_floor_is(seed):
    """A coefficient two and a half times too large is corrected to within 5 %, whatever the draw."""
    replay = Replay(mujoco.MjModel.from_xml_string(BLOCK), None, [effect("ground_friction", sliding=(0.05, 3.0))])
    fitter, scatter, _ = prepared(pushes(0.2, seed=seed), replay, np.array([[0.5]]))
    found = search(fitter, replay, 0, np.array([[0.5]]), scatter, seed)
    assert found.xi[0] == pytest.approx(0.2, rel=0.05)


def test_samples_gather_where_least_squares_end():
    """On residuals that are linear in two parameters the samples end at their least squares."""
    rng = np.random.default_rng(0)
    matrix, truth = rng.normal(size=(400, 2)), np.array([0.3, 0.8])
    target = matrix @ truth

    class Line(Replay):
        effects = ()
        low, high = np.zeros(2), np.ones(2)

        def __init__(self):
            pass

        def residuals(self, xi, windows, horizons, force=None):
            return (np.atleast_2d(xi) @ matrix.T - target).reshape(len(xi), 100, 1, 4)

    fitter, line = Fitter(ANYTHING, (1, 2)), Line()
    floor = np.full((1, 4), 1e-3)
    near = fitter.start(line, truth[None] + 0.02, learn_scatter(rng.normal(size=(100, 1, 4)), 0, floor))
    gathering = Gathering(fitter, line, Chart(line), floor, near.xi, np.arange(2))
    gathering.rounds(3, np.full(2, 0.04), np.random.default_rng(0))
    assert gathering.best == pytest.approx(truth, abs=1e-4)


def test_coordinates_of_free_parameters():
    """There and back again; a sign is kept, a factor is a step, a quarter of other bounds is one."""
    space = ParameterSpace([Parameter("body_mass", "ball", 0.5, 2.5)])
    effects = [effect("ground_height", height=(-0.1, 0.1)), effect("ground_friction", sliding=(0.05, 3.0))]
    chart = Chart(Replay(mujoco.MjModel.from_xml_string(BALL), space, effects))
    xi = np.array([[0.5, -0.1, 0.05], [1.0, -0.002, 0.3], [1.5, 0.0, 0.3 * np.e], [2.5, 0.1, 3.0]])
    at = chart.inward(xi)
    assert chart.outward(at) == pytest.approx(xi, rel=1e-12)
    assert at[:, 0] == pytest.approx([0, 1, 2, 4])
    assert (np.sign(at[:, 1]) == [-1, -1, 0, 1]).all()
    assert at[2, 2] - at[1, 2] == pytest.approx(1)


def test_spread_is_the_likelihood_of_independent_channels():
    """Twice the residuals cost log 2 for each of their numbers, and a lost window costs what a very bad one does."""
    r = np.random.default_rng(1).normal(size=(50, 2, 4))
    assert spread(2 * r, np.zeros((2, 4))) - spread(r, np.zeros((2, 4))) == pytest.approx(400 * np.log(2))
    lost, worst = r.copy(), r.copy()
    lost[0], worst[0] = np.nan, 1e6
    assert spread(lost, np.zeros((2, 4))) == spread(worst, np.zeros((2, 4)))


@pytest.mark.parametrize(("fall", "factor"), [(0.0, 2.0), (0.4, 1.25)])
def test_noise_of_sensors_beside_contacts(fall, factor):
    """Noise comes back where a ball bounces; at rest, where a contact's answer to it is not linear, its size does."""
    noise = (1e-4, 2e-3)
    data = drops(noise=noise, fall=fall)
    replay = Replay(mujoco.MjModel.from_xml_string(BALL), None, [])
    ratio = sensor_noise(replay, np.zeros(0), data.windows(1)) / noise
    assert np.abs(np.log(ratio)).max() < np.log(factor)


@pytest.mark.parametrize("seed", range(6))
def test_parameters_are_searched_where_slopes_mislead(seed):
    """Damping and stiffness of a ball on a spring that bounces are found from the far corner of their bounds."""
    spring = BALL.replace('axis="0 0 1"', 'axis="0 0 1" stiffness="20" springref="0.1" damping="1"')
    truth = spring.replace('damping="1"', 'damping="2"').replace('stiffness="20"', 'stiffness="30"')
    space = ParameterSpace([Parameter("dof_damping", "up", 0.2, 8.0), Parameter("jnt_stiffness", "up", 10.0, 60.0)])
    replay = Replay(mujoco.MjModel.from_xml_string(spring), space, [])
    corner = np.array([[7.9, 59.0]])
    fitter, scatter, _ = prepared(drops(noise=(1e-4, 1e-3), xml=truth), replay, corner)
    found = search_all(fitter, fitter.start(replay, corner, scatter), seed)
    assert found.xi == pytest.approx([2.0, 30.0], rel=0.1)  # near enough for slopes to go on


@pytest.mark.parametrize("seed", range(3))
def test_samples_evolve_to_a_place_among_ripples(seed):
    """Two values under ripples that turn every slope: the best samples lie in the right hollow, on either side."""
    truth, rng = np.array([0.02, 0.6]), np.random.default_rng(1)
    weights = rng.normal(size=(2, 400))

    class Rippled(Replay):
        effects = (effect("ground_height", height=(-0.1, 0.1)), effect("ground_friction", sliding=(0.05, 3.0)))
        low, high, nbase = np.array([-0.1, 0.05]), np.array([0.1, 3.0]), 0
        near = np.full(2, np.nan)

        def __init__(self):
            pass

        def residuals(self, xi, windows, horizons, force=None):
            away = (np.atleast_2d(xi) - truth) / [0.01, 0.3]
            ripples = 0.3 * np.sin(25 * away) + away
            return (ripples @ weights).reshape(len(away), 100, 1, 4)

    floor = np.full((1, 4), 1e-3)
    fitter, replay = Fitter(ANYTHING, (1, 2)), Rippled()
    guess = fitter.start(replay, np.array([[0.005, 1.5]]), learn_scatter(weights.T.reshape(-1, 1, 4), 0, floor))
    found = search_about(fitter, guess, 0.5, seed)
    before = np.abs(guess.xi - truth)
    assert (np.abs(found[0] - truth) < 0.3 * before).all()
