"""Effects on what is measured, and when: by hand, recovered from recordings, and neutral."""

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import effect
from nfpde.errors import BadEffect
from nfpde.sim import MujocoSimulator
from tests.models import BALL, DOUBLE_PENDULUM, load, make_windows, plain_rollout, record

CASES = [
    ("joint_offset", "elbow", {"offset": (-1, 1)}, [[0.3], [0.0], [-0.2]], [0.0]),
    ("sensor_scale", "elbow", {"scale": (0.5, 2)}, [[1.3], [1.0], [0.8]], [1.0]),
    ("time_scale", None, {"ratio": (0.8, 1.25)}, [[1.2], [1.0], [0.9]], [1.0]),
    ("observation_delay", None, {"delay": (0, 0.02)}, [[0.0093], [0.0], [0.004]], [0.0]),
]


def simulator(name, target, bounds):
    return MujocoSimulator(load(DOUBLE_PENDULUM), None, [effect(name, target, **bounds)])


@pytest.mark.parametrize(("name", "target", "bounds", "rows", "neutral"), CASES)
def test_neutral_and_rows(name, target, bounds, rows, neutral):
    """Neutral values give the bits of the model alone, and rows of a batch those of one by one."""
    sim = simulator(name, target, bounds)
    windows = make_windows(sim.model, 3, 6, nsub=3, history=5)
    together = sim.predict(rows, windows)
    for row, values in zip(together, rows, strict=True):
        np.testing.assert_array_equal(sim.predict([values], windows)[0], row)
    for n in range(3):
        alone = plain_rollout(sim.model, windows.start[n], windows.ctrl[n], 3)
        np.testing.assert_array_equal(sim.predict([neutral], windows)[0, n], alone)
        assert np.abs(together[0, n] - alone).max() > 1e-4


def test_an_offset_is_taken_off_and_put_on():
    """The true joint starts `offset` below the measured one, and gravity acts on the true one."""
    sim = simulator(*CASES[0][:3])
    windows = make_windows(sim.model, 3, 6, nsub=3)
    shift = np.array([0, 0.3, 0, 0])
    for n, predicted in enumerate(sim.predict([[0.3]], windows)[0]):
        true = plain_rollout(sim.model, windows.start[n] - shift, windows.ctrl[n], 3)
        np.testing.assert_allclose(predicted, true + shift, rtol=0, atol=1e-14)


def test_a_scale_divides_and_multiplies():
    """Position and speed of the joint, and of no other."""
    sim = simulator(*CASES[1][:3])
    windows = make_windows(sim.model, 3, 6, nsub=3)
    scale = np.array([1, 1.3, 1, 1.3])
    for n, predicted in enumerate(sim.predict([[1.3]], windows)[0]):
        true = plain_rollout(sim.model, windows.start[n] / scale, windows.ctrl[n], 3)
        np.testing.assert_allclose(predicted, true * scale, rtol=0, atol=1e-14)


def test_a_step_lasts_longer():
    """The model compiled with another time step, bit for bit, each row with its own."""
    sim = simulator(*CASES[2][:3])
    windows = make_windows(sim.model, 3, 6, nsub=3)
    predicted = sim.predict([[1.2], [0.85]], windows)
    for row, ratio in enumerate((1.2, 0.85)):
        other = load(DOUBLE_PENDULUM)
        other.opt.timestep *= ratio
        for n in range(3):
            np.testing.assert_array_equal(predicted[row, n], plain_rollout(other, windows.start[n], windows.ctrl[n], 3))


def test_a_fall_takes_the_true_time():
    """A body in free fall is at v T + g T^2 / 2 for the true time T, but for the integrator's g T dt / 2."""
    model = load(
        '<mujoco><worldbody><body><joint type="slide" axis="0 0 -1"/><geom size="1"/></body></worldbody></mujoco>'
    )
    sim = MujocoSimulator(model, None, [effect("time_scale", None, ratio=(0.8, 1.25))])
    windows = make_windows(sim.model, 1, 50)
    step = 1.1 * model.opt.timestep
    time = step * 50
    q, v = windows.start[0]
    position, speed = sim.predict([[1.1]], windows)[0, 0, -1]
    assert speed == pytest.approx(v + 9.81 * time, rel=1e-12)
    assert position == pytest.approx(q + v * time + 0.5 * 9.81 * time * (time + step), rel=1e-12)


