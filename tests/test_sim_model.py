"""Loading models."""

import mujoco
import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadModel
from nfpde.sim import MujocoSimulator, load_model, model_hash
from tests.models import BLOCK, DOUBLE_PENDULUM, FREE_BOX, PENDULUM, load, make_windows, plain_rollout

URDF = """
<robot name="arm">
  <link name="base"/>
  <link name="rod"><inertial><origin xyz="0 0 -0.5"/><mass value="1.5"/>
    <inertia ixx="0.04" iyy="0.05" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
</robot>
"""


@pytest.mark.parametrize("content", [PENDULUM, URDF])
def test_files(tmp_path, content):
    """MJCF and URDF, by path or by name."""
    path = tmp_path / ("m.urdf" if content is URDF else "m.xml")
    path.write_text(content)
    assert load_model(path).nq == load_model(str(path)).nq == 1
    assert load_model(path).body("rod").mass[0] == 1.5


def test_missing_and_broken_files(tmp_path):
    """The path, and MuJoCo's own message."""
    with pytest.raises(BadModel, match=r"none\.xml: no such file"):
        load_model(tmp_path / "none.xml")
    (tmp_path / "b.xml").write_text(PENDULUM.replace('joint="hinge"', 'joint="hing"'))
    with pytest.raises(BadModel, match=r"b\.xml: MuJoCo cannot compile it: .*hing") as caught:
        load_model(tmp_path / "b.xml")
    assert "\n" not in str(caught.value)


def test_compiling_writes_nothing(tmp_path, monkeypatch, capfd):
    """A model that MuJoCo warns of loads without a line on the console or a log file; the log works as before after."""
    monkeypatch.chdir(tmp_path)
    outdated = PENDULUM.replace("<worldbody>", '<compiler settotalmass="3"/><worldbody>')
    (tmp_path / "m.xml").write_text(outdated)
    assert load_model("m.xml").body_mass.sum() == pytest.approx(3)
    (tmp_path / "b.xml").write_text(outdated.replace('joint="hinge"', 'joint="hing"'))
    with pytest.raises(BadModel, match="hing"):
        load_model("b.xml")
    assert capfd.readouterr() == ("", "")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.xml", "m.xml"]
    mujoco.MjModel.from_xml_path("m.xml")
    assert "settotalmass" in "".join(capfd.readouterr())


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('<motor name="motor"', '<general name="motor" dyntype="filter" dynprm="0.1"', "it has 1 actuator states"),
        (
            'gear="2"',
            'gear="2" delay="0.01" nsample="4"',
            "elements with a delay, whose buffers recordings do not hold",
        ),
        ('damping="0.1"', 'stiffness="1" springyield="0.1"', "springs that yield"),
        ('timestep="0.002"/>', 'timestep="0.002"><flag sleep="enable"/></option>', "set <flag sleep='disable'/>"),
        ('<joint name="hinge" axis="0 1 0" damping="0.1"/>', "", r"nothing moves in it \(no joint\)"),
    ],
)
def test_states_that_recordings_lack_are_refused(old, new, text):
    """Positions, velocities and commands have to determine what comes next."""
    assert old in PENDULUM
    xml = PENDULUM.replace(old, new)
    if "joint" in old:
        xml = xml.replace('<motor name="motor" joint="hinge" gear="2"/>', "")
    with pytest.raises(BadModel, match=text):
        load_model(load(xml))


def test_loading_twice_changes_nothing():
    """A loaded model is a fixed point, and its hash tells it from another."""
    once = load_model(load(DOUBLE_PENDULUM))
    assert model_hash(once) == model_hash(load_model(once)) == model_hash(load_model(load(DOUBLE_PENDULUM)))
    other = load_model(load(DOUBLE_PENDULUM.replace('mass="0.7"', 'mass="0.7000001"')))
    assert model_hash(other) != model_hash(once)


@pytest.mark.parametrize("xml", [DOUBLE_PENDULUM, BLOCK, FREE_BOX])
def test_loading_keeps_the_physics(xml):
    """Without islands, and with recomputed constants, one tree moves as the raw model does."""
    raw, loaded = load(xml), load_model(load(xml))
    assert not raw.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ISLAND
    assert loaded.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ISLAND
    windows = make_windows(raw, 3, 50, spread=0.05)
    for n in range(3):
        a, b = (plain_rollout(m, windows.start[n], windows.ctrl[n], 1) for m in (raw, loaded))
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


def test_no_contacts_are_looked_for_where_none_can_be():
    """Masks that let nothing collide: the same numbers to the bit, in less time. One pair is enough to look."""
    contact = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    ghost = BLOCK.replace("<worldbody>", '<default><geom contype="0" conaffinity="0"/></default><worldbody>')
    block, alone = load_model(load(BLOCK)), load_model(load(ghost))
    assert not block.opt.disableflags & contact
    assert alone.opt.disableflags & contact
    looking = load_model(load(ghost))
    looking.opt.disableflags &= ~contact
    windows = make_windows(alone, 3, 50, spread=0.05)
    for n in range(3):
        a, b = (plain_rollout(m, windows.start[n], windows.ctrl[n], 1) for m in (alone, looking))
        np.testing.assert_array_equal(a, b)
    pair = '<contact><pair geom1="floor" geom2="box"/></contact></mujoco>'
    assert not load_model(load(ghost.replace("</mujoco>", pair))).opt.disableflags & contact
    one_sided = ghost.replace('conaffinity="0"', 'conaffinity="1"')
    assert load_model(load(one_sided)).opt.disableflags & contact


CENTRED = """
<mujoco><worldbody><body name="drone" pos="0 0 1"><freejoint/><geom type="box" size=".1 .2 .05" mass="1"/></body>
</worldbody></mujoco>
"""


def test_a_file_leaves_every_centre_of_mass_free_to_move(tmp_path):
    """MuJoCo compiles a free body that balances at its origin in a shorter way; the numbers are the same."""
    path = tmp_path / "drone.xml"
    path.write_text(CENTRED)
    raw, loaded = load(CENTRED), load_model(path)
    assert raw.body_simple[1] == 1
    assert not loaded.body_simple.any()
    windows = make_windows(raw, 3, 50)
    for n in range(3):
        a, b = (plain_rollout(m, windows.start[n], windows.ctrl[n], 1) for m in (raw, loaded))
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


def test_a_load_beside_the_origin_of_a_free_body(tmp_path):
    """It turns the body as MuJoCo's own model with the load welded to it does."""
    path = tmp_path / "drone.xml"
    path.write_text(CENTRED)
    load_at = {f"position_{axis}": (-0.3, 0.3) for axis in "xyz"}
    sim = MujocoSimulator(path, None, [effect("payload", "drone", mass=(0, 1), **load_at)])
    welded = CENTRED.replace("</body>", '<geom type="sphere" size="1e-4" pos=".1 .05 -.05" mass=".2"/></body>')
    windows = make_windows(sim.model, 3, 50)
    found = sim.predict([[0.2, 0.1, 0.05, -0.05]], windows)[0]
    for n in range(3):
        expected = plain_rollout(load(welded), windows.start[n], windows.ctrl[n], 1)
        np.testing.assert_allclose(found[n], expected, atol=1e-6)
