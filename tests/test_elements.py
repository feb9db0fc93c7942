"""Names and ids of a model's elements."""

import numpy as np
import pytest

from nfpde.elements import actuator_ctrls, element_ids, element_names, joint_dofs, joint_qpos
from nfpde.errors import BadEffect, BadParameter
from tests.models import BALL, DOUBLE_PENDULUM, FREE_BOX, load

ARM = load(DOUBLE_PENDULUM)
PID = load(
    DOUBLE_PENDULUM.replace(
        '<motor joint="shoulder" gear="3"/>', '<pid joint="shoulder" kp="1"/> <motor joint="shoulder" gear="3"/>'
    )
)


def test_names():
    """A nameless actuator goes by its joint's name, anything else by its id."""
    assert element_names(ARM, "body") == ["world", "upper", "lower"]
    assert element_names(ARM, "joint") == ["shoulder", "elbow"]
    assert element_names(ARM, "actuator") == ["shoulder", "elbow_motor"]
    assert element_names(ARM, "geom") == ["upper_arm", "#1"]
    assert element_names(ARM, "tendon") == []


def test_two_nameless_actuators_of_one_joint():
    """A joint's name stands for its first nameless actuator only; the other goes by its id."""
    assert element_names(PID, "actuator") == ["shoulder", "#1", "elbow_motor"]


def test_a_real_name_comes_before_a_borrowed_one():
    """An actuator that is called like another one's joint keeps its name for itself."""
    model = load(DOUBLE_PENDULUM.replace('name="elbow_motor"', 'name="shoulder"'))
    assert element_names(model, "actuator") == ["#0", "shoulder"]


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        ("lower", [2]),
        (1, [1]),
        (np.int64(2), [2]),
        ("#2", [2]),
        (("lower", "#1"), [2, 1]),
        (("upper", 0), [1, 0]),
        ("*", [0, 1, 2]),
    ],
)
def test_targets(target, expected):
    """A name, an id, #id, a tuple of them in their own order, or all."""
    assert element_ids(ARM, "body", target, "x").tolist() == expected


@pytest.mark.parametrize(
    ("target", "text"),
    [
        ("wrist", "here: the model has no body 'wrist'; it has: world, upper, lower"),
        (3, "no body 3"),
        (-1, "no body -1"),
        (True, "no body True"),
        (1.0, "no body 1.0"),
        ("#3", "no body '#3'"),
        ("#-1", "no body '#-1'"),
        (None, "no body None"),
        (("upper", 1), "names one body twice"),
        (("upper", "*"), r"no body '\*'"),
    ],
)
def test_bad_targets_are_refused(target, text):
    """The message says where, what, and what the model has."""
    with pytest.raises(BadParameter, match=text):
        element_ids(ARM, "body", target, "here")


def test_refusals_take_the_class_of_the_caller():
    """An effect's target is refused as BadEffect; a kind that the model lacks altogether, too."""
    with pytest.raises(BadEffect, match="x: the model has no joint 'a'"):
        element_ids(ARM, "joint", "a", "x", BadEffect)
    with pytest.raises(BadEffect, match=r"x: the model has no tendon$"):
        element_ids(ARM, "tendon", "*", "x", BadEffect)
    with pytest.raises(BadEffect, match="it has: no tendon at all"):
        element_ids(ARM, "tendon", "a", "x", BadEffect)


def test_numbers_of_joints():
    """A free joint spans 7 positions and 6 velocities, a ball joint 4 and 3, the others 1 and 1."""
    box, ball = load(FREE_BOX), load(BALL)
    assert joint_dofs(box, np.array([0])).tolist() == [0, 1, 2, 3, 4, 5]
    assert joint_qpos(box, np.array([0])).tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert joint_dofs(ball, np.array([2, 1])).tolist() == [4, 1, 2, 3]
    assert joint_qpos(ball, np.array([2, 1])).tolist() == [5, 1, 2, 3, 4]


def test_commands_of_actuators_with_several():
    """A PID actuator takes a position and a velocity: the commands after it move up."""
    assert (PID.nu, PID.nactuator) == (4, 3)
    assert actuator_ctrls(PID, np.array([2, 0])).tolist() == [3, 0, 1]
    assert actuator_ctrls(ARM, np.array([1])).tolist() == [1]
