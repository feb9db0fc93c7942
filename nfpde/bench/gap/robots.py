"""The robots of the benchmark: a model file, what its user may command, and how its recordings start."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

MODELS = Path(__file__).parent / "models"


@dataclass(frozen=True)
class Robot:
    """One robot as its user knows it.

    Attributes:
        name: file name in `models/`.
        control_dt: time between two commands [s].
        home: coordinates the motions vary about, (nq,).
        start: half width of the uniform spread of the start about `home`, (nv,), in tangent space.
        speed: half width of the spread of the starting velocity, (nv,).
        reach: amplitude of each actuator's reference, (nu,): of its command where it is a servo, else of the
            position it is made to track.
        open_torque: amplitude of commands without feedback, (nu,), in units of the command; empty for servos.
        kp: gains of the tracking controller in command units per rad or m, (nu,); empty for servos.
        kd: the same per rad/s or m/s, (nu,).
        driven: column in qpos and in qvel that each tracked actuator moves, (nu,).
        base_command: command that is added always, (nu,); empty for none.
        lift: column of qpos that is the height above the ground, None without a ground.
        spins: joints that turn round and round.
        planar: whether everything happens in the x-z plane.
        frequency: highest frequency of its motions [Hz].
    """

    name: str
    control_dt: float
    home: tuple[float, ...]
    start: tuple[float, ...]
    speed: tuple[float, ...]
    reach: tuple[float, ...]
    open_torque: tuple[float, ...] = ()
    kp: tuple[float, ...] = ()
    kd: tuple[float, ...] = ()
    driven: tuple[int, ...] = ()
    base_command: tuple[float, ...] = ()
    lift: int | None = None
    spins: tuple[str, ...] = ()
    planar: bool = False
    frequency: float = 2.0

    @property
    def contact(self) -> bool:
        """Whether it touches a ground."""
        return self.lift is not None

    @property
    def path(self) -> Path:
        """The model file."""
        return MODELS / f"{self.name}.xml"


_FREE = (0.0, 0.0, 0.0, 0.1, 0.1, 0.8)

ROBOTS = {
    robot.name: robot
    for robot in (
        Robot(
            "pendulum2",
            0.01,
            home=(0.0, 0.0),
            start=(0.8, 1.0),
            speed=(0.5, 0.5),
            reach=(1.0, 1.0),
            open_torque=(2.6, 0.8),
            kp=(14.0, 5.0),
            kd=(1.3, 0.35),
            driven=(0, 1),
            planar=True,
        ),
        Robot(
            "arm3",
            0.01,
            home=(0.0, -0.3, 0.9),
            start=(0.8, 0.5, 0.6),
            speed=(0.2, 0.2, 0.2),
            reach=(1.0, 0.6, 0.8),
            open_torque=(0.25, 0.5, 0.25),
            kp=(2.5, 4.5, 2.5),
            kd=(0.35, 0.55, 0.22),
            driven=(0, 1, 2),
        ),
        Robot(
            "servo4",
            0.02,
            home=(0.0, 0.2, 0.3, 0.0),
            start=(0.5, 0.3, 0.3, 0.4),
            speed=(0.0, 0.0, 0.0, 0.0),
            reach=(0.9, 0.6, 0.7, 0.9),
        ),
        Robot(
            "gantry",
            0.02,
            home=(0.0, 0.0, 0.0),
            start=(0.5, 0.35, 1.5),
            speed=(0.1, 0.2, 0.5),
            reach=(1.0, 4.0),
            spins=("twist",),
            frequency=1.5,
        ),
        Robot(
            "paddle",
            0.01,
            home=(0.0, 0.4),
            start=(1.0, 0.8),
            speed=(0.5, 0.5),
            reach=(1.2, 0.8),
            open_torque=(0.3, 0.5),
            kp=(1.6, 3.0),
            kd=(0.28, 0.3),
            driven=(0, 1),
        ),
        Robot(
            "arm6",
            0.01,
            home=(0.0, 0.2, 0.3, 0.0, 0.4, 0.0),
            start=(0.5, 0.3, 0.3, 0.4, 0.4, 0.4),
            speed=(0.0,) * 6,
            reach=(0.8, 0.5, 0.6, 0.8, 0.8, 1.0),
            frequency=1.5,
        ),
        Robot(
            "hopper",
            0.01,
            home=(0.0, -0.1, -0.55, 1.1),
            start=(0.0, 0.05, 0.15, 0.2),
            speed=(0.1, 0.1, 0.2, 0.2),
            reach=(0.35, 0.55),
            kp=(60.0, 80.0),
            kd=(1.6, 1.6),
            driven=(2, 3),
            planar=True,
            lift=1,
            frequency=2.5,
        ),
        Robot(
            "sled",
            0.01,
            home=(0.0, 0.0, 0.0, 0.0),
            start=(0.2, 0.0, 0.0, 0.4),
            speed=(0.3, 0.0, 0.0, 0.2),
            reach=(0.5, 0.9),
            open_torque=(22.0, 1.6),
            kp=(70.0, 7.0),
            kd=(9.0, 0.7),
            driven=(0, 3),
            planar=True,
            lift=1,
            frequency=1.8,
        ),
        Robot(
            "rover",
            0.02,
            home=(0.0, 0.0, 0.082, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            start=(0.3, 0.3, 0.0, 0.0, 0.0, 2.0, 1.0, 1.0),
            speed=(0.0,) * 8,
            reach=(8.0, 8.0),
            spins=("left", "right"),
            lift=2,
            frequency=1.2,
        ),
        Robot(
            "quad",
            0.02,
            home=(0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0, *(0.5, -1.0) * 4),
            start=(*_FREE, *(0.1,) * 8),
            speed=(0.0,) * 14,
            reach=(0.35, 0.4) * 4,
            base_command=(0.5, -1.0) * 4,
            lift=2,
            frequency=2.0,
        ),
    )
}
"""All robots, by name."""
