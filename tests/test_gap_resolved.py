"""What contacts do is known over small steps only, whatever a fit took for slopes before."""

from typing import Any

import mujoco
import numpy as np

from nfpde.dataset import Dataset, Episode
from nfpde.effects import effect
from nfpde.gap.certainty import standard_errors
from nfpde.gap.fit import Fitter
from nfpde.gap.noise import floor_of, learn_scatter
from nfpde.gap.replay import Replay
from nfpde.gap.trial import Court
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import load_model

READ = np.array([2e-4, 2e-4, 5e-3, 5e-3])
"""Noise of the sensors [m, rad, m/s, rad/s]."""

HOPPER = """
<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="5 5 .1"/>
  <body pos="0 0 .5"><joint name="up" type="slide" axis="0 0 1"/><geom type="sphere" size=".1" mass="1"/>
    <body pos="0 0 .2"><joint name="arm" axis="0 1 0" damping=".1"/>
      <geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass=".3"/></body></body></worldbody>
<actuator><motor joint="up"/><motor joint="arm"/></actuator></mujoco>
"""


def hops(rows: int = 900) -> Dataset:
    """A ball with an arm that is shaken on a floor."""
    model, rng = mujoco.MjModel.from_xml_string(HOPPER), np.random.default_rng(0)
    data, turn = mujoco.MjData(model), np.arange(rows)
    data.qpos[0] = -0.3
    ctrl = np.column_stack([8 * np.sin(0.11 * turn) + 6 * np.sin(0.37 * turn), 0.5 * np.sin(0.2 * turn)])
    states = np.empty((rows, 4))
    for row in range(rows):
        states[row] = *data.qpos, *data.qvel
        data.ctrl[:] = ctrl[row]
        mujoco.mj_step(model, data, 5)
    states += READ * rng.normal(size=states.shape)
    return Dataset([Episode("0", 0.01 * turn, states[:, :2], states[:, 2:], ctrl)])


def test_a_floor_is_known_better_than_its_height_is_read():
    """Hundreds of rows on it are read to .2 mm each; over 5 mm, a fiftieth of the bounds, it is in the air or is not.

    Its softness and the ball's mass are fitted beside it.
    """
    model, windows = load_model(mujoco.MjModel.from_xml_string(HOPPER)), hops().windows(1, stride=2)
    soft = effect("contact_softness", time_constant=(0.004, 0.3), damping_ratio=(0.05, 4.0)).bind(model)
    effects = [effect("ground_height", height=(-0.12, 0.12)), soft]
    replay = Replay(model, ParameterSpace([Parameter("body_mass", 1, low=0.3, high=3.0, scale_inertia=False)]), effects)
    fitter, other = (Fitter(windows[half::2], (1,)) for half in (0, 1))
    xi = np.array([[1.0, 0.0, 0.02, 1.0]])
    residuals = fitter.residuals_at(replay, xi)[0]
    floor = floor_of(residuals, fitter.moved(replay))
    blocks = np.zeros(len(other.windows), dtype=np.intp)
    encoders: Any = None  # not asked
    court = Court(blocks, fitter, other, floor, xi[0, :1], encoders, 0.02)
    fit = court.settle(fitter.start(replay, xi, learn_scatter(residuals, 1, floor)))
    shown = fitter.start(replay, fit.xi[None], fit.scatter)
    known = standard_errors(court, fitter.resolved(shown))
    assert known[1] < READ[0]
    # the same as where the fit came to, by the slopes that it took on its way
    np.testing.assert_allclose(known, standard_errors(court, fitter.linearise(fit)), rtol=0.05)
    assert standard_errors(court, fitter.linearise(shown))[1] > 100 * READ[0]
