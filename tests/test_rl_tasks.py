"""The pendulum task, the short names, and their refusals."""

import gymnasium
import mujoco
import numpy as np
import pytest

from nfpde.benchmarks import collect, robot
from nfpde.benchmarks.pendulum import PAYLOAD_XML, PENDULUM_XML
from nfpde.errors import BadInput, BadModel
from nfpde.rl import TASKS, evaluate_policy, make_environment, tasks
from nfpde.sim import MujocoSimulator


@pytest.mark.parametrize(("name", "identifier"), TASKS.items())
def test_short_names(name, identifier, tmp_path, monkeypatch, capfd):
    """Every short name makes its environment, without a line of MuJoCo's about the model's file."""
    monkeypatch.chdir(tmp_path)
    env = make_environment(name)
    assert env.spec is not None
    assert env.spec.id == identifier
    env.close()
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore:.*Box (action|observation) space:UserWarning")
@pytest.mark.parametrize("name", ["Pendulum", "Payload"])
def test_pendulums_follow_gymnasiums_rules(name):
    """Gymnasium's own checker finds no fault in the task."""
    from gymnasium.utils.env_checker import check_env

    check_env(gymnasium.make(f"nfpde/{name}-v0").unwrapped, skip_render_check=True)


@pytest.mark.parametrize("path", [PENDULUM_XML, PAYLOAD_XML], ids=lambda path: path.stem)
def test_pendulums_must_pump(path):
    """The motor cannot hold the pendulum level: its largest torque is below half of gravity's."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[0] = np.pi / 2
    mujoco.mj_forward(model, data)
    gravity = abs(data.qfrc_bias[0])
    assert 0.2 * gravity < model.actuator_ctrlrange[0, 1] < 0.5 * gravity


def test_nothing_tells_a_hand_from_its_payload():
    """What one loses in mass and the other gains moves nothing; more of both does."""
    body = robot("payload")
    windows = collect(body, "gaussian", episodes=1, steps=20)[0].transitions()
    xi = np.array([[0.3, 0.3, 0.02], [0.2, 0.4, 0.02], [0.3, 0.4, 0.02]])
    ends = MujocoSimulator(body.path, body.space).predict(xi, windows)
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-9, atol=1e-12)
    assert np.abs(ends[2] - ends[0]).max() > 1e-3


def test_pendulum_reward_and_observation():
    """At rest upright a step earns 1, hanging 0; the observation is cosine, sine from upright and velocity."""
    env = make_environment("pendulum")
    env.reset(seed=0)
    bare = env.unwrapped
    for angle, reward in ((np.pi, 1.0), (0.0, 0.0)):
        bare.set_state(np.array([angle]), np.zeros(1))  # type: ignore[attr-defined]
        observation, got, terminated, _, _ = env.step(np.zeros(1, np.float32))
        assert got == pytest.approx(reward, abs=1e-12)
        np.testing.assert_allclose(observation, [np.cos(angle - np.pi), np.sin(angle - np.pi), 0], atol=1e-12)
        assert not terminated


def test_pendulum_can_be_solved():
    """Pumping energy up to that of standing upright, and a linear regulator at the top, earn most of an episode."""
    from nfpde.parameters import Parameter, ParameterSpace

    def regulator(o):
        energy = 0.5 * 0.16 * o[2] ** 2 + 3.2 * (o[0] - 1)  # [J], of moment of inertia and weight; 0 upright at rest
        pump, hold = -5 * energy * o[2], -12 * np.arctan2(o[1], o[0]) - 2 * o[2]
        return np.array([np.clip(hold if o[0] > 0.85 else pump, -1.5, 1.5)])

    space = ParameterSpace([Parameter("body_mass", "pendulum", 0.4, 1.6)])
    assert evaluate_policy(regulator, "pendulum", [0.7], space=space).mean > 100


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("flying_carpet",), "'flying_carpet': .*Known short names: pendulum, payload, hopper"),
        (("no_such_module:Robot-v0",), "no_such_module.*module:Id-v0"),
        (("a:b:c",), "'a:b:c': give a Gymnasium id, or MODULE:Id-v0 with one colon"),
        ((":Hopper-v5",), "':Hopper-v5': give a Gymnasium id, or MODULE:Id-v0 with one colon"),
        (("pendulum", "missing.xml"), "missing.xml: no such file"),
        (("CartPole-v1", PENDULUM_XML), "'CartPole-v1' cannot be made with .*xml_file"),
        ((lambda: gymnasium.make("Hopper-v5"), PENDULUM_XML), "goes with the name of an environment"),
        ((lambda: None,), "the function that makes the environment returned a NoneType, no gymnasium.Env"),
        ((gymnasium.make("CartPole-v1"),), "env is a .*; give an environment's name or a function .*: two are needed"),
        ((PENDULUM_XML,), "env is a PosixPath; give an environment's name or a function that makes it"),
    ],
)
def test_unknown_environments_are_refused(arguments, text):
    """A name, module or model that does not exist is refused by message."""
    with pytest.raises(BadInput, match=text):
        make_environment(*arguments)


def test_another_model_file(tmp_path):
    """A model file replaces the environment's own."""
    path = tmp_path / "heavy.xml"
    path.write_text(PENDULUM_XML.read_text().replace('mass="0.6"', 'mass="2"'))
    env = make_environment("pendulum", path)
    assert env.unwrapped.model.body("pendulum").mass[0] == pytest.approx(2.1)  # type: ignore[attr-defined]


@pytest.mark.parametrize("known", [True, False])
def test_a_model_of_another_timestep(tmp_path, monkeypatch, known):
    """Gymnasium wants the rate of the environment's pictures: one line, with the timestep where it can be told."""
    path = tmp_path / "fast.xml"
    own = mujoco.MjModel.from_xml_path(str(PENDULUM_XML)).opt.timestep
    path.write_text(PENDULUM_XML.read_text().replace(f'timestep="{own:g}"', 'timestep="0.002"'))
    said = rf"its timestep is 0\.002 s, and the environment needs {own:g} s \(its render_fps is fixed\); change it"
    if not known:
        monkeypatch.setattr(tasks, "_timesteps", lambda *_: None)
        said = "Expected value: 100, Actual value: 20"
    with pytest.raises(BadModel, match=rf"^\S*fast\.xml: environment 'pendulum' cannot be made with it: {said}$"):
        make_environment("pendulum", path)


def test_a_model_that_cannot_be_compiled(tmp_path):
    """MuJoCo's message, with the file."""
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody><bdy/></worldbody></mujoco>")
    with pytest.raises(BadModel, match=r"broken\.xml: environment 'hopper' cannot be made with it: [^<]*bdy"):
        make_environment("hopper", tmp_path / "broken.xml")
