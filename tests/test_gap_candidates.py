"""Effects that are free already are no candidates."""

import mujoco
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import DataScales
from nfpde.gap.diagnose import candidates_beside
from nfpde.gap.replay import Replay
from nfpde.parameters import Parameter, ParameterSpace
from tests.gap_systems import nominal, record

ONE = """
<mujoco><worldbody><body><joint name="elbow" axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 0 0 -.5"/>
</body></worldbody><actuator><motor joint="elbow"/></actuator></mujoco>
"""


def tried(model, target):
    """Where friction is tried beside friction that is free, and the names of all that is tried."""
    space = ParameterSpace([Parameter("coulomb_friction.torque", target, low=0.0, high=1.0)])
    both = record(episodes=1, rows=60)[0]
    qpos, qvel, ctrl = (x[:, : model.nv] for x in (both.qpos, both.qvel, both.ctrl))
    scales = DataScales.of(model, Dataset([Episode("0", both.time, qpos, qvel, ctrl)]))
    found = candidates_beside(model, scales, Replay(model, space, []).sim.effects)
    return [e.place for e, _ in found if e.name == "coulomb_friction"], {e.name for e, _ in found}


@pytest.mark.parametrize("target", ["elbow", 0, "#0", ("elbow",), "*"])
def test_what_is_free_is_no_candidate_however_its_target_is_named(target):
    where, names = tried(mujoco.MjModel.from_xml_string(ONE), target)
    assert where == []
    assert "viscous_damping" in names


@pytest.mark.parametrize(
    ("target", "others"),
    [
        ("*", {"shoulder", "elbow"}),  # one value for both joints leaves each its own
        ("elbow", {"shoulder"}),
        (1, {"shoulder"}),
    ],
)
def test_the_same_elsewhere_is_a_candidate(target, others):
    assert set(tried(nominal(), target)[0]) == others


def test_what_an_effect_takes_from_the_model_may_be_free_without_it():
    """A delay clamps commands to the range that the model has: with that free there is none at this actuator."""
    model = nominal()
    scales = DataScales.of(model, record(episodes=1, rows=60))
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, 0)
    space = ParameterSpace([Parameter("actuator_ctrlrange", name, low=1.0, high=2.0)])
    every, beside = candidates_beside(model, scales, []), candidates_beside(model, scales, [], space)
    gone = {(e.called, e.place) for e, _ in every} - {(e.called, e.place) for e, _ in beside}
    assert {"actuation_delay", "actuator_lag"} <= {called for called, _ in gone}
    assert not {place for _, place in gone} & {"bend", "elbow"}
    assert ("actuation_delay", "bend") in {(e.called, e.place) for e, _ in beside}
