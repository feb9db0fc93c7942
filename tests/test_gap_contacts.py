"""The diagnosis beside contacts, where small changes make jumps."""

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import effect
from nfpde.gap.fit import Fitter
from nfpde.gap.noise import floor_of, learn_scatter
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.search import search, search_all, spread
from nfpde.gap.sensors import sensor_noise
from nfpde.parameters import Parameter, ParameterSpace

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


def test_search_crosses_where_slopes_mislead():
    """A floor 30 mm higher is found from guesses of a few, to within half a millimetre."""
    cut = cut_recordings(drops(height=0.03, noise=(1e-4, 1e-3)), 0, 0, 160)
    model = mujoco.MjModel.from_xml_string(BALL)
    replay = Replay(model, None, [effect("ground_height", height=(-0.1, 0.1))])
    fitter = Fitter(cut.fit, cut.horizons)
    before = replay.residuals(np.zeros((1, 1)), cut.fit, cut.horizons)[0]
    scatter = learn_scatter(before, 0, floor_of(before, np.ones_like(before)))
    found = search(fitter, replay, 0, np.array([[0.003], [-0.003]]), scatter)
    assert found.xi[0] == pytest.approx(0.03, abs=5e-4)
    assert spread(found.residuals, scatter.floor) < spread(before, scatter.floor)


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


def test_parameters_are_searched_where_slopes_mislead():
    """Mass and stiffness of a ball on a spring that bounces are found from the far corner of their bounds."""
    spring = BALL.replace('axis="0 0 1"', 'axis="0 0 1" stiffness="20" springref="0.1"')
    truth = spring.replace('mass="1"', 'mass="1.3"').replace('stiffness="20"', 'stiffness="30"')
    cut = cut_recordings(drops(noise=(1e-4, 1e-3), xml=truth), 0, 0, 160)
    space = ParameterSpace([Parameter("body_mass", "ball", 0.5, 2.0), Parameter("jnt_stiffness", "up", 10.0, 60.0)])
    replay = Replay(mujoco.MjModel.from_xml_string(spring), space, [])
    fitter = Fitter(cut.fit, cut.horizons)
    before = replay.residuals(np.array([[0.5, 60.0]]), cut.fit, cut.horizons)[0]
    scatter = learn_scatter(before, 0, floor_of(before, np.ones_like(before)))
    found = search_all(fitter, fitter.start(replay, np.array([[0.5, 60.0]]), scatter))
    assert found.xi == pytest.approx([1.3, 30.0], rel=0.1)  # samples of five rounds: near enough for slopes to go on
