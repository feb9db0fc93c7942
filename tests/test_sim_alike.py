"""Several models of one size in one simulator, against a simulator of each model alone; what must be equal."""

import mujoco
import numpy as np
import pytest

import nfpde
from nfpde.bench import losses
from nfpde.benchmarks import ROBOTS
from nfpde.effects import effect
from nfpde.errors import BadEffect, BadInput, BadModel, BadParameter
from nfpde.estimation import NfpdeConfig
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator, make_simulator
from nfpde.sim.warp import WarpSimulator
from tests.device import WARP
from tests.models import DOUBLE_PENDULUM, FREE_BOX, PENDULUM, load, make_windows, record

MASS = Parameter("body_mass", "lower", 0.5, 2.0, relative=True)
DAMPING = Parameter("dof_damping", "shoulder", 0.0, 1.0)


def changed(xml, *replacements):
    for old, new in replacements:
        assert old in xml
        xml = xml.replace(old, new)
    return load(xml)


# a longer forearm that is not straight; another motor and friction; weaker gravity and a fluid
BUILDS = [
    load(DOUBLE_PENDULUM),
    changed(DOUBLE_PENDULUM, ('0 0 -0.5" size="0.03" mass="0.7"', '0 0.05 -0.6" size="0.04" mass="1.1"')),
    changed(DOUBLE_PENDULUM, ('gear="3"', 'gear="2"'), ('damping="0.1" arm', 'damping="0.4" frictionloss="0.2" arm')),
    changed(DOUBLE_PENDULUM, ('timestep="0.002"', 'timestep="0.002" gravity="0 0 -3.7" density="100"')),
    changed(DOUBLE_PENDULUM, ("0 0 -0.6", "0.1 0 -0.8"), ('mass="1.2"', 'mass="3"')),
]


def choice(count):
    return Parameter("model", low=0, high=count)


SPACE = ParameterSpace([MASS, choice(len(BUILDS)), DAMPING])


def split(sim, xi, windows):
    """What simulators of one model each predict, row by row of xi, whose column 1 says which."""
    alone = [
        MujocoSimulator(m, ParameterSpace([p for p in sim.space if p.field != "model"]), check_influence=False)
        for m in sim.models
    ]
    return np.concatenate([alone[int(x[1])].predict(np.delete(x, 1)[None], windows) for x in xi])


@pytest.fixture(scope="module")
def windows():
    return make_windows(BUILDS[0], 5, 4, nsub=5)


def mixed_vectors(sim):
    xi = sim.space.uniform(12, np.random.default_rng(0))
    xi[:, 1] = [0, 4, 2, 3, 1, 1.999, 3.5, 2.01, 0.5, 4.7, 5, 1]  # the upper bound belongs to the last
    return np.array(xi), np.array([0, 4, 2, 3, 1, 1, 3, 2, 0, 4, 4, 1])


def test_rows_are_those_of_each_model_alone(windows):
    """Parameters that scale and that replace, and every number in which the models differ: the same bits."""
    sim = MujocoSimulator(BUILDS, SPACE, check_influence=False)
    xi, model = mixed_vectors(sim)
    expected = split(sim, np.column_stack([xi[:, 0], model, xi[:, 2]]), windows)
    assert np.abs(expected[:5] - expected[0]).max((1, 2, 3))[1:].min() > 1e-3
    np.testing.assert_array_equal(sim.predict(xi, windows), expected)
    np.testing.assert_array_equal(sim.writer.which(xi), model)


def test_the_device_takes_the_same_rows(windows):
    """All pairs and any pairs in single precision, with results poisoned beforehand."""
    sim = WarpSimulator(BUILDS, SPACE, device=WARP, check_influence=False)
    assert sim._model.derived is None  # geoms of other sizes: the host derives MuJoCo's constants
    xi, model = mixed_vectors(sim)
    expected = split(sim, np.column_stack([xi[:, 0], model, xi[:, 2]]), windows)
    rows = np.random.default_rng(1).integers(0, [[12], [5]], (2, 20))
    for call, wanted in [
        (lambda: sim.predict(xi, windows), expected),
        (lambda: sim.rollout(xi, windows, *rows), expected[rows[0], rows[1]]),
    ]:
        call()
        for batch in sim._batches.kept.values():
            batch.poison()
        # twenty steps of a few units in single precision, as in test_warp
        np.testing.assert_allclose(call(), wanted, atol=2e-5)
    one = np.ones(4)
    np.testing.assert_allclose(sim.losses(xi, windows, one), sim.reference.losses(xi, windows, one), rtol=1e-4)


