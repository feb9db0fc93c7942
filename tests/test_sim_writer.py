"""Parameters written into models: what each of them means, and which are refused."""

import copy

import mujoco
import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadEffect, BadParameter
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import ModelWriter, MujocoSimulator, load_model
from tests.models import BALL, BLOCK, DOUBLE_PENDULUM, FREE_BOX, PENDULUM, load, make_windows, plain_rollout

ARM = load_model(load(DOUBLE_PENDULUM))


def write(model, parameters, xi):
    changed = copy.copy(model)
    ModelWriter(model, ParameterSpace(parameters)).write(changed, np.array(xi, float))
    return changed


def compiled(xml, *replacements):
    for old, new in replacements:
        assert old in xml
        xml = xml.replace(old, new)
    return load_model(load(xml))


DERIVED = ("body_invweight0", "body_subtreemass", "dof_invweight0", "dof_M0", "actuator_acc0")


@pytest.mark.parametrize(
    ("xml", "parameters", "xi", "replacements"),
    [
        (
            PENDULUM,
            [Parameter("body_mass", "rod", 1, 4)],
            [3.0],
            [('mass="1.5" diaginertia="0.04 0.05 0.01"', 'mass="3" diaginertia="0.08 0.1 0.02"')],
        ),
        (
            PENDULUM,
            [Parameter("body_mass", "rod", 1, 4, scale_inertia=False)],
            [3.0],
            [('mass="1.5"', 'mass="3"')],
        ),
        (
            PENDULUM,
            [Parameter("body_mass", "rod", 1, 4, relative=True)],
            [2.0],
            [('mass="1.5" diaginertia="0.04 0.05 0.01"', 'mass="3" diaginertia="0.08 0.1 0.02"')],
        ),
        (
            PENDULUM,
            [Parameter("body_ipos", "rod", -1, 1, component=2), Parameter("body_inertia", 1, 0.01, 1, component=1)],
            [-0.7, 0.045],
            [('pos="0 0 -0.5" mass', 'pos="0 0 -0.7" mass'), ("0.04 0.05 0.01", "0.04 0.045 0.01")],
        ),
        (
            PENDULUM,
            [
                Parameter("dof_damping", "hinge", 0, 1),
                Parameter("dof_armature", "hinge", 0, 1),
                Parameter("jnt_stiffness", "hinge", 0, 9),
                Parameter("dof_frictionloss", "hinge", 0, 9),
            ],
            [0.7, 0.2, 3.0, 0.4],
            [('damping="0.1"', 'damping="0.7" armature="0.2" stiffness="3" frictionloss="0.4"')],
        ),
        (
            PENDULUM,
            [Parameter("actuator_gear", "motor", 0, 9), Parameter("opt.gravity", None, -9, 9, component=0)],
            [5.0, 1.5],
            [('gear="2"', 'gear="5"'), ('timestep="0.002"', 'timestep="0.002" gravity="1.5 0 -9.81"')],
        ),
        (
            DOUBLE_PENDULUM,
            [Parameter("dof_damping", ("shoulder", "#1"), 0, 1), Parameter("opt.density", None, 0, 99)],
            [0.6, 50.0],
            [
                ('damping="0.2"', 'damping="0.6"'),
                ('damping="0.1"', 'damping="0.6"'),
                ('timestep="0.002"', 'timestep="0.002" density="50"'),
            ],
        ),
        (
            DOUBLE_PENDULUM,
            [Parameter("actuator_gear", "shoulder", 0, 9), Parameter("actuator_gear", "elbow_motor", 0, 9)],
            [4.0, 2.0],
            [
                ('joint="shoulder" gear="3"', 'joint="shoulder" gear="4"'),
                ('joint="elbow"/>', 'joint="elbow" gear="2"/>'),
            ],
        ),
        (
            BLOCK,
            [Parameter("geom_friction", "*", 0, 2), Parameter("geom_solref", "box", 0.001, 1)],
            [0.9, 0.05],
            [
                ('friction="0.2 0.005 0.0001"', 'friction="0.9 0.005 0.0001"'),
                ('friction="0.5 0.005 0.0001"', 'friction="0.9 0.005 0.0001" solref="0.05 1"'),
            ],
        ),
        (BALL, [Parameter("dof_damping", "ball", 0, 1)], [0.3], [('type="ball"', 'type="ball" damping="0.3"')]),
        (
            BALL,
            [Parameter("qpos0", "after", -1, 1)],
            [0.3],
            [('name="after" axis="1 0 0"', f'name="after" axis="1 0 0" ref="{np.rad2deg(0.3):.15f}"')],
        ),
    ],
)
def test_equals_the_recompiled_model(xml, parameters, xi, replacements):
    """A written model is the one that MuJoCo compiles from MJCF with these values, derived constants included."""
    written, expected = write(load_model(load(xml)), parameters, xi), compiled(xml, *replacements)
    fields = {p.field for p in parameters if not p.field.startswith("opt.")} | {*DERIVED, "body_mass", "body_inertia"}
    for field in fields:
        if parameters[0].field == "qpos0" and field in DERIVED:
            continue  # the compiler turns the bodies so that qpos0 looks the same; see the motion below
        np.testing.assert_allclose(getattr(written, field), getattr(expected, field), rtol=1e-12, err_msg=field)
    np.testing.assert_array_equal(written.opt.gravity, expected.opt.gravity)
    windows = make_windows(expected, 2, 10)
    for n in range(2):
        a, b = (plain_rollout(m, windows.start[n], windows.ctrl[n], 1) for m in (written, expected))
        # the solvers stop at a tolerance relative to a statistic that only the compiler updates
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-7)


