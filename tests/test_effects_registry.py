"""The registry of effects, a user's own effects, and effects in spaces and files."""

import json

import numpy as np
import pytest

from nfpde.effects import Effect, Quantity, effect, effect_names, effects_in, register, registry
from nfpde.errors import BadEffect, BadParameter
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator
from tests.models import BALL, DOUBLE_PENDULUM, load, make_windows, plain_rollout, with_arrays

BOUNDS = {"coulomb": (0, 1), "static": (0, 1), "speed": (0.01, 1)}


@pytest.fixture
def own_registry(monkeypatch):
    """Effects registered in a test are forgotten after it."""
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))


class EncoderOffset(Effect):
    """The encoder's zero lies `offset` beside the joint's."""

    name = "encoder_offset"
    kind = "joint"
    quantities = (Quantity("offset", "rad", -3.0, 3.0, neutral=0.0),)
    sentence = "The encoder's zero is off."

    def to_simulated(self, state, values):
        out = np.array(state)
        out[..., self.qposadr] -= values
        return out

    def to_measured(self, state, values):
        out = np.array(state)
        out[..., self.qposadr] += values
        return out


class LaggingSpring(Effect):
    """A force that pulls the joint back to where it was: stiffness (low-pass of q - q), with a state of its own."""

    name = "lagging_spring"
    kind = "joint"
    quantities = (
        Quantity("stiffness", "Nm/rad", 0.0, 100.0, neutral=0.0),
        Quantity("rate", "1/s", 0.0, 100.0, neutral=1.0, shape_only=True),
    )
    sentence = "A spring whose rest position creeps after the joint."

    def step(self, world, rows, values):
        cell = np.ix_(rows, self.qposadr)
        rest = world.memory.setdefault(self, world.qpos[:, self.qposadr].copy())
        rest[rows] += world.model.opt.timestep * values[:, 1:] * (world.qpos[cell] - rest[rows])
        world.qfrc_applied[np.ix_(rows, self.dofs)] += values[:, :1] * (rest[rows] - world.qpos[cell])


def test_names():
    """The registry lists what it has; a name that it lacks is answered with the list."""
    assert {"actuation_delay", "coulomb_friction", "stribeck_friction"} <= set(effect_names())
    assert effect_names() == sorted(effect_names())
    with pytest.raises(BadEffect, match=r"no effect is called 'backlsh'; known: actuation_delay, .*coulomb_friction, "):
        effect("backlsh", "elbow")


@pytest.mark.parametrize("name", effect_names())
def test_every_effect_is_described(name):
    """Each has a sentence, units that are words, and a neutral value within what physics allows."""
    cls = registry._REGISTRY[name]
    assert cls.name == name
    assert cls.sentence.endswith(".")
    assert cls.__doc__
    for q in cls.quantities:
        assert q.low <= q.neutral <= q.high
        assert isinstance(q.unit, str)
    assert set(cls.default_bounds) <= {q.name for q in cls.quantities}


@pytest.mark.usefixtures("own_registry")
def test_registering():
    """A user's class joins the list; another class of that name, or a name that no field could have, does not."""
    register(EncoderOffset)
    register(EncoderOffset)
    assert "encoder_offset" in effect_names()
    assert effect("encoder_offset", "elbow", offset=(-0.1, 0.1)).parameters[0].name == "encoder_offset.offset:elbow"

    class Other(EncoderOffset):
        pass

    with pytest.raises(BadEffect, match="an effect called 'encoder_offset' is already registered"):
        register(Other)
    for bad in ("encoder offset", "opt", "a.b", ""):
        Other.name = bad
        with pytest.raises(BadEffect, match="must be a plain identifier other than 'opt'"):
            register(Other)


