"""Constants of the model that are derived on the device, on Warp's CPU device or a GPU, against mj_setConst."""

import numpy as np
import pytest

from nfpde.benchmarks import ROBOTS
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim.warp import WarpSimulator
from tests.device import WARP
from tests.models import load, make_windows, record
from tests.test_warp import HOPPER_SUBSTEPS, vectors

TREES = """
<mujoco>
  <worldbody>
    <body name="hull" pos="0 0 1">
      <freejoint/>
      <geom size="0.1 0.2 0.05" type="box" mass="2"/>
      <body name="mast" pos="0 0 0.1"><geom size="0.02 0.1" type="capsule" mass="0.3"/></body>
      <body name="head" pos="0 0.2 0.1">
        <joint name="neck" type="ball"/>
        <geom size="0.05" pos="0 0 0.1" mass="0.4"/>
        <body name="arm" pos="0 0 0.2">
          <joint name="slider" type="slide" axis="1 0 0"/>
          <geom size="0.03 0.1" type="capsule" mass="0.2"/>
        </body>
      </body>
    </body>
    <body name="post" pos="2 0 0"><geom size="0.05 0.3" type="capsule" mass="1"/></body>
    <body name="wheel" pos="3 0 0">
      <joint name="axle" axis="0 1 0" armature="0.01"/>
      <geom size="0.1 0.02" type="cylinder" mass="0.5"/>
    </body>
  </worldbody>
  <tendon><fixed name="belt"><joint joint="slider" coef="0.7"/><joint joint="axle" coef="-1.3"/></fixed></tendon>
  <actuator><motor tendon="belt" gear="2"/><motor joint="neck" gear="1 2 3"/><motor joint="axle"/></actuator>
</mujoco>
"""
"""Every type of joint, two trees, bodies fixed to another and to the world, a tendon, and motors on them."""


def belt(armature):
    """The trees as they are compiled with inertia in their tendon, of that much."""
    model = load(TREES.replace('name="belt"', 'name="belt" armature="1"'))
    model.tendon_armature[:] = armature
    return model


TENDONS = {
    "trees": ([load(TREES)], []),
    "tendon with inertia": ([belt(0.1)], []),
    "tendon that may have inertia": ([load(TREES)], [Parameter("tendon_armature", "belt", 0.0, 0.5)]),
    "tendon with inertia in one of two models": ([belt(0.0), belt(0.1)], [Parameter("model", None, 0.0, 2.0)]),
}
"""By name the models, and parameters beside masses and an armature; with inertia in a tendon the host derives."""


@pytest.mark.parametrize("name", [*ROBOTS, *TENDONS])
def test_constants_of_the_model_follow_the_parameters(name):
    """What depends on masses and inertias is derived in every row as by mj_setConst, on the device where it can be."""
    if name in ROBOTS:
        model, space = ROBOTS[name].model, ROBOTS[name].space
    else:
        model, more = TENDONS[name]
        masses = [Parameter("body_mass", body, 0.5, 2.0, relative=True) for body in ("hull", "mast", "head", "arm")]
        space = ParameterSpace([*masses, Parameter("dof_armature", "axle", 0.005, 0.05), *more])
    sim = WarpSimulator(model, space, device=WARP, check_influence=False)
    xi = vectors(sim, 5)
    windows = make_windows(sim.model, 2, 1)
    sim.losses(xi, windows, np.ones(sim.states.ndiff))
    (batch,) = sim._batches.kept.values()
    expected = sim.reference.writer.rows(xi)
    for field, array in batch._fields.items():
        row = expected[field].reshape(5, -1)
        # single precision through a Cholesky factor: 1e-5 relative; on a GPU there are rows that nobody reads
        np.testing.assert_allclose(array.numpy()[:5], row, rtol=1e-4, atol=1e-6 * np.abs(row).max(), err_msg=field)
    derived = {"body_subtreemass", "body_invweight0", "dof_invweight0", "actuator_acc0"}
    assert derived | ({"tendon_invweight0"} if sim.model.ntendon else set()) <= batch._fields.keys()
    assert batch.derives == ("inertia" not in name)


def test_what_is_derived_reaches_no_other_simulator():
    """A model's arrays are one for all simulators of it: whatever MuJoCo Warp computes anew has arrays of its own."""
    robot = ROBOTS["hopper"]
    sim = WarpSimulator(robot.model, robot.space, device=WARP, check_influence=False)
    windows = record(robot.model, 1, 3, HOPPER_SUBSTEPS).transitions()
    expected = sim.losses(vectors(sim, 2), windows, np.ones(sim.states.ndiff))
    nominal, written = sim._model.nominal, ("body_invweight0", "dof_invweight0", "body_subtreemass")
    before = {name: getattr(nominal, name).numpy() for name in written}
    try:
        for name in written:
            getattr(nominal, name).fill_(np.nan)  # what is written shows, however alike it is
        np.testing.assert_array_equal(sim.losses(vectors(sim, 2), windows, np.ones(sim.states.ndiff)), expected)
        for name in written:
            assert np.isnan(getattr(nominal, name).numpy()).all(), name
    finally:
        for name, values in before.items():
            getattr(nominal, name).assign(values)