def test_derived_constants_would_be_stale_without_set_const():
    """The fields of the test above do change: writing the mass alone leaves them wrong."""
    model = load_model(load(PENDULUM))
    stale = copy.copy(model)
    stale.body_mass[1] = 3.0
    written = write(model, [Parameter("body_mass", "rod", 1, 4, scale_inertia=False)], [3.0])
    for field in DERIVED:
        assert not np.allclose(getattr(stale, field), getattr(written, field)), field


def test_writing_again_starts_from_nominal():
    """What an earlier vector changed is put back first; the nominal model is never touched."""
    space = ParameterSpace([Parameter("body_mass", "lower", 0.5, 2, relative=True), Parameter("body_mass", 1, 1, 2)])
    writer = ModelWriter(ARM, space)
    once, twice = copy.copy(ARM), copy.copy(ARM)
    writer.write(once, np.array([1.5, 1.2]))
    writer.write(twice, np.array([0.7, 2.0]))
    writer.write(twice, np.array([1.5, 1.2]))
    for field in writer.fields:
        np.testing.assert_array_equal(getattr(once, field), getattr(twice, field))
    np.testing.assert_array_equal(ARM.body_mass, load(DOUBLE_PENDULUM).body_mass)


def test_rows_are_written_models():
    """Field by field, row m of `rows` is the model that `write` makes of vector m."""
    space = ParameterSpace(
        [
            Parameter("body_mass", "lower", 0.5, 2),
            Parameter("opt.density", None, 0, 9),
            Parameter("opt.wind", None, 0, 1),
        ]
    )
    writer = ModelWriter(ARM, space)
    xi = space.uniform(4, np.random.default_rng(0))
    rows = writer.rows(xi)
    assert {"body_mass", "body_inertia", "dof_invweight0", "opt.density", "opt.wind"} <= rows.keys()
    for m, vector in enumerate(xi):
        model = copy.copy(ARM)
        writer.write(model, vector)
        for field, values in rows.items():
            own = getattr(model.opt, field[4:]) if field.startswith("opt.") else getattr(model, field)
            np.testing.assert_array_equal(values[m], own)


def test_nominal_values_are_the_nominal_model():
    """A parameter at the model's own value gives the model's own motion, bit for bit."""
    space = ParameterSpace([Parameter("body_mass", "lower", 0.1, 2), Parameter("dof_damping", 0, 0, 2, relative=True)])
    sim = MujocoSimulator(ARM, space)
    windows = make_windows(ARM, 3, 5)
    predicted = sim.predict([[ARM.body_mass[2], 1.0]], windows)[0]
    for n in range(3):
        np.testing.assert_array_equal(predicted[n], plain_rollout(sim.model, windows.start[n], windows.ctrl[n], 1))