@pytest.mark.parametrize(
    ("name", "target", "bounds", "text"),
    [
        ("coulomb_friction", None, {"torque": (0, 1)}, "coulomb_friction needs a target: the joint it acts on"),
        ("coulomb_friction", "elbow", {}, r"give bounds for torque, as torque=\(low, high\) in Nm"),
        ("coulomb_friction", "elbow", {"torque": 1.0}, "give bounds for torque, .*; got 1.0"),
        ("coulomb_friction", "elbow", {"torque": (0, 1, 2)}, "give bounds for torque"),
        ("coulomb_friction", "elbow", {"torque": "01"}, "give bounds for torque"),
        ("coulomb_friction", "elbow", {"torqe": (0, 1)}, "has no parameter 'torqe'; it has: torque"),
        ("coulomb_friction", "elbow", {"torque": (-1, 1)}, r"torque must stay within \[0, inf\] Nm, got \(-1, 1\)"),
        ("actuation_delay", "*", {"delay": (0, 2)}, r"delay must stay within \[0, 1\] s, got \(0, 2\)"),
        ("stribeck_friction", "elbow", BOUNDS | {"speed": (0, 1)}, "speed must stay within"),
    ],
)
def test_bad_effects_are_refused(name, target, bounds, text):
    """Target, names and bounds, before any model is there."""
    with pytest.raises(BadEffect, match=text):
        effect(name, target, **bounds)


@pytest.mark.parametrize("bounds", [(1, 0), (0, np.nan), (0, np.inf), ("a", "b"), (0, 0)])
def test_bounds_follow_the_rules_of_parameters(bounds):
    """Numbers, finite, increasing."""
    with pytest.raises(BadParameter, match=r"coulomb_friction\.torque:elbow"):
        effect("coulomb_friction", "elbow", torque=bounds)


def test_targets_are_checked_against_the_model():
    """By the kind of element that the effect acts on."""
    with pytest.raises(BadEffect, match="coulomb_friction: the model has no joint 'lower'; it has: shoulder, elbow"):
        MujocoSimulator(load(DOUBLE_PENDULUM), None, [effect("coulomb_friction", "lower", torque=(0, 1))])
    with pytest.raises(BadEffect, match="actuation_delay: the model has no actuator"):
        MujocoSimulator(load(BALL), None, [effect("actuation_delay", "*")])


def test_effects_on_the_whole_robot_take_no_target():
    """An effect without a kind."""

    class Tilt(Effect):
        name = "tilt"
        kind = None
        quantities = (Quantity("roll", "rad", -1.0, 1.0, neutral=0.0),)

    assert Tilt(roll=(-0.1, 0.1)).parameters[0].name == "tilt.roll"
    with pytest.raises(BadEffect, match="tilt acts on the whole robot and takes no target, got 'elbow'"):
        Tilt("elbow", roll=(-0.1, 0.1))


@pytest.mark.parametrize("target", ["elbow", 1, "#1", ("shoulder", "elbow"), ["shoulder", 1], "*"])
def test_round_trip_through_files(tmp_path, target):
    """A space written with its effects' parameters gives back the effects, and the same simulator."""
    chosen = [effect("coulomb_friction", target, torque=(0, 1)), effect("stribeck_friction", target, **BOUNDS)]
    base = ParameterSpace([Parameter("body_mass", "lower", 0.3, 1.5)])
    sim = MujocoSimulator(load(DOUBLE_PENDULUM), base, chosen, check_influence=False)
    sim.space.to_toml(tmp_path / "p.toml")
    windows = make_windows(sim.model, 2, 4)
    xi = sim.space.uniform(2, np.random.default_rng(0))
    for space in (
        ParameterSpace.from_json(json.loads(json.dumps(sim.space.to_json()))),
        ParameterSpace.from_toml(tmp_path / "p.toml"),
    ):
        assert [(e.name, e.target) for e in effects_in(space)] == [(e.name, e.target) for e in chosen]
        again = MujocoSimulator(load(DOUBLE_PENDULUM), space, check_influence=False)
        assert again.space == sim.space
        np.testing.assert_array_equal(again.predict(xi, windows), sim.predict(xi, windows))