def test_late_measurements_are_those_of_late_commands():
    """A robot whose recording holds the states of 7 steps ago is replayed to rounding, from every row on."""
    model = load(DOUBLE_PENDULUM)
    late, nsub = 7, 5
    rng = np.random.default_rng(0)
    ctrl = rng.uniform(-2, 2, (41, model.nu))
    true = plain_rollout(model, np.zeros(4), ctrl.repeat(nsub, axis=0), 1)  # after every physics step
    states = np.concatenate([np.zeros((late + 1, 4)), true])[: 40 * nsub + 1 : nsub]
    time = np.arange(41) * nsub * model.opt.timestep
    data = Dataset([Episode("0", time=time, qpos=states[:, :2], qvel=states[:, 2:], ctrl=ctrl)])
    sim = simulator(*CASES[3][:3])
    windows = data.windows(10, history=sim.history_steps(data.control_dt))
    started = [n for n in range(len(windows.start)) if windows.row[n] * nsub >= late]
    predicted = sim.predict([[late * model.opt.timestep], [0.0]], windows)
    for n in started:
        np.testing.assert_allclose(predicted[0, n], windows.state[n, 1:], rtol=0, atol=1e-10)
    assert np.abs(predicted[1, started[0]] - windows.state[started[0], 1:]).max() > 1e-3


def test_an_observation_delay_is_an_actuation_delay_of_all():
    """No open-loop replay tells them apart: the same bits, fractions of a step included."""
    sim = simulator(*CASES[3][:3])
    other = simulator("actuation_delay", "*", {"delay": (0, 0.02)})
    assert sim.memory_time == other.memory_time
    windows = make_windows(sim.model, 3, 6, nsub=3, history=5)
    values = [[0.0093], [0.004]]
    np.testing.assert_array_equal(sim.predict(values, windows), other.predict(values, windows))


@pytest.mark.parametrize(
    ("name", "target", "bounds", "true"),
    [("joint_offset", "elbow", (-0.5, 0.5), 0.17), ("sensor_scale", "elbow", (0.6, 1.7), 1.15)],
)
def test_recovered_from_data(name, target, bounds, true):
    """Of 101 values around it the recorded one has the least loss, and no loss at all."""
    model = load(DOUBLE_PENDULUM)
    quantity = "offset" if name == "joint_offset" else "scale"
    data = record(model, 3, 40, 5, amplitude=3.0)

    def measured(e):
        qpos, qvel = e.qpos.copy(), e.qvel.copy()
        if name == "joint_offset":
            qpos[:, 1] += true
        else:
            qpos[:, 1], qvel[:, 1] = true * qpos[:, 1], true * qvel[:, 1]
        return Episode(e.name, time=e.time, qpos=qpos, qvel=qvel, ctrl=e.ctrl)

    windows = Dataset([measured(e) for e in data]).windows(8)
    sim = MujocoSimulator(model, None, [effect(name, target, **{quantity: bounds})])
    grid = np.linspace(true - 0.1, true + 0.1, 101)
    losses = sim.losses(grid[:, None], windows, np.ones(4)).sum(1)
    assert losses.argmin() == 50
    assert losses.min() < 1e-12 < np.delete(losses, 50).min()


@pytest.mark.parametrize("name", ["joint_offset", "sensor_scale"])
def test_only_axes_have_offsets_and_scales(name):
    """A ball joint's quaternion cannot be shifted."""
    bounds = {"offset": (-1, 1)} if name == "joint_offset" else {"scale": (0.5, 2)}
    for target in ("ball", "*"):
        with pytest.raises(BadEffect, match="it needs hinges or slides"):
            MujocoSimulator(load(BALL), None, [effect(name, target, **bounds)])


def test_slides_and_hinges_behind_a_quaternion():
    """The columns are those of the joint: `after` stands behind the ball joint's four."""
    model = load(BALL)
    state = np.random.default_rng(0).normal(size=(model.nq + model.nv))
    joint = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "after"))
    columns = [int(model.jnt_qposadr[joint]), model.nq + int(model.jnt_dofadr[joint])]
    bound = effect("sensor_scale", "after", scale=(0.5, 2)).bind(model)
    expected = state.copy()
    expected[columns] *= 1.5
    np.testing.assert_array_equal(bound.to_measured(state, np.array([1.5])), expected)
    np.testing.assert_allclose(bound.to_simulated(expected, np.array([1.5])), state, rtol=1e-15)
