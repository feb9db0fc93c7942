"""Simulations that blow up: NaN in predictions, the limit in losses, and no harm to any other."""

import mujoco
import mujoco.batch
import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadModel
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import LOSS_LIMIT, MujocoSimulator
from nfpde.sim.quiet import quiet_mujoco
from tests.models import DOUBLE_PENDULUM, FLYWHEEL, PENDULUM, load, make_windows, plain_rollout, with_arrays

SPACE = ParameterSpace(
    [Parameter("jnt_stiffness", "elbow", -1e7, 1.0), Parameter("jnt_stiffness", "shoulder", 0.0, 1e12)]
)
GOOD, WILD, STIFF = [0.1, 0.0], [-1e6, 0.0], [0.1, 1e11]


def arm():
    return MujocoSimulator(load(DOUBLE_PENDULUM), SPACE, check_influence=False)


@pytest.mark.parametrize("bad", [WILD, STIFF])
def test_nan_in_predictions_and_the_limit_in_losses(bad):
    """A spring that pushes its joint over, or one too stiff: NaN in all channels from one step to the end."""
    sim = arm()
    windows = make_windows(sim.model, 6, 12, nsub=5)
    predicted = sim.predict([bad], windows)[0]
    gone = np.isnan(predicted)
    assert gone[:, -1].all()
    np.testing.assert_array_equal(gone.any(2), gone.all(2))
    assert (np.diff(gone.all(2).astype(int), axis=1) >= 0).all()
    np.testing.assert_array_equal(sim.losses([bad], windows, np.ones(4)), np.full((1, 6), LOSS_LIMIT))


def test_before_it_diverges_a_simulation_is_a_plain_loop():
    """The steps before the first warning are predicted, the step with it is the first NaN."""
    sim = MujocoSimulator(
        load(PENDULUM), ParameterSpace([Parameter("jnt_stiffness", "hinge", -1e5, 0)]), check_influence=False
    )
    windows = make_windows(sim.model, 1, 200)
    model = load(PENDULUM)
    for stiffness in (-3e3, -1e4, -3e4):
        model.jnt_stiffness[0] = stiffness
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = windows.start[0, :1], windows.start[0, 1:]
        expected = []
        for command in windows.ctrl[0]:
            data.ctrl[:] = command
            with quiet_mujoco():
                mujoco.mj_step(model, data)
            if any(w.number for w in data.warning):
                break
            expected.append([data.qpos[0], data.qvel[0]])
        assert 2 <= len(expected) < 200
        predicted = sim.predict([[stiffness]], windows)[0, 0]
        np.testing.assert_array_equal(predicted[: len(expected)], expected)
        assert np.isnan(predicted[len(expected) :]).all()


def test_neighbours_are_unaffected():
    """Rows beside a diverging one have the bits of a run without it."""
    windows = make_windows(arm().model, 5, 8, nsub=5)
    alone = arm().predict([GOOD, [0.7, 3.0]], windows)
    beside = arm().predict([WILD, GOOD, STIFF, [0.7, 3.0], WILD], windows)
    np.testing.assert_array_equal(beside[[1, 3]], alone)
    assert np.isnan(beside[[0, 2, 4], :, -1]).all()


def test_nothing_leaks_into_the_next_call():
    """After calls in which every row diverged, a normal call has the bits of a fresh simulator."""
    sim = arm()
    windows = make_windows(sim.model, 5, 8, nsub=5)
    for _ in range(2):
        assert np.isnan(sim.predict([WILD, STIFF, WILD], windows)[:, :, -1]).all()
        np.testing.assert_array_equal(sim.predict([GOOD], windows), arm().predict([GOOD], windows))


def test_nothing_leaks_with_effects():
    """The same where effects act step by step: their fields and forces do not outlive a diverged row."""

    def wheel():
        friction = effect("stribeck_friction", "axle", coulomb=(0, 1), static=(0, 1), speed=(0.01, 1))
        space = ParameterSpace([Parameter("jnt_stiffness", "axle", -1e7, 1.0)])
        return MujocoSimulator(load(FLYWHEEL.format(integrator="Euler", frictionloss=0)), space, [friction])

    good, wild = [0.1, 0.2, 0.4, 0.1], [-1e7, 0.2, 0.4, 0.1]
    sim = wheel()
    windows = make_windows(sim.model, 4, 30)
    expected = wheel().predict([good], windows)
    sim.predict([wild, wild, wild], windows)
    np.testing.assert_array_equal(sim.predict([good], windows), expected)
    beside = sim.predict([wild, good, wild], windows)
    np.testing.assert_array_equal(beside[1], expected[0])
    assert np.isnan(beside[[0, 2], :, -1]).all()
    without = sim.predict([[0.1, 0.0, 0.0, 0.1]], windows)[0]
    model = load(FLYWHEEL.format(integrator="Euler", frictionloss=0))
    model.jnt_stiffness[0] = 0.1
    for n in range(4):
        np.testing.assert_array_equal(without[n], plain_rollout(model, windows.start[n], windows.ctrl[n], 1))


def test_a_start_beyond_mujocos_range_is_a_divergence():
    """A measured velocity of 1e11 is one that MuJoCo resets; its row is NaN from the first step."""
    sim = arm()
    windows = make_windows(sim.model, 3, 2)
    state = windows.state.copy()
    state[1, 0, 3] = 1e11
    predicted = sim.predict([GOOD], with_arrays(windows, state=state))[0]
    assert np.isnan(predicted[1]).all()
    np.testing.assert_array_equal(predicted[[0, 2]], sim.predict([GOOD], windows)[0, [0, 2]])


def test_every_warning_counts():
    """A command beyond 1e10, which MuJoCo takes for 0 and goes on, gives plausible numbers; they are not passed on."""
    sim = arm()
    windows = make_windows(sim.model, 3, 4)
    ctrl = windows.ctrl.copy()
    ctrl[1, 2, 0] = 1e11
    predicted = sim.predict([GOOD], with_arrays(windows, ctrl=ctrl))[0]
    assert np.isnan(predicted[1, 2:]).all()
    expected = sim.predict([GOOD], windows)[0]
    np.testing.assert_array_equal(predicted[1, :2], expected[1, :2])
    np.testing.assert_array_equal(predicted[[0, 2]], expected[[0, 2]])


def test_divergence_is_quiet(capfd, tmp_path, monkeypatch):
    """Nothing on the console, no log file, and MuJoCo's logging as before afterwards."""
    monkeypatch.chdir(tmp_path)
    before = mujoco.MjLogConfig.get()
    sim = arm()
    sim.predict([WILD, STIFF], make_windows(sim.model, 20, 5, nsub=5))
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []
    after = mujoco.MjLogConfig.get()
    assert (after.logto_console, after.logto_file) == (before.logto_console, before.logto_file) == (True, True)


def test_errors_of_the_engine_are_not_divergences(monkeypatch):
    """What MuJoCo itself raises is reported with its message, not turned into a loss."""

    def fails(self, ids=None, nstep=1, stage=0):
        raise mujoco.batch.SimulationError(np.array([0]), "mj_stackAlloc: out of memory", 3)

    sim = arm()
    monkeypatch.setattr(mujoco.batch.Batch, "step", fails)
    with pytest.raises(BadModel, match=r"MuJoCo cannot simulate this model: .*mj_stackAlloc: out of memory"):
        sim.predict([GOOD], make_windows(sim.model, 1, 1))
    assert mujoco.MjLogConfig.get().logto_console