@pytest.mark.parametrize(
    ("parameter", "text"),
    [
        (Parameter("mass", "lower", 0, 1), "'mass' is no real-valued mjModel field of an element; or an effect: actua"),
        (Parameter("body_weight", "lower", 0, 1), "fields of that family: .*body_mass"),
        (Parameter("body_parentid", "lower", 0, 1), "'body_parentid' is no real-valued mjModel field"),
        (Parameter("nosuch.torque", "elbow", 0, 1), "or an effect: .*coulomb_friction"),
        (Parameter("body_mass", "wrist", 0, 1), "body_mass:wrist: the model has no body 'wrist'; it has: world, upper"),
        (Parameter("body_mass", None, 0, 1), "give a target, the body it belongs to; the model has: world, upper"),
        (Parameter("dof_damping", "lower", 0, 1), "no joint 'lower'; it has: shoulder, elbow"),
        (Parameter("tendon_damping", "x", 0, 1), "no tendon 'x'; it has: no tendon at all"),
        (Parameter("body_mass", "lower", 0, 1, component=1), "one number per element, so component must be 0"),
        (Parameter("geom_friction", 1, 0, 1, component=3), "geom_friction has 3 numbers, so component must be below 3"),
        (Parameter("opt.gravity", None, 0, 1, component=3), "opt.gravity has 3 numbers, so component must be below 3"),
        (Parameter("opt.gravity", "world", 0, 1), "an option belongs to no element; leave the target out"),
        (Parameter("opt.graviti", None, 0, 1), "'opt.graviti' is no real-valued option; MuJoCo has: .*opt.gravity"),
        (Parameter("opt.solver", None, 0, 1), "'opt.solver' is no real-valued option"),
        (
            Parameter("opt.timestep", None, 0.001, 0.01),
            r"^opt.timestep: the timestep is no parameter, because control steps and delays are counted in the model's "
            r"own \(0.002 s\); set it in the model",
        ),
        (Parameter("dof_invweight0", "elbow", 0, 1), "MuJoCo derives dof_invweight0 from other fields; vary those"),
        (
            Parameter("dof_frictionloss", "elbow", 0, 1, relative=True),
            "the model's own value is 0, so it cannot be scal",
        ),
        (Parameter("body_mass", "world", 0, 1), "no inertia that could be scaled along: world. Name the other"),
    ],
)
def test_unusable_parameters_are_refused(parameter, text):
    """The message names the parameter, what is wrong, and what the model has."""
    with pytest.raises(BadParameter, match=text):
        ModelWriter(ARM, ParameterSpace([parameter]))


@pytest.mark.parametrize(
    ("first", "second", "field"),
    [
        (Parameter("body_mass", "lower", 0.5, 1), Parameter("body_mass", 2, 0.5, 2), "body_mass"),
        (Parameter("dof_damping", "*", 0, 1), Parameter("dof_damping", "elbow", 0, 1), "dof_damping"),
        (
            Parameter("opt.gravity", None, 0, 1, component=2),
            Parameter("opt.gravity", None, 0, 2, component=2, name="g"),
            "opt.gravity",
        ),
        (Parameter("opt.density", None, 0, 1), Parameter("opt.density", None, 0, 2, name="rho"), "opt.density"),
        (Parameter("body_inertia", 2, 0.1, 1, component=1), Parameter("body_mass", "lower", 0.5, 2), "body_inertia"),
    ],
)
def test_overlapping_parameters_are_refused(first, second, field):
    """Two parameters may not write one number: the second would silently win."""
    with pytest.raises(BadParameter, match=f"both write {field}; drop one or split the targets"):
        ModelWriter(ARM, ParameterSpace([first, second]))


def test_the_options_on_offer_are_real_valued():
    """Whole numbers (solver, iterations) and the timestep cannot be parameters and are not offered."""
    with pytest.raises(BadParameter) as error:
        ModelWriter(ARM, ParameterSpace([Parameter("opt.graviti", None, 0, 1)]))
    offered = str(error.value).partition("MuJoCo has: ")[2].split(", ")
    assert {"opt.gravity", "opt.wind", "opt.density", "opt.viscosity"} < set(offered)
    assert not {"opt.timestep", "opt.solver", "opt.iterations"} & set(offered)


