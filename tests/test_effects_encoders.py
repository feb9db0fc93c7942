"""Effects on what encoders report: what is reported, and what a servo that reads the encoder does."""

from typing import Any

import numpy as np
import pytest

from nfpde.effects import effect
from nfpde.errors import BadEffect
from nfpde.sim import MujocoSimulator
from tests.effect_checks import SERVO_ARM, make, neutral_does_nothing, predict, replaced, rows_are_apart
from tests.models import BALL, load, make_windows, plain_rollout, with_arrays

OFFSETS: dict[str, Any] = {"offset": (-1, 1)}
SCALES: dict[str, Any] = {"scale": (0.5, 2)}


@pytest.mark.parametrize(
    ("name", "bounds", "values"), [("joint_offset", OFFSETS, [[0.1], [-0.4]]), ("sensor_scale", SCALES, [[0.8], [1.3]])]
)
@pytest.mark.parametrize("joint", ["shoulder", "elbow", "wrist"])
def test_neutral_and_rows(name, bounds, values, joint):
    """Neutral rows are untouched by active ones beside them, and rows with other values do not mix."""
    sim = make(name, joint, **bounds)
    neutral_does_nothing(sim, values)
    rows_are_apart(sim, values)


@pytest.mark.parametrize(("joint", "column"), [("shoulder", 0), ("wrist", 2)])
def test_joint_offset_is_that_of_the_encoder_a_servo_reads(joint, column):
    """The arm moves from the true angle; a servo pushes by its reading; the report is the reading."""
    sim = make("joint_offset", joint, **OFFSETS)
    windows = make_windows(sim.model, 3, 10, nsub=4)
    predicted = predict(sim, [[0.3]], windows)[0]
    shift = np.zeros(6)
    shift[column] = 0.3
    for n in range(3):
        sent = windows.ctrl[n].copy()
        if joint == "shoulder":
            sent[:, 0] -= 0.3  # kp (u - (q + 0.3)) = kp ((u - 0.3) - q)
        expected = plain_rollout(sim.model, windows.start[n] - shift, sent, 4) + shift
        np.testing.assert_allclose(predicted[n], expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize(("joint", "column"), [("shoulder", 0), ("elbow", 1), ("wrist", 2)])
def test_sensor_scale_is_that_of_the_encoder_a_servo_reads(joint, column):
    """Position and speed are reported times the scale, and fed back so."""
    sim = make("sensor_scale", joint, **SCALES)
    windows = make_windows(sim.model, 3, 10, nsub=4)
    predicted = predict(sim, [[1.25]], windows)[0]
    factor = np.ones(6)
    factor[[column, 3 + column]] = 1.25
    model = load(SERVO_ARM)
    if joint != "wrist":
        model.actuator_biasprm[column, 1:3] *= 1.25
    for n in range(3):
        expected = plain_rollout(model, windows.start[n] / factor, windows.ctrl[n], 4) * factor
        np.testing.assert_allclose(predicted[n], expected, rtol=0, atol=1e-11)


def test_offset_and_gain_compose_in_any_order():
    """A servo gives kp (u - (q + offset)) with twice the kp, whichever effect is named first."""
    chosen = [
        effect("joint_offset", "shoulder", **OFFSETS),
        effect("servo_gain", "shoulder_servo", kp_scale=(0.1, 9), kv_scale=(0.1, 9)),
    ]
    firm = load(replaced('kp="40"', 'kp="80"'))
    shift = np.array([0.3, 0, 0, 0, 0, 0])
    for order, values in (([0, 1], [0.3, 2.0, 1.0]), ([1, 0], [2.0, 1.0, 0.3])):
        sim = MujocoSimulator(load(SERVO_ARM), None, [chosen[i] for i in order])
        windows = make_windows(sim.model, 2, 10, nsub=4)
        sent = windows.ctrl - np.array([0.3, 0, 0])
        for n, predicted in enumerate(predict(sim, [values], windows)[0]):
            expected = plain_rollout(firm, windows.start[n] - shift, sent[n], 4) + shift
            np.testing.assert_allclose(predicted, expected, rtol=0, atol=1e-11)


ZONE = effect("dead_zone", "shoulder_servo", half_width=(0, 1))
ENCODERS = [("joint_offset", OFFSETS, 0.3), ("sensor_scale", SCALES, 1.5)]


@pytest.mark.parametrize(("name", "bounds", "value"), ENCODERS)
def test_dead_zone_and_encoder_compose_in_any_order(name, bounds, value):
    """The loop by hand: the zone takes the middle out of the command less the reading, which the servo acts on."""
    xml = replaced('kp="40"', 'kp="40" gear="1.2"')
    model = load(xml)
    zero, scale = (value, 1.0) if name == "joint_offset" else (0.0, value)
    model.actuator_biasprm[0, 1:3] *= scale
    model.actuator_biasprm[0, 0] = -40 * 1.2 * zero
    factor, shift = np.ones(6), np.array([zero, 0, 0, 0, 0, 0])
    factor[[0, 3]] = scale
    for order, values in (([0, 1], [0.3, value]), ([1, 0], [value, 0.3])):
        chosen = [ZONE, effect(name, "shoulder", **bounds)]
        sim = MujocoSimulator(load(xml), None, [chosen[i] for i in order])
        windows = make_windows(sim.model, 3, 10, nsub=4)
        for n, predicted in enumerate(predict(sim, [values], windows)[0]):
            sent = iter(windows.ctrl[n, :, 0].repeat(4))

            def send(model, data, sent=sent):
                reading = 1.2 * (scale * data.qpos[0] + zero)
                error = next(sent) - reading
                data.ctrl[0] = reading + error - np.clip(error, -0.3, 0.3)

            start = (windows.start[n] - shift) / factor
            expected = plain_rollout(model, start, windows.ctrl[n].repeat(4, axis=0), 1, send)[3::4]
            np.testing.assert_allclose(predicted, expected * factor + shift, rtol=0, atol=1e-11)


@pytest.mark.parametrize(("name", "bounds", "value"), ENCODERS)
def test_a_servo_rests_where_its_encoder_reads_the_command(name, bounds, value):
    """Without gravity nothing moves as long as the reading stays within the dead zone of the command."""
    xml = replaced('timestep="0.002"', 'timestep="0.002" gravity="0 0 0"')
    # an offset shows nowhere here: neither in what gravity does nor in the error of the servo
    sim = MujocoSimulator(load(xml), None, [ZONE, effect(name, "shoulder", **bounds)], check_influence=False)
    windows = make_windows(sim.model, 1, 200)
    start = np.array([0.8, 0, 0, 0, 0, 0])
    ctrl = np.zeros_like(windows.ctrl)
    ctrl[..., 0] = 0.85
    windows = with_arrays(windows, state=np.broadcast_to(start, windows.state.shape), ctrl=ctrl)
    still = predict(sim, [[0.1, value]], windows)[0, 0]
    np.testing.assert_allclose(still, np.broadcast_to(start, still.shape), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("name", "bounds"), [("joint_offset", OFFSETS), ("sensor_scale", SCALES)])
def test_encoders_are_those_of_hinges_and_slides(name, bounds):
    """A quaternion has no offset to add to its four numbers."""
    with pytest.raises(BadEffect, match="hinges or slides"):
        make(name, "ball", BALL, **bounds)