def test_half_an_effect_in_a_space_is_refused():
    """A space that was edited by hand."""
    space = ParameterSpace([Parameter("stribeck_friction.static", "elbow", 0, 1)])
    with pytest.raises(BadEffect, match="stribeck_friction on 'elbow': the space lacks its parameter 'coulomb'"):
        effects_in(space)
    assert effects_in(ParameterSpace([Parameter("opt.gravity", None, 0, 1), Parameter("a.b", "c", 0, 1)])) == []


@pytest.mark.usefixtures("own_registry")
def test_unknown_parameters_of_an_effect_are_refused():
    """`coulomb_friction.force` is neither a field nor a parameter of that effect."""
    space = ParameterSpace([Parameter("coulomb_friction.force", "elbow", 0, 1)])
    with pytest.raises(BadEffect, match="coulomb_friction has no parameter 'force'; it has: torque"):
        MujocoSimulator(load(DOUBLE_PENDULUM), space)


@pytest.mark.parametrize("more", [{"relative": True}, {"component": 1}, {"name": "friction"}, {"unit": "mNm"}])
def test_parameters_of_effects_have_bounds_only(more):
    """What makes no sense, or would be lost on the way through the effect, is not ignored."""
    space = ParameterSpace([Parameter("coulomb_friction.torque", "elbow", 0, 1, **({"unit": "Nm"} | more))])
    with pytest.raises(BadEffect, match="may set field, target, low and high, and nothing else"):
        MujocoSimulator(load(DOUBLE_PENDULUM), space)


def test_units_of_effects_may_be_left_out(tmp_path):
    """In a file written by hand; the simulator's space has them."""
    (tmp_path / "p.toml").write_text(
        '[[parameter]]\nfield = "coulomb_friction.torque"\ntarget = "elbow"\nlow = 0\nhigh = 1\n'
    )
    sim = MujocoSimulator(load(DOUBLE_PENDULUM), ParameterSpace.from_toml(tmp_path / "p.toml"))
    assert sim.space.units == ["Nm"]


def test_the_order_of_an_effects_parameters_is_kept():
    """A space in another order would need its columns exchanged."""
    made = effect("stribeck_friction", "elbow", **BOUNDS).parameters
    with pytest.raises(BadEffect, match="each effect's in its own order"):
        MujocoSimulator(load(DOUBLE_PENDULUM), ParameterSpace([made[1], made[0], made[2]]))


def test_an_effect_on_the_measurement():
    """An encoder that is off: the motion is that of the true angle, and the report is off again."""
    sim = MujocoSimulator(load(DOUBLE_PENDULUM), None, [EncoderOffset("elbow", offset=(-1, 1))])
    windows = make_windows(sim.model, 4, 6, nsub=3)
    predicted = sim.predict([[0.0], [0.3]], windows)
    for n in range(4):
        np.testing.assert_array_equal(predicted[0, n], plain_rollout(sim.model, windows.start[n], windows.ctrl[n], 3))
        shift = np.array([0, 0.3, 0, 0])
        true = plain_rollout(sim.model, windows.start[n] - shift, windows.ctrl[n], 3)
        np.testing.assert_allclose(predicted[1, n], true + shift, rtol=0, atol=1e-15)


def test_measurement_and_simulation_are_inverse():
    """For any states and values, with two effects composed the innermost is undone first."""
    bound = [EncoderOffset(t, offset=(-1, 1)).bind(load(DOUBLE_PENDULUM)) for t in ("elbow", "*")]
    rng = np.random.default_rng(0)
    state, values = rng.normal(size=(5, 7, 4)), rng.normal(size=(5, 1, 1))
    for e in bound:
        np.testing.assert_allclose(e.to_simulated(e.to_measured(state, values), values), state, atol=1e-15)
        assert not np.allclose(e.to_measured(state, values), state)