def test_the_command_range_of_an_actuator_after_one_with_several_commands():
    """Command ranges are counted by command, not by actuator: the right motor's range is written."""
    model = load(
        DOUBLE_PENDULUM.replace(
            '<motor joint="shoulder" gear="3"/>', '<pid name="pid" joint="shoulder" kp="5" kv="1"/>'
        ).replace('name="elbow_motor" joint="elbow"', 'name="elbow_motor" joint="elbow" ctrlrange="-3 3"')
    )
    changed = write(model, [Parameter("actuator_ctrlrange", "elbow_motor", 0.5, 2, component=1)], [1.5])
    np.testing.assert_array_equal(changed.actuator_ctrlrange[:-1], model.actuator_ctrlrange[:-1])
    np.testing.assert_array_equal(changed.actuator_ctrlrange[-1], [-3.0, 1.5])
    assert model.nu == 3


def test_neighbours_do_not_overlap():
    """Another component, another element, or a mass that leaves the inertia alone."""
    parameters = [
        Parameter("body_inertia", 2, 0.01, 1),
        Parameter("body_inertia", 2, 0.01, 1, component=2),
        Parameter("body_mass", 2, 0.5, 2, scale_inertia=False),
        Parameter("body_mass", 1, 0.5, 2),
    ]
    assert len(ModelWriter(ARM, ParameterSpace(parameters)).rows(np.ones((2, 4)))["body_mass"]) == 2


def test_what_mujoco_refuses_is_a_bad_parameter():
    """The centre of mass of a free body that was compiled as simple: MuJoCo's own words, not its exception."""
    simple = load(FREE_BOX.replace('pos="0.01 0 0"', 'pos="0 0 0"'))
    with pytest.raises(BadParameter, match=r"body_ipos:box: MuJoCo refuses the model .* use body/simple='false'"):
        ModelWriter(simple, ParameterSpace([Parameter("body_ipos", "box", 0.0, 0.1)]))


INERT = BLOCK.replace(
    "</worldbody>",
    '<body name="lamp" pos="0 0 2"><geom size="0.1"/></body>'
    '<body name="top" pos="0 0 3"><joint name="hook" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.3"/></body>'
    "</worldbody>",
)


@pytest.mark.parametrize(
    "parameter",
    [
        Parameter("geom_friction", "floor", 0.05, 0.4),  # the box's 0.5 is larger
        Parameter("body_mass", "lamp", 0.5, 2.0),  # fixed to the world
        Parameter("geom_friction", "box", 0.6, 0.9, component=2),  # rolling friction of a sliding contact
        Parameter("jnt_range", "hook", -1.0, 1.0),  # the joint has no limit
        Parameter("actuator_ctrlrange", "push", 1.0, 2.0, component=1),  # nor has the motor
        Parameter("geom_rgba", "box", 0.1, 0.9),
        Parameter("body_mass", "top", 0.5, 2.0),  # a passive pendulum's motion does not depend on its mass
    ],
)
def test_parameters_that_change_nothing_are_refused(parameter):
    """Nothing could be learned about them; they are found by simulating, and let through on request."""
    model = load(INERT)
    with pytest.raises(BadParameter, match=r"changes nothing in 8 random motions of 1000 steps. Typical causes"):
        MujocoSimulator(model, ParameterSpace([parameter]))
    MujocoSimulator(model, ParameterSpace([parameter]), check_influence=False)
    both = ParameterSpace([Parameter("body_mass", "block", 1.0, 3.0), parameter])
    with pytest.raises(BadParameter, match=rf"^{parameter.name.replace('[', '.').replace(']', '.')} \("):
        MujocoSimulator(model, both)


def test_parameters_that_matter_only_through_another_are_accepted():
    """Where a spring rests is nothing without stiffness: the other parameters stand inside their bounds."""
    rest = Parameter("qpos_spring", "hinge", -0.5, 0.5)
    with pytest.raises(BadParameter, match="changes nothing"):
        MujocoSimulator(load(PENDULUM), ParameterSpace([rest]))
    MujocoSimulator(load(PENDULUM), ParameterSpace([rest, Parameter("jnt_stiffness", "hinge", 0.0, 5.0)]))