def test_constants_of_several_models_are_derived_on_the_device(windows):
    """Where only masses and motors differ, no row's constants come from the host."""
    heavy = changed(DOUBLE_PENDULUM, ('size="0.04" mass="1.2"', 'size="0.04" mass="3"'), ('gear="3"', 'gear="2"'))
    space = ParameterSpace([MASS, choice(2)])
    sim = WarpSimulator([BUILDS[0], heavy], space, device=WARP, check_influence=False)
    assert sim._model.derived
    xi = np.array([[0.7, 1.0], [0.7, 0.0], [1.6, 1.0]])
    one = np.ones(4)
    sim.losses(xi, windows, one)
    (batch,) = sim._batches.kept.values()
    batch.poison()
    # as in single precision: 1e-5 of positions and velocities of a few units
    np.testing.assert_allclose(sim.losses(xi, windows, one), sim.reference.losses(xi, windows, one), rtol=1e-4)
    fields = sim.reference.writer.rows(xi)
    for name in sim._model.derived:
        found = batch._fields[name].numpy()[:3]  # on a GPU there are rows that nobody reads
        np.testing.assert_allclose(found, fields[name].reshape(3, -1), rtol=1e-4, err_msg=name)


@pytest.mark.parametrize("device", ["cpu", WARP])
def test_builds_of_a_robot_in_contact(device):
    """A Hopper with longer shins, whose floor is lower, beside the plain one; masses scale in both."""
    robot = ROBOTS["hopper"]
    spec = mujoco.MjSpec.from_file(str(robot.path))
    for geom in spec.geoms:
        if geom.name == "foot_geom":
            geom.size[0] *= 1.2
        if geom.name == "floor":
            geom.pos[2] -= 0.01
    both = [mujoco.MjModel.from_xml_path(str(robot.path)), spec.compile()]
    sim = make_simulator(
        both, ParameterSpace([Parameter("body_mass", "foot", 0.5, 2.0, relative=True), choice(2)]), device=device
    )
    recorded = losses._record(robot, episodes=3, steps=30).transitions()
    xi = np.array([[0.7, 0], [0.7, 1], [1.4, 1]])
    expected = split(sim, xi, recorded)
    assert np.abs(expected[1] - expected[0]).max() > 1e-3
    square = (sim.states.difference(sim.predict(xi, recorded), expected) ** 2).sum((2, 3))
    # of single precision, as for the robots themselves in test_warp; none between the same steps in double
    assert square.max() <= (0 if device == "cpu" else 1e-6)


def test_effects_and_constants_follow_each_model(windows):
    """An effect on the model adds to each model's own, and MuJoCo's constants are derived anew in every row."""
    space = ParameterSpace([MASS, choice(3)])
    friction = effect("coulomb_friction", "elbow", torque=(0.0, 0.5))
    sim = MujocoSimulator(BUILDS[:3], space, [friction], check_influence=False)
    xi = np.array([[1.0, 2.0, 0.3], [1.5, 1.0, 0.0], [0.6, 0.0, 0.1]])
    rows = sim.writer.rows(xi)
    elbow = 1
    np.testing.assert_array_equal(rows["dof_frictionloss"][:, elbow], [0.5, 0.0, 0.1])
    for row, (mass, k, torque) in enumerate(xi):
        alone = MujocoSimulator(BUILDS[int(k)], ParameterSpace([MASS]), [friction], check_influence=False)
        for name, values in alone.writer.rows(np.array([[mass, torque]])).items():
            np.testing.assert_array_equal(rows[name][row], values[0], err_msg=name)
    warp = WarpSimulator(BUILDS[:3], space, [friction], device=WARP, check_influence=False)
    np.testing.assert_allclose(warp.predict(xi, windows), sim.predict(xi, windows), atol=2e-5)


def test_what_the_simulator_says_of_several_models():
    """Values are unknown where models differ, and a run is resumed with the same models in the same order only."""
    sim = MujocoSimulator(BUILDS, SPACE, check_influence=False)
    np.testing.assert_array_equal(sim.nominal(), [1.0, np.nan, 0.2])
    with_other_order = MujocoSimulator(BUILDS[::-1], sim.space, check_influence=False)
    assert sim.identity() != with_other_order.identity()
    elbow = ParameterSpace([Parameter("dof_damping", "elbow", 0.0, 1.0), choice(3)])
    assert np.isnan(MujocoSimulator(BUILDS[:3], elbow, check_influence=False).nominal()[0])


def test_a_model_can_be_written_back():
    """A live model takes one build after the other, and none leaves a trace."""
    sim = MujocoSimulator(BUILDS, SPACE, check_influence=False)
    live = mujoco.MjModel.from_xml_string(DOUBLE_PENDULUM)
    for k in (3, 1, 4, 0):
        sim.writer.write(live, np.array([1.0, k, 0.2]))
        for name in sim.writer.fields:
            got, own = (
                np.asarray(getattr(m.opt, name[4:]) if "." in name else getattr(m, name)) for m in (live, sim.models[k])
            )
            np.testing.assert_array_equal(got, own, err_msg=f"{name} of {k}")


