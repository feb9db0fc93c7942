"""Effects by their physics, and against plain MuJoCo."""

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadInput
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator
from tests.models import (
    DOUBLE_PENDULUM,
    FLYWHEEL,
    load,
    make_windows,
    parameterised,
    plain_rollout,
    record,
    with_arrays,
)

INERTIA = 0.2
INTEGRATORS = ["Euler", "RK4", "implicitfast"]


def wheel(integrator="Euler", frictionloss=0.0):
    return load(FLYWHEEL.format(integrator=integrator, frictionloss=frictionloss))


def spin(sim, xi, speed, torque, steps):
    """Speed [rad/s] of the wheel after every millisecond, from a speed on, under a constant motor torque."""
    windows = make_windows(sim.model, 1, steps)
    state = np.zeros_like(windows.state)
    state[:, 0, 1] = speed
    windows = with_arrays(windows, state=state, ctrl=np.full_like(windows.ctrl, torque))
    return sim.predict([xi], windows)[0, 0, :, 1]


def coulomb(target="axle", model=None, high=1.0):
    return MujocoSimulator(model or wheel(), None, [effect("coulomb_friction", target, torque=(0, high))])


def stribeck(target="axle", model=None):
    bounds = {"coulomb": (0, 1), "static": (0, 1), "speed": (0.001, 10)}
    return MujocoSimulator(model or wheel(), None, [effect("stribeck_friction", target, **bounds)])


def delay(target="*", high=0.02, model=None):
    return MujocoSimulator(model or load(DOUBLE_PENDULUM), None, [effect("actuation_delay", target, delay=(0, high))])


# Coulomb friction


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_coulomb_stops_a_wheel_in_the_predicted_time(integrator):
    """Speed falls by torque / inertia per second, either way round, and stays at rest from v I / torque = 0.4 s on."""
    sim = coulomb(model=wheel(integrator))
    t = 0.001 * np.arange(1, 601)
    for sign in (1, -1):
        speed = spin(sim, [0.25], 0.5 * sign, 0.0, 600)
        # MuJoCo's friction is a soft constraint: it eases in over the last 20 ms, its time constant
        moving = t < 0.38
        np.testing.assert_allclose(speed[moving], sign * (0.5 - 0.25 / INERTIA * t[moving]), rtol=1e-9)
        assert np.abs(speed[t > 0.45]).max() < 5e-3


def test_coulomb_holds_up_to_its_torque():
    """A motor just below the friction moves the wheel by less than a degree in a second, one above it drives it off."""
    sim = coulomb()
    below, above = spin(sim, [0.25], 0.0, 0.24, 1000), spin(sim, [0.25], 0.0, 0.35, 1000)
    assert 0.001 * below.sum() < np.deg2rad(1)
    assert above[-1] == pytest.approx((0.35 - 0.25) / INERTIA, rel=0.05)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_coulomb_is_mujocos_frictionloss(integrator):
    """The bits of a model compiled with frictionloss, which the effect's torque is added to."""
    windows = make_windows(wheel(), 6, 40, nsub=3)
    for nominal in (0.0, 0.125):
        sim = coulomb(model=wheel(integrator, nominal))
        predicted = sim.predict([[0.25]], windows)[0]
        expected = wheel(integrator, nominal + 0.25)
        for n in range(6):
            np.testing.assert_array_equal(predicted[n], plain_rollout(expected, windows.start[n], windows.ctrl[n], 3))


def test_coulomb_is_recovered_from_data():
    """Of 101 values the recorded one has the least loss, and no loss at all."""
    truth = load(DOUBLE_PENDULUM.replace('name="elbow"', 'name="elbow" frictionloss="0.55"'))
    windows = record(truth, 4, 60, 5, amplitude=3.0).windows(10)
    sim = coulomb("elbow", load(DOUBLE_PENDULUM))
    grid = np.linspace(0, 1, 101)
    losses = sim.losses(grid[:, None], windows, np.ones(4)).sum(1)
    assert grid[losses.argmin()] == pytest.approx(0.55)
    assert losses.min() < 1e-12 < 1e-4 < np.delete(losses, losses.argmin()).min()


