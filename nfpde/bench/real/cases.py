"""Which recordings are diagnosed, and what is known of each from elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco

from nfpde.bench.real.pendulums import double_pendulum, simple_pendulum
from nfpde.bench.real.quadruped import quadruped
from nfpde.bench.real.servo import servo
from nfpde.dataset import Dataset

Loaded = tuple[mujoco.MjModel, Dataset]


@dataclass(frozen=True)
class Case:
    """Recordings of one robot and the model that its makers would begin with.

    Attributes:
        name: of the case.
        place: its folder among the recordings.
        load: from that folder to model and recordings.
        known: what was published about the robot, or measured on it, and the model leaves out.
    """

    name: str
    place: str
    load: Callable[[Path], Loaded]
    known: str


_LINKS = "friction of 0.078 and 0.093 Nm in the joints, and rotors of {:.4f} kg m2 behind their gears"

CASES = (
    Case(
        "double pendulum A.0",
        "double_pendulum",
        lambda folder: double_pendulum(folder, "A.0"),
        _LINKS.format(36 * 7.66e-5),
    ),
    Case(
        "double pendulum C.0",
        "double_pendulum",
        lambda folder: double_pendulum(folder, "C.0"),
        _LINKS.format(36 * 9.94e-5),
    ),
    Case(
        "hobby servo at gain 400",
        "bam_xl330",
        lambda folder: servo(folder, 400),
        "friction that grows with the load; of the motor's constants only rough values",
    ),
    Case(
        "hobby servo at gain 800",
        "bam_xl330",
        lambda folder: servo(folder, 800),
        "friction that grows with the load; of the motor's constants only rough values",
    ),
    Case(
        "simple pendulum under optimal control",
        "simple_pendulum",
        lambda folder: simple_pendulum(folder, "ddp/data_measured.csv"),
        "friction of 0.16 to 0.24 Nm by regression on six seconds",
    ),
    Case(
        "simple pendulum under energy shaping",
        "simple_pendulum",
        lambda folder: simple_pendulum(folder, "energy_shaping/data_measured.csv"),
        "torques of the motor's own estimate, which regression on inertia, weight and friction leaves a third to a "
        "half unexplained",
    ),
    Case(
        "simple pendulum with twice the load",
        "simple_pendulum",
        lambda folder: simple_pendulum(folder, "energy_shaping/data_measured_1kg.csv"),
        "half a kilogram more at the end of the rod; the same torques",
    ),
    Case(
        "quadruped in the air",
        "go2_inair",
        quadruped,
        "nothing; joint friction of 0.2 Nm stands in its makers' model already",
    ),
)