UNLIKE = [
    ([("<motor name=", '<motor joint="elbow"/><motor name=')], "nu is 3, in model 0 it is 2"),
    ([('name="elbow" axis', 'name="elbow" type="slide" axis')], "it has another jnt_type"),
    ([('name="elbow"', 'name="knee"'), ('joint="elbow"', 'joint="knee"')], "joint 'knee' is called 'elbow'"),
    ([('type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03"', 'type="sphere" size="0.1"')], "it has another geom_type"),
    ([('timestep="0.002"', 'timestep="0.001"')], "it has another opt.timestep"),
    ([('timestep="0.002"', 'timestep="0.002" integrator="RK4"')], "it has another opt.integrator"),
    ([('gear="3"', 'gear="3" ctrllimited="true" ctrlrange="-1 1"')], "it has another actuator_ctrl"),
    ([('<body name="lower"', '<body name="lower" gravcomp="1"')], "ngravcomp is 1, in model 0 it is 0"),
]


@pytest.mark.parametrize(("replacements", "text"), UNLIKE)
def test_models_that_are_not_alike(replacements, text):
    """The first size, name or field that must be equal and is not, and what to do."""
    other = changed(DOUBLE_PENDULUM, *replacements)
    with pytest.raises(BadModel, match=f"model 1: {text}"):
        make_simulator([BUILDS[0], other], ParameterSpace([choice(2)]), device="cpu")


def test_a_body_that_mujoco_compiled_in_another_way():
    """A box whose centre of mass is on its joint has fewer entries in its inertia matrix than one whose is not."""
    centred = changed(FREE_BOX, ('pos="0.01 0 0" mass', 'pos="0 0 0" mass'))
    with pytest.raises(BadModel, match=r"another body_simple \(bodies whose centre of mass"):
        MujocoSimulator([load(FREE_BOX), centred], ParameterSpace([choice(2)]))


@pytest.mark.parametrize("device", ["cpu", WARP])
def test_pictures_may_differ(device):
    """Colours, cameras, sizes of sites and names of bodies decide nothing."""
    plain = changed(PENDULUM, ('<geom name="bob"', '<site size="0.01"/><geom name="bob"'))
    seen = changed(
        PENDULUM,
        ('<geom name="bob"', '<site size="0.1"/><camera/><geom rgba="1 0 0 1" name="weight"'),
        ('body name="rod"', 'body name="stick"'),
        ('damping="0.1"', ""),
    )
    space = ParameterSpace([Parameter("jnt_stiffness", "hinge", 0.0, 1.0), choice(2)])
    sim = make_simulator([plain, seen], space, device=device, check_influence=False)
    xi, windows = np.array([[0.3, 0.0], [0.3, 1.0]]), make_windows(plain, 3, 5)
    np.testing.assert_allclose(sim.predict(xi, windows), split(sim, xi, windows), atol=2e-5)


@pytest.mark.parametrize(
    ("models", "parameters", "text"),
    [
        (BUILDS[:2], [MASS], r'needs one parameter .* Parameter\("model", low=0, high=2\); it has 0'),
        (BUILDS[:3], [choice(2)], r'it must be Parameter\("model", low=0, high=3\)'),
        (BUILDS[:1], [MASS, choice(2)], "one was given; leave it out"),
        (BUILDS[0], [MASS, choice(2)], "one was given; leave it out"),
        ([BUILDS[0], BUILDS[0]], [choice(2)], "model .*changes nothing"),
        (BUILDS[:2], [Parameter("dof_damping", "wrist", 0, 1), choice(2)], "wrist"),
    ],
)
def test_the_parameter_of_the_model(models, parameters, text):
    """It is there where there are several models, and only there, from 0 to their number."""
    with pytest.raises(BadParameter, match=text):
        MujocoSimulator(models, ParameterSpace(parameters))


def test_a_fit_finds_the_model_that_made_the_recordings():
    """Softmax puts nearly all probability on the right one of three builds, and the mass where it was."""
    sim = MujocoSimulator(BUILDS[:3], ParameterSpace([choice(3), MASS]), check_influence=False)
    config = NfpdeConfig(iterations=25, samples=100, transitions=20, transforms=2, hidden=16)
    result = nfpde.fit(sim, record(BUILDS[1], 1, 30, 5), method="softmax", config=config, quiet=True)
    drawn = result.distribution.sample(1000)
    assert (drawn[:, 0].astype(int) == 1).mean() > 0.9
    assert np.median(drawn[:, 1]) == pytest.approx(1.0, abs=0.1)


def test_a_fit_that_follows_slopes_refuses_several_models():
    """Along the choice of a model there is no slope."""
    sim = MujocoSimulator(BUILDS[:2], ParameterSpace([MASS, choice(2)]), check_influence=False)
    with pytest.raises(BadInput, match="jump along model, and the method trajectory follows slopes: take softmax"):
        nfpde.fit(sim, record(BUILDS[1], 1, 10, 5), quiet=True)


def test_no_model():
    """An empty list is no model."""
    with pytest.raises(BadModel, match="no model was given"):
        MujocoSimulator([], ParameterSpace([MASS]))


def test_an_effect_that_takes_something_from_its_model():
    """Backlash takes the inertia of its rotor from the model, and the models have others."""
    with pytest.raises(BadEffect, match=r"backlash on elbow_motor: it takes spare from the model, and model 1 has"):
        MujocoSimulator(BUILDS[:2], ParameterSpace([choice(2)]), [effect("backlash", "elbow_motor", width=(0.0, 0.1))])