# Stribeck friction


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_stribeck_is_a_plain_loop_that_sets_frictionloss(integrator):
    """The level of the current speed is written before every mj_step, on top of the model's own."""
    model = wheel(integrator, 0.05)
    windows = make_windows(model, 6, 30, nsub=4)
    low, high, scale = 0.2, 0.5, 0.3

    def friction(model, data):
        model.dof_frictionloss[0] = 0.05 + (low + (high - low) * np.exp(-((data.qvel[0] / scale) ** 2)))

    predicted = stribeck(model=model).predict([[low, high, scale]], windows)[0]
    for n in range(6):
        expected = plain_rollout(wheel(integrator, 0.05), windows.start[n], windows.ctrl[n], 4, friction)
        np.testing.assert_array_equal(predicted[n], expected)


def test_stribeck_breaks_away_between_coulomb_and_static():
    """A torque between the two levels does not start the wheel but keeps accelerating it; one above both starts it."""
    sim, xi = stribeck(), [0.2, 0.4, 0.05]
    assert 0.001 * spin(sim, xi, 0.0, 0.35, 1000).sum() < np.deg2rad(1)
    moving = spin(sim, xi, 1.0, 0.35, 1000)
    assert moving[-1] - 1.0 == pytest.approx((0.35 - 0.2) / INERTIA, rel=1e-6)
    broken = spin(sim, xi, 0.0, 0.45, 1000)
    assert broken[-1] - broken[-101] == pytest.approx(0.1 * (0.45 - 0.2) / INERTIA, rel=1e-6)


def test_stribeck_is_coulomb_at_speed_and_where_both_levels_agree():
    """Far above the speed scale exp(-(v/s)^2) is 0 to the last bit; with static = coulomb it multiplies 0."""
    windows = make_windows(wheel(), 4, 20, nsub=2)
    state = windows.state.copy()
    state[:, 0, 1] = [30, -40, 50, 60]
    windows = with_arrays(windows, state=state)
    expected = coulomb().predict([[0.25]], windows)
    np.testing.assert_array_equal(stribeck().predict([[0.25, 0.75, 0.5]], windows), expected)
    slow = make_windows(wheel(), 4, 20, nsub=2, speed=0.1)
    expected = coulomb().predict([[0.25]], slow)
    np.testing.assert_array_equal(stribeck().predict([[0.25, 0.25, 0.5]], slow), expected)


def test_stribeck_is_searched_for_where_friction_does_not_fall_towards_rest():
    """Every coordinate is a friction that rises from motion to rest, within its bounds, and comes back as it was."""
    friction = effect("stribeck_friction", "axle", coulomb=(0, 1), static=(0, 2), speed=(0.001, 10))
    low, high = friction.straight_bounds()
    values = friction.bent(np.random.default_rng(0).uniform(low, high, (200, 3)))
    assert (values[:, 1] >= values[:, 0]).all()
    assert ((values >= [0, 0, 0.001]) & (values <= [1, 2, 10])).all()
    np.testing.assert_allclose(friction.bent(friction.straightened(values)), values, atol=1e-12)
    np.testing.assert_array_equal(friction.bent(friction.straightened(np.array([0.3, 0.1, 0.5]))), [0.3, 0.3, 0.5])


# Actuation delay


def per_step(windows, n, nsub, steps, column=None):
    """Commands of every physics step of window n, shifted by a whole number of steps by hand."""
    late = windows.history.shape[1] * nsub
    signal = np.concatenate([windows.history[n], windows.ctrl[n]]).repeat(nsub, axis=0)
    shifted = signal[late:].copy()
    for k in range(len(shifted)):
        moved = signal[late + k - steps]
        if column is None:
            shifted[k] = moved
        else:
            shifted[k, column] = moved[column]
    return shifted


@pytest.mark.parametrize("steps", [0, 1, 2, 3, 4, 7, 10])
@pytest.mark.parametrize(("target", "column"), [("*", None), ("shoulder", 0), ("elbow_motor", 1), (("#1",), 1)])
def test_a_delay_of_whole_steps_is_a_shift(steps, target, column):
    """Bit for bit the plain loop on commands shifted by hand, those before the start included."""
    sim = delay(target)
    windows = make_windows(sim.model, 3, 6, nsub=3, history=sim.history_steps(0.006))
    predicted = sim.predict([[steps * 0.002]], windows)[0]
    for n in range(3):
        expected = plain_rollout(sim.model, windows.start[n], per_step(windows, n, 3, steps, column), 1)
        np.testing.assert_array_equal(predicted[n], expected[2::3])