def test_one_parameter_of_an_effect_that_matters_excuses_the_others():
    """A planar pendulum feels no roll of its base; a force on what is fixed to the world moves nothing."""
    tilt = effect("gravity_tilt", roll=(-0.1, 0.1), pitch=(-0.1, 0.1))
    MujocoSimulator(load(PENDULUM), effects=[tilt])
    with pytest.raises(BadParameter, match=r"^gravity_tilt.roll \(.*gravity_tilt.pitch \(.* changes nothing"):
        MujocoSimulator(load(PENDULUM.replace("<option", "<option gravity='0 0 0'")), effects=[tilt])
    push = effect("external_force", "lamp", **{f"force_{axis}": (-1.0, 1.0) for axis in "xyz"})
    with pytest.raises(BadParameter, match=r"^external_force.force_x:lamp \("):
        MujocoSimulator(load(INERT), effects=[tilt, push])


def test_parameters_that_diverge_everywhere_are_refused():
    """Springs all too stiff for the timestep leave nothing to compare."""
    with pytest.raises(BadParameter, match="every simulation within the bounds diverges; narrow the bounds"):
        MujocoSimulator(load(PENDULUM), ParameterSpace([Parameter("jnt_stiffness", "hinge", 1e15, 1e16)]))


def test_a_parameter_that_diverges_at_one_bound_has_influence():
    """Diverged against not is a difference, whichever bound it is."""
    for low, high in ((-1e7, 0.1), (0.1, 1e12)):
        MujocoSimulator(load(PENDULUM), ParameterSpace([Parameter("jnt_stiffness", "hinge", low, high)]))


def test_values_equal_to_the_models_are_no_parameter():
    """Bounds so narrow that the field keeps its value: the writer says so."""
    value = 1.0
    model = load(PENDULUM.replace('damping="0.1"', 'damping="1"'))
    with pytest.raises(BadParameter, match="no value within its bounds differs from the model's own"):
        # the bounds differ by the smallest float, which the field of single-precision colours cannot hold
        ModelWriter(model, ParameterSpace([Parameter("geom_rgba", "bob", 0.5, np.nextafter(0.5, value))]))


def test_a_space_or_effects_are_needed():
    """Nothing to estimate; and parameters of effects come last."""
    with pytest.raises(BadParameter, match="give a parameter space or at least one effect"):
        MujocoSimulator(load(PENDULUM))
    friction = Parameter("coulomb_friction.torque", "hinge", 0, 1, unit="Nm")
    with pytest.raises(BadEffect, match="parameters of effects must follow all others"):
        MujocoSimulator(load(PENDULUM), ParameterSpace([friction, Parameter("dof_damping", "hinge", 0, 1)]))


def test_mujoco_counts_on_the_same_constants():
    """What set_const derives is what MuJoCo's own batch derives, for a vector of every kind."""
    space = ParameterSpace([Parameter("body_mass", "lower", 0.5, 2), Parameter("dof_armature", "*", 0, 0.2)])
    xi = space.uniform(3, np.random.default_rng(0))
    rows = ModelWriter(ARM, space).rows(xi)
    batch = mujoco.batch.Batch(ARM, 3, 1)
    for field in ("body_mass", "body_inertia", "dof_armature"):
        batch.expand(field)[:] = rows[field]
    batch.set_const()
    for field in ("body_invweight0", "dof_invweight0", "dof_M0", "body_subtreemass", "actuator_acc0"):
        np.testing.assert_array_equal(batch.expanded(field), rows[field])


def test_nominal_values():
    """What the model itself has: 1 for a ratio, NaN where the elements of one parameter differ, neutral effects."""
    space = ParameterSpace(
        [
            Parameter("body_mass", "lower", 0.3, 1.5),
            Parameter("dof_damping", "*", 0.0, 1.0),
            Parameter("dof_damping", "*", 0.5, 2.0, relative=True, name="ratio"),
            Parameter("opt.gravity", None, -11, -9, component=2),
        ]
    )
    without_overlap = [ParameterSpace([p]) for p in space]
    values = [ModelWriter(ARM, one).nominal_values()[0] for one in without_overlap]
    np.testing.assert_array_equal(values, [ARM.body_mass[2], np.nan, 1.0, -9.81])
    friction = effect("stribeck_friction", "elbow", coulomb=(0, 1), static=(0, 1), speed=(0.01, 1))
    sim = MujocoSimulator(ARM, without_overlap[0], [friction])
    windows = make_windows(ARM, 2, 3)
    predicted = sim.predict(sim.nominal(), windows)[0]
    for n in range(2):
        np.testing.assert_array_equal(predicted[n], plain_rollout(sim.model, windows.start[n], windows.ctrl[n], 1))
