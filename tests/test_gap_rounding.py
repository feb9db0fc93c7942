"""Sensor faults that are smaller than an encoder's step, beside joints that rest."""

from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import effect
from nfpde.gap.fit import Fit
from nfpde.gap.grain import Encoders
from nfpde.gap.replay import Replay
from nfpde.gap.rounding import is_rounding
from tests.test_gap_contacts import BLOCK

STEP, REST = 2e-4, -1e-3
"""Step of the encoder [m] and the reading at rest [m]."""


def fitted(name, target, **values):
    """A fit with one effect at these values."""
    model = mujoco.MjModel.from_xml_string(BLOCK)
    one = effect(name, target, **{k: (v - 1.0, v + 1.0) if v <= 0 else (0.5 * v, 2.0 * v) for k, v in values.items()})
    replay: Any = Replay(model, None, [one])
    unused: Any = None
    xi, none = np.array(list(values.values())), np.zeros(0)
    return one, Fit(replay, xi, 0.0, unused, none, none, none, 0)


def windows(highest=0.0, speed=0.0):
    """States of a block that slides and rests on the floor, and is somewhere else in one row."""
    qpos, qvel = np.column_stack([np.linspace(0.0, 0.3, 20), np.full(20, REST)]), np.full((20, 2), speed)
    qpos[7, 1] += highest
    return Dataset([Episode("a", 0.01 * np.arange(20), qpos, qvel, np.zeros((20, 1)))]).windows(1, stride=1)


def encoders(rests=True):
    """A fine encoder along the floor, a coarse one of the height."""
    rest = np.array([np.nan, REST if rests else np.nan, np.nan, np.nan])
    return Encoders(np.array([1e-6, STEP, 0.0, 0.0]), rest, np.zeros((2, 4)))


@pytest.mark.parametrize(
    ("name", "target", "values", "rounding"),
    [
        ("joint_offset", 1, {"offset": 0.49 * STEP}, True),
        ("joint_offset", 1, {"offset": -0.5 * STEP}, True),
        ("joint_offset", 1, {"offset": 0.6 * STEP}, False),
        ("joint_offset", 0, {"offset": 0.4e-6}, False),  # it moves: rounding averages out
        ("sensor_scale_position", 1, {"scale": 1.05}, True),
        ("sensor_scale_position", 1, {"scale": 1.2}, False),
        ("coulomb_friction", 1, {"torque": 1e-9}, False),
    ],
)
def test_what_moves_readings_at_rest_by_less_than_half_a_step_is_rounding(name, target, values, rounding):
    """Whatever it is; on other joints, and of other effects, nothing is."""
    one, fit = fitted(name, target, **values)
    assert is_rounding(one, fit, windows(), encoders()) is rounding


def test_a_reading_that_is_moved_farther_is_none():
    """A factor is told by one place of the joint that is far from where it rests; an offset is the same everywhere."""
    factor, by_factor = fitted("sensor_scale_position", 1, scale=1.05)
    offset, by_offset = fitted("joint_offset", 1, offset=0.4 * STEP)
    far = windows(highest=0.1)
    assert not is_rounding(factor, by_factor, far, encoders())
    assert is_rounding(offset, by_offset, far, encoders())


def test_a_joint_without_a_reading_at_rest_averages_rounding():
    """However coarse its encoder is."""
    offset, fit = fitted("joint_offset", 1, offset=0.4 * STEP)
    assert not is_rounding(offset, fit, windows(), encoders(rests=False))


def test_a_factor_of_speeds_is_no_rounding():
    """Speeds have no step here; where they are zero it is."""
    factor, fit = fitted("sensor_scale", 1, scale=1.05)
    assert not is_rounding(factor, fit, windows(speed=0.1), encoders())
    assert is_rounding(factor, fit, windows(), encoders())