def test_rounding_of_the_delay_is_no_fraction_of_a_step():
    """One part in 10^15 more than three steps is three steps, for commands that would show the difference."""
    sim = delay()
    commands = np.random.default_rng(0).uniform(-1, 1, (1, 50, 2)) * 10.0 ** np.arange(-8, 8).repeat(4)[:50, None]
    exact, above = (sim.effects[0].command(commands, np.array([[d]]), 0.002) for d in (0.006, 0.006 * (1 + 1e-15)))
    np.testing.assert_array_equal(exact[:, 3:], commands[:, :-3])
    np.testing.assert_array_equal(above, exact)


def test_a_delay_between_steps_is_an_average():
    """2.25 steps late: three quarters of the command two steps old and a quarter of the one before it."""
    sim = delay()
    windows = make_windows(sim.model, 3, 6, nsub=3, history=sim.history_steps(0.006))
    predicted = sim.predict([[2.25 * 0.002]], windows)[0]
    for n in range(3):
        mixed = 0.75 * per_step(windows, n, 3, 2) + 0.25 * per_step(windows, n, 3, 3)
        expected = plain_rollout(sim.model, windows.start[n], mixed, 1)
        np.testing.assert_allclose(predicted[n], expected[2::3], rtol=0, atol=1e-12)


@pytest.mark.parametrize("center", [0.004, 0.005, 0.006])
def test_predictions_are_continuous_in_the_delay(center):
    """A difference of 2e-8 s moves the prediction by less than 1e-5, across whole steps and between them."""
    sim = delay()
    windows = make_windows(sim.model, 5, 6, nsub=3, history=sim.history_steps(0.006))
    before, after = sim.predict([[center - 1e-8], [center + 1e-8]], windows)
    difference = np.abs(after - before).max()
    assert 0 < difference < 1e-5


def test_the_commands_before_the_start_are_used():
    """With a delay of 10 steps at 3 a control step the last four commands matter, those before them do not."""
    sim = delay()
    needed = sim.history_steps(0.006)
    assert needed == 5
    windows = make_windows(sim.model, 2, 4, nsub=3, history=needed + 2)
    predicted = sim.predict([[0.02]], windows)
    for age in range(1, needed + 3):
        history = windows.history.copy()
        history[:, -age] += 1
        same = np.array_equal(sim.predict([[0.02]], with_arrays(windows, history=history)), predicted)
        assert same == (age > 4), age
    short = with_arrays(windows, history=windows.history[:, -needed:])
    np.testing.assert_array_equal(sim.predict([[0.02]], short), predicted)


def test_the_first_command_holds_before_an_episode():
    """Windows at the start of a recording repeat its first command, and so does the effect beyond its own memory."""
    sim = delay()
    data = record(sim.model, 1, 12, 3)
    windows = data.windows(4, history=sim.history_steps(data.control_dt))[:1]
    np.testing.assert_array_equal(windows.history[0], np.tile(data.episodes[0].ctrl[0], (5, 1)))
    commands = np.arange(1.0, 7.0).reshape(1, 3, 2)
    late = sim.effects[0].command(commands, np.array([[0.002 * 5]]), 0.002)
    np.testing.assert_array_equal(late, np.tile(commands[:, :1], (1, 3, 1)))


def test_too_little_history_is_refused():
    """The text says how much history the windows need."""
    sim = delay()
    for history in (0, 4):
        windows = make_windows(sim.model, 2, 2, nsub=3, history=history)
        with pytest.raises(BadInput, match=f"look 0.02 s back: cut the windows with history=5, they have {history}"):
            sim.predict([[0.0]], windows)


def test_delays_in_series_add():
    """All commands by 2 steps and one of them by 4 more: the same as 2 and 6, with history for both."""
    both = [effect("actuation_delay", t, delay=(0, 0.01)) for t in ("*", "elbow_motor")]
    sim = MujocoSimulator(load(DOUBLE_PENDULUM), None, both)
    assert sim.memory_time == pytest.approx(0.02)
    apart = [effect("actuation_delay", t, delay=(0, 0.012)) for t in ("shoulder", "elbow_motor")]
    other = MujocoSimulator(load(DOUBLE_PENDULUM), None, apart)
    assert other.memory_time == pytest.approx(0.012)
    windows = make_windows(sim.model, 3, 8, nsub=2, history=sim.history_steps(0.004))
    np.testing.assert_array_equal(sim.predict([[0.004, 0.008]], windows), other.predict([[0.004, 0.012]], windows))


