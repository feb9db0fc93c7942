"""The force that is left over: whose commands, positions and units it is shown against."""

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Windows
from nfpde.gap.leftover import Leftover, describe, leftover
from nfpde.gap.noise import learn_scatter
from nfpde.gap.where import Forces

MODEL = """
<mujoco><worldbody>
  <body name="base" pos="0 0 1"><freejoint name="root"/><geom type="box" size=".2 .1 .1"/>
    <body pos=".3 0 0"><joint name="shoulder" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
      <body pos=".3 0 0"><joint name="elbow" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .2 0 0" size=".03"/>
      </body></body></body>
</worldbody>
<tendon><fixed name="belt"><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="1"/></fixed></tendon>
<actuator>
  <motor name="pull" tendon="belt"/>
  <pid name="hold" joint="shoulder" kp="5" kv="1"/>
  <motor name="bend" joint="elbow"/>
</actuator></mujoco>
"""


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(MODEL)


def shown(model, dof, count=6):
    """What is shown of a degree of freedom; commands of 1, 2, 3 ..., the base turned about y by 0.1 a window."""
    qpos = np.tile(model.qpos0, (count, 1))
    for n in range(count):
        turn = np.zeros(model.nv)
        turn[4], turn[2], turn[6:] = 0.1 * n, 0.5 * n, (0.2 * n, -0.3 * n)
        mujoco.mj_integratePos(model, qpos[n], turn, 1.0)
    state = np.tile(np.hstack([qpos, np.tile(np.arange(model.nv), (count, 1))])[:, None], (1, 3, 1))
    ctrl = np.tile(1.0 + np.arange(model.nu), (count, 2, 1))
    windows = Windows(
        state, ctrl, np.empty((count, 0, model.nu)), 0.01, model.nq, model.nv, np.zeros(count, int), np.arange(count)
    )
    nothing = np.zeros((count, model.nv))
    return describe(Leftover(dof, 0.5, Forces(nothing, nothing, nothing, nothing)), model, windows)


def test_commands_are_those_of_the_actuators_on_the_joint(model):
    """One on a tendon is no joint's; one with two commands has the next actuator's stand after both of them."""
    assert (model.nu, int(model.actuator_trntype.shape[0])) == (4, 3)
    commands = {name: shown(model, dof).command for name, dof in (("root", 0), ("shoulder", 6), ("elbow", 7))}
    np.testing.assert_allclose(commands["root"], 0.0)
    np.testing.assert_allclose(commands["shoulder"], (2 + 3) / 2)
    np.testing.assert_allclose(commands["elbow"], 4.0)


@pytest.mark.parametrize(
    ("dof", "joint", "unit", "a_window"),
    [(2, "root", "N", 0.5), (4, "root", "Nm", 0.1), (6, "shoulder", "Nm", 0.2), (7, "elbow", "Nm", -0.3)],
)
def test_positions_and_units(model, dof, joint, unit, a_window):
    """A free joint is pushed in N along its first three axes, and turned in Nm about the others, from qpos0."""
    found = shown(model, dof)
    assert (found.joint, found.unit) == (joint, unit)
    start = 1.0 if dof == 2 else 0.0
    np.testing.assert_allclose(found.position, start + a_window * np.arange(6), atol=1e-12)
    np.testing.assert_allclose(found.speed, dof)


COUNT = 120
SLIDER = """<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0"/><geom size=".1"/></body></worldbody>
</mujoco>"""


def remaining(force, noise, quiet, believed):
    """What is left where windows lack a force (N,) of a slide's position, and noise (N, 1, C) adds to that.

    `quiet` are draws of the noise, `believed` is what the scatter is learned from.
    """
    model = mujoco.MjModel.from_xml_string(SLIDER)
    position = np.linspace(-1, 1, COUNT)
    state = np.tile(np.stack([position, 0 * position], axis=1)[:, None], (1, 3, 1))
    nothing = np.empty((COUNT, 0, 0))
    windows = Windows(state, np.empty((COUNT, 2, 0)), nothing, 0.01, 1, 1, np.zeros(COUNT, int), np.arange(COUNT))
    scatter = learn_scatter(believed, 0, 1e-6 * np.ones(noise.shape[1:]))
    needed = force[:, None] + 0.0
    found = Forces(needed, np.full((COUNT, 1), 0.01), np.ones((1, *noise.shape)), needed**2)
    recordings: Any = SimpleNamespace(fit=windows, held=windows)
    left = noise - force[:, None, None]
    left[7] = np.nan  # it diverged
    return leftover(recordings, found, found, scatter, left, quiet, model).share


def draws(seed, degrees):
    """Noise with tails of Student's t, or none where the degrees are infinite."""
    rng = np.random.default_rng(seed)
    size = np.sqrt(degrees / rng.chisquare(degrees, (4000, 1, 1))) if np.isfinite(degrees) else 1.0
    every = 0.01 * rng.normal(size=(4000, 1, 4)) * size
    return every[:COUNT], every[COUNT:]


@pytest.mark.parametrize("degrees", [3.0, np.inf])
@pytest.mark.parametrize("seed", range(4))
def test_a_force_takes_nothing_away_where_noise_is_all(seed, degrees):
    """Whatever the tails, and however much larger the noise is than the scatter believes it: no share of nothing."""
    noise, quiet = draws(seed, degrees)
    idle = 0.001 * np.sin(np.arange(COUNT))
    for believed in (quiet, 0.5 * quiet, 2.0 * quiet):
        assert remaining(idle, noise, quiet, believed) == 0.0


@pytest.mark.parametrize("believed", [0.5, 1.0, 2.0])
def test_a_force_of_position_takes_away_what_is_beyond_noise(believed):
    """All of it and never more, though the scatter misjudges the noise by a factor of two."""
    noise, quiet = draws(9, np.inf)
    at = np.linspace(-1, 1, COUNT)
    # the force stands 50 times beyond the noise, in squares
    share = remaining(0.1 * np.sign(at) * np.sqrt(np.abs(at)), noise, quiet, believed * quiet)
    assert 0.95 < share <= 1.0