class EncoderScale(EncoderOffset):
    """The encoder counts `scale` times too much."""

    name = "encoder_scale"
    quantities = (Quantity("scale", "-", 0.1, 10.0, neutral=1.0),)

    def to_simulated(self, state, values):
        out = np.array(state)
        out[..., self.qposadr] /= values
        return out

    def to_measured(self, state, values):
        out = np.array(state)
        out[..., self.qposadr] *= values
        return out


def test_effects_on_the_measurement_are_undone_in_order():
    """First effect outermost: measured = scale * angle + offset, when the offset comes first."""
    chosen = [EncoderOffset("elbow", offset=(-1, 1)), EncoderScale("elbow", scale=(0.5, 2))]
    sim = MujocoSimulator(load(DOUBLE_PENDULUM), None, chosen)
    windows = make_windows(sim.model, 3, 5)
    predicted = sim.predict([[0.3, 1.5]], windows)[0]
    for n in range(3):
        start = windows.start[n].copy()
        start[1] = (start[1] - 0.3) / 1.5
        expected = plain_rollout(sim.model, start, windows.ctrl[n], 1)
        expected[:, 1] = expected[:, 1] * 1.5 + 0.3
        np.testing.assert_allclose(predicted[n], expected, rtol=0, atol=1e-14)


def test_an_effect_with_a_force_and_memory():
    """The plain loop with the same force; memory starts anew with every window, and neutral rows feel nothing."""
    sim = MujocoSimulator(load(DOUBLE_PENDULUM), None, [LaggingSpring("elbow", stiffness=(0, 50), rate=(1, 20))])
    windows = make_windows(sim.model, 4, 6, nsub=5)
    predicted = sim.predict([[20.0, 5.0], [0.0, 5.0], [40.0, 2.0]], windows)
    for row, (stiffness, rate) in ((0, (20.0, 5.0)), (1, (0.0, 5.0)), (2, (40.0, 2.0))):
        for n in range(4):
            rest = windows.start[n, 1]

            def pull(model, data, stiffness=stiffness, rate=rate):
                nonlocal rest
                rest += model.opt.timestep * rate * (data.qpos[1] - rest)
                data.qfrc_applied[1] = stiffness * (rest - data.qpos[1])

            expected = plain_rollout(sim.model, windows.start[n], windows.ctrl[n], 5, pull)
            np.testing.assert_allclose(predicted[row, n], expected, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(sim.predict([[20.0, 5.0], [0.0, 5.0], [40.0, 2.0]], windows), predicted)
    shuffled = sim.predict([[40.0, 2.0], [20.0, 5.0]], with_arrays(windows))
    np.testing.assert_array_equal(shuffled, predicted[[2, 0]])


def test_forces_of_effects_add():
    """Two springs on one joint pull as one of both stiffnesses."""
    spring = LaggingSpring("elbow", stiffness=(0, 50), rate=(1, 20))
    double = MujocoSimulator(load(DOUBLE_PENDULUM), None, [spring, LaggingSpring("*", stiffness=(0, 50), rate=(1, 20))])
    windows = make_windows(double.model, 3, 6, nsub=5)
    single = MujocoSimulator(load(DOUBLE_PENDULUM), None, [LaggingSpring("*", stiffness=(0, 50), rate=(1, 20))])
    alone = single.predict([[20.0, 5.0]], windows)
    np.testing.assert_array_equal(double.predict([[0.0, 5.0, 20.0, 5.0]], windows), alone)
    both = double.predict([[10.0, 5.0, 10.0, 5.0]], windows)
    assert np.abs(both - alone).max() > 1e-4  # the shoulder has only one of them
    only_elbow = MujocoSimulator(load(DOUBLE_PENDULUM), None, [spring])
    twice = MujocoSimulator(
        load(DOUBLE_PENDULUM), None, [spring, LaggingSpring(1, stiffness=(0, 50), rate=(1, 20))], check_influence=False
    )
    np.testing.assert_allclose(
        twice.predict([[12.0, 5.0, 8.0, 5.0]], windows), only_elbow.predict([[20.0, 5.0]], windows), rtol=0, atol=1e-13
    )