def test_an_actuator_with_several_commands_is_delayed_as_a_whole():
    """A PID actuator takes two commands; the motor behind it in the model keeps its own."""
    model = load(DOUBLE_PENDULUM.replace('<motor joint="shoulder" gear="3"/>', '<pid joint="shoulder" kp="5" kv="1"/>'))
    assert (model.nu, model.nactuator) == (3, 2)
    for target, columns in (("shoulder", [0, 1]), ("elbow_motor", [2])):
        sim = delay(target, model=model)
        windows = make_windows(model, 2, 5, history=sim.history_steps(0.002))
        predicted = sim.predict([[0.006]], windows)[0]
        for n in range(2):
            expected = plain_rollout(sim.model, windows.start[n], per_step(windows, n, 1, 3, columns), 1)
            np.testing.assert_array_equal(predicted[n], expected)


# Together

EFFECTS = {
    "coulomb_friction": ("elbow", {"torque": (0, 1)}),
    "stribeck_friction": ("shoulder", {"coulomb": (0, 1), "static": (0, 1), "speed": (0.01, 1)}),
    "actuation_delay": ("*", {"delay": (0, 0.02)}),
}
SPACE = ParameterSpace([Parameter("body_mass", "lower", 0.3, 1.5), Parameter("dof_damping", "*", 0.0, 1.0)])
VALUES = {"coulomb_friction": [0.3], "stribeck_friction": [0.2, 0.5, 0.1], "actuation_delay": [0.0073]}
NEUTRAL = {"coulomb_friction": [0.0], "stribeck_friction": [0.0, 0.0, 0.1], "actuation_delay": [0.0]}


def simulator(names):
    chosen = [effect(name, EFFECTS[name][0], **EFFECTS[name][1]) for name in names]
    return MujocoSimulator(load(DOUBLE_PENDULUM), SPACE, chosen, check_influence=False)


def test_neutral_effects_do_nothing():
    """With every effect at its neutral value the bits are those of the model alone."""
    sim = simulator(EFFECTS)
    windows = make_windows(sim.model, 4, 6, nsub=3, history=5)
    xi = [0.9, 0.4]
    neutral = [*xi, *(v for values in NEUTRAL.values() for v in values)]
    predicted = sim.predict([neutral], windows)[0]
    alone = parameterised(sim.model, SPACE, xi)
    for n in range(4):
        np.testing.assert_array_equal(predicted[n], plain_rollout(alone, windows.start[n], windows.ctrl[n], 3))


def test_rows_with_different_effects_share_a_batch():
    """Each row has the bits of a simulator with its own effects only, whatever its neighbours have."""
    sets = [(), *[(name,) for name in EFFECTS], ("coulomb_friction", "actuation_delay"), tuple(EFFECTS)]
    together = simulator(EFFECTS)
    windows = make_windows(together.model, 4, 6, nsub=3, history=5)
    base = SPACE.uniform(len(sets), np.random.default_rng(0))
    rows = [
        [*b, *(v for name in EFFECTS for v in (VALUES if name in chosen else NEUTRAL)[name])]
        for b, chosen in zip(base, sets, strict=True)
    ]
    predicted = together.predict(rows, windows)
    losses = together.losses(rows, windows, np.ones(4))
    for i, chosen in enumerate(sets):
        alone = simulator(chosen)
        xi = [*base[i], *(v for name in chosen for v in VALUES[name])]
        np.testing.assert_array_equal(alone.predict([xi], windows)[0], predicted[i])
        np.testing.assert_array_equal(alone.losses([xi], windows, np.ones(4))[0], losses[i])
        np.testing.assert_array_equal(together.predict([rows[i]], windows)[0], predicted[i])


def test_effects_add_to_fields_that_parameters_vary():
    """Friction on top of a friction that is itself a parameter, per row."""
    space = ParameterSpace([Parameter("dof_frictionloss", "axle", 0.0, 0.5)])
    chosen = [
        effect("coulomb_friction", "axle", torque=(0, 1)),
        effect("stribeck_friction", "axle", coulomb=(0, 1), static=(0, 1), speed=(0.01, 1)),
    ]
    sim = MujocoSimulator(wheel(), space, chosen)
    windows = make_windows(wheel(), 3, 10)
    predicted = sim.predict([[0.125, 0.25, 0.125, 0.125, 0.1], [0.25, 0.25, 0.0, 0.0, 0.1]], windows)
    expected = coulomb().predict([[0.5]], windows)[0]
    np.testing.assert_array_equal(predicted, [expected, expected])
