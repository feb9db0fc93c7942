"""Which fault stands for which effect, where it may sit, and how large it may be.

Sizes are drawn log-uniform, relative to the motion of the robot without faults, from hardly visible to plain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from nfpde.bench.gap.faults import bodies, commands, drives, friction, outsiders, sensors, world
from nfpde.bench.gap.faults.base import Fault, Values, dof_of, joint_of, kind_of
from nfpde.bench.gap.pilot import Array, Pilot
from nfpde.bench.gap.robots import Robot

Rng = np.random.Generator
Places = Callable[[mujoco.MjModel, Robot], list[str]]
Draw = Callable[[Pilot, Robot, str, Rng], Values]


@dataclass(frozen=True)
class Entry:
    """One effect of the vocabulary, or one that it lacks.

    Attributes:
        fault: what does it here.
        places: targets that it may have on a robot.
        draw: random true values.
        family: effects of one family are never paired: their traces are alike.
        others: what else engineers mean by the name.
    """

    fault: type[Fault]
    places: Places
    draw: Draw
    family: str
    others: tuple[type[Fault], ...] = ()

    def read(self, model: mujoco.MjModel, target: str, rng: Rng) -> type[Fault]:
        """The fault in one of its readings, half of the time the plain one."""
        others = [fault for fault in self.others if fault.differs(model, target)]
        if not others or rng.random() < 0.5:
            return self.fault
        return others[int(rng.integers(len(others)))]


def spread(rng: Rng, low: float, high: float) -> float:
    """A log-uniform number."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def signed(rng: Rng, low: float, high: float) -> float:
    """The same with a random sign."""
    return spread(rng, low, high) * float(rng.choice([-1, 1]))


def direction(rng: Rng, planar: bool) -> Array:
    """A random unit vector (3,), in the x-z plane where nothing else moves."""
    vector = rng.normal(size=3) * (1, not planar, 1)
    return vector / np.linalg.norm(vector)


# ---- places


def actuators(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """Every actuator."""
    return [model.actuator(i).name for i in range(model.nactuator)]


def actuators_or_all(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """Every actuator, and as often all together."""
    names = actuators(model, robot)
    return names + ["all"] * len(names)


def of_kind(*kinds: str) -> Places:
    """Actuators of some kinds."""

    def places(model: mujoco.MjModel, robot: Robot) -> list[str]:
        return [model.actuator(i).name for i in range(model.nactuator) if kind_of(model, i) in kinds]

    return places


def geared(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """Actuators of joints that have a rotor."""
    names = actuators(model, robot)
    return [n for n in names if model.dof_armature[model.jnt_dofadr[joint_of(model, n)]] > 0]


def joints(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """Joints with bearings: all but those that stand for a free body."""
    found = [j for j in range(model.njnt) if model.dof_damping[model.jnt_dofadr[j]] > 0]
    return [model.joint(j).name for j in found]


def driven_joints(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """Joints with an actuator."""
    return [model.joint(joint_of(model, a)).name for a in actuators(model, robot)]


def hinges(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """Bearings that turn."""
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    return [name for name in joints(model, robot) if model.joint(name).type[0] == hinge]


def moving_bodies(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """Every body but the world."""
    return [model.body(b).name for b in range(1, model.nbody)]


def swinging(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """Bearings that turn to and fro, unlike wheels."""
    return [name for name in hinges(model, robot) if name not in robot.spins]


def only(name: str) -> Places:
    """A single place."""
    return lambda model, robot: [name]


def ground(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """The ground, where there is one."""
    return ["contact"] if robot.contact else []


def windy(model: mujoco.MjModel, robot: Robot) -> list[str]:
    """The air, where the model has any."""
    return ["world"] if model.opt.density > 0 else []


# ---- sizes


def _delay(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    dt = p.model.opt.timestep
    return {"delay": max(round(spread(rng, 0.2, 4) * robot.control_dt / dt), 1) * dt}


def _dof(p: Pilot, actuator: str) -> int:
    return int(p.model.jnt_dofadr[joint_of(p.model, actuator)])


def _command(p: Pilot, actuator: str) -> float:
    return float(p.command[p.model.actuator(actuator).id])


def _servo_gain(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    kv = float(np.exp(signed(rng, 0.06, 0.7)))
    if kind_of(p.model, p.model.actuator(target).id) == "velocity":
        return {"kv_scale": kv}
    return {"kp_scale": float(np.exp(signed(rng, 0.04, 0.5))), "kv_scale": kv}


def _limit(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    return {"limit": float(p.top_torque[_dof(p, target)] * rng.uniform(0.3, 0.9))}


def _motor_curve(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    dof = _dof(p, target)
    return {
        "no_load_speed": float(p.top_speed[dof] * spread(rng, 0.8, 2.5)),
        "stall_torque": float(p.top_torque[dof] * rng.uniform(0.8, 1.5)),
    }


def _torque(p: Pilot, joint: str, rng: Rng, low: float, high: float) -> float:
    return float(p.torque[dof_of(p.model, joint)]) * spread(rng, low, high)


def _stribeck(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    coulomb = _torque(p, target, rng, 0.03, 0.3)
    speed = float(p.speed[dof_of(p.model, target)]) * spread(rng, 0.03, 0.3)
    return {"coulomb": coulomb, "static": coulomb * float(rng.uniform(1.4, 2.6)), "speed": speed}


def _spring(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    dof, at = dof_of(p.model, target), p.model.joint(target).qposadr[0]
    stiffness = _torque(p, target, rng, 0.04, 0.6) / float(p.position[dof])
    return {"stiffness": stiffness, "rest": float(robot.home[at] + p.position[dof] * rng.uniform(-1.5, 1.5))}


def _grease(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    return {"damping": _torque(p, target, rng, 0.03, 0.6) / float(p.speed[dof_of(p.model, target)])}


def _payload(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    body = p.model.body(target)
    along = body.ipos + rng.uniform(-1, 1, 3) * extent(p.model, target) * (1, not robot.planar, 1)
    return {"mass": float(body.mass[0]) * spread(rng, 0.05, 0.6), "position": [float(x) for x in along]}


def extent(model: mujoco.MjModel, body: str) -> Array:
    """Half widths (3,) of a box about the body's geoms, seen from its centre of mass [m], at least 2 cm."""
    b = model.body(body).id
    sizes = [np.full(3, 0.02)]
    for g in np.flatnonzero(model.geom_bodyid == b):
        sizes.append(np.abs(model.geom_pos[g] - model.body_ipos[b]) + 0.4 * model.geom_rbound[g])
    return np.max(sizes, 0)


def _shift(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    length = float(np.linalg.norm(extent(p.model, target))) * spread(rng, 0.05, 0.5)
    return {"shift": [float(x) for x in length * direction(rng, robot.planar)]}


def _force(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    weight = 9.81 * float(p.model.body_subtreemass[p.model.body(target).id])
    return {"force": [float(x) for x in weight * spread(rng, 0.02, 0.3) * direction(rng, robot.planar)]}


def _tilt(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    size, angle = spread(rng, 0.01, 0.15), rng.uniform(0, 2 * np.pi)
    if robot.planar:
        return {"roll": 0.0, "pitch": size * float(rng.choice([-1, 1]))}
    return {"roll": float(size * np.cos(angle)), "pitch": float(size * np.sin(angle))}


def _friction(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    now = float(p.model.geom_friction[p.model.geom("floor").id, 0])
    return {"friction": now * float(np.exp(-spread(rng, 0.08, 1.2) if rng.random() < 0.7 else spread(rng, 0.08, 0.5)))}


def _softness(p: Pilot, robot: Robot, target: str, rng: Rng) -> Values:
    now = float(p.model.geom_solref[p.model.geom("floor").id, 0])
    return {"time_constant": now * spread(rng, 1.4, 5), "damping_ratio": float(rng.uniform(0.4, 1.2))}


EFFECTS: dict[str, Entry] = {
    "actuation_delay": Entry(commands.DeadTime, actuators_or_all, _delay, "timing"),
    "actuator_lag": Entry(
        commands.Lag, actuators_or_all, lambda p, r, t, g: {"time_constant": spread(g, 0.3, 6) * r.control_dt}, "timing"
    ),
    "motor_strength": Entry(
        drives.Strength,
        actuators,
        lambda p, r, t, g: {"scale": 1 + signed(g, 0.03, 0.35)},
        "drive",
        (drives.AimedShort,),
    ),
    "actuator_bias": Entry(
        commands.Bias, actuators, lambda p, r, t, g: {"offset": _command(p, t) * signed(g, 0.02, 0.4)}, "offset"
    ),
    "torque_limit": Entry(drives.TorqueLimit, actuators, _limit, "limit"),
    "torque_speed": Entry(drives.TorqueSpeed, actuators, _motor_curve, "limit"),
    "dead_zone": Entry(
        commands.DeadZone,
        of_kind("torque", "velocity"),
        lambda p, r, t, g: {"half_width": _command(p, t) * spread(g, 0.03, 0.5)},
        "gap",
        (commands.Gate,),
    ),
    "backlash": Entry(
        drives.GearPlay,
        geared,
        lambda p, r, t, g: {"width": min(float(p.position[_dof(p, t)]), 0.6) * spread(g, 0.01, 0.2)},
        "gap",
        (drives.DraggedGearPlay,),
    ),
    "servo_gain": Entry(drives.ServoGain, of_kind("position", "velocity"), _servo_gain, "drive"),
    "coulomb_friction": Entry(
        friction.DryFriction, joints, lambda p, r, t, g: {"torque": _torque(p, t, g, 0.02, 0.5)}, "friction"
    ),
    "stribeck_friction": Entry(friction.Stribeck, joints, _stribeck, "friction"),
    "load_friction": Entry(
        friction.LoadFriction,
        driven_joints,
        lambda p, r, t, g: {"base": _torque(p, t, g, 0.02, 0.2), "share": spread(g, 0.06, 0.4)},
        "friction",
    ),
    "viscous_damping": Entry(bodies.Grease, joints, _grease, "friction"),
    "joint_spring": Entry(bodies.Spring, swinging, _spring, "offset"),
    "armature": Entry(
        bodies.RotorInertia,
        driven_joints,
        lambda p, r, t, g: {"inertia": float(p.inertia[dof_of(p.model, t)]) * spread(g, 0.03, 1)},
        "inertia",
    ),
    "joint_offset": Entry(
        sensors.EncoderZero,
        swinging,
        lambda p, r, t, g: {"offset": signed(g, 0.01, 0.15)},
        "offset",
        (sensors.LoggedZero,),
    ),
    "sensor_scale": Entry(
        sensors.EncoderScale,
        hinges,
        lambda p, r, t, g: {"scale": 1 + signed(g, 0.01, 0.15)},
        "sensor",
        (sensors.LoggedScale, sensors.LoggedPositionScale),
    ),
    "payload": Entry(bodies.Payload, moving_bodies, _payload, "inertia"),
    "com_shift": Entry(bodies.MassMoved, moving_bodies, _shift, "inertia"),
    "external_force": Entry(bodies.SteadyForce, moving_bodies, _force, "offset"),
    "gravity_tilt": Entry(world.Tilt, only("world"), _tilt, "offset"),
    "fluid_drag": Entry(
        world.Fluid,
        only("world"),
        lambda p, r, t, g: {"density": spread(g, 5, 600), "viscosity": spread(g, 0.02, 1)},
        "fluid",
    ),
    "wind": Entry(
        world.Wind,
        windy,
        lambda p, r, t, g: {"velocity": [float(x) for x in spread(g, 0.5, 8) * direction(g, r.planar)]},
        "fluid",
    ),
    "ground_friction": Entry(world.Slippery, ground, _friction, "ground"),
    "contact_softness": Entry(world.Soft, ground, _softness, "ground"),
    "ground_height": Entry(world.Raised, ground, lambda p, r, t, g: {"height": signed(g, 0.001, 0.02)}, "ground"),
    "observation_delay": Entry(sensors.LateReading, only("all"), _delay, "timing"),
    "time_scale": Entry(
        sensors.WrongClock,
        only("all"),
        lambda p, r, t, g: {"ratio": 1 + signed(g, 0.004, 0.1)},
        "timing",
        (sensors.CountingClock,),
    ),
}
"""The vocabulary of the diagnosis."""


def _joint_torque(low: float, high: float) -> Draw:
    return lambda p, r, t, g: {"torque": _torque(p, t, g, low, high)}


OUTSIDERS: dict[str, Entry] = {
    "cogging": Entry(
        outsiders.Cogging,
        hinges,
        lambda p, r, t, g: {"torque": _torque(p, t, g, 0.15, 0.8), "teeth": int(g.integers(5, 13))},
        "outsider",
    ),
    "magnet": Entry(
        outsiders.Magnet,
        swinging,
        lambda p, r, t, g: {
            "torque": _torque(p, t, g, 0.3, 1.5),
            "angle": float(r.home[p.model.joint(t).qposadr[0]] + p.position[dof_of(p.model, t)] * g.uniform(-0.8, 0.8)),
            "width": float(p.position[dof_of(p.model, t)] * g.uniform(0.15, 0.35)),
        },
        "outsider",
    ),
    "seizing_up": Entry(outsiders.SeizingUp, joints, _joint_torque(0.4, 1.2), "outsider"),
    "sloshing": Entry(
        outsiders.Sloshing,
        moving_bodies,
        lambda p, r, t, g: {
            "mass": float(p.model.body(t).mass[0]) * spread(g, 0.15, 0.6),
            "length": spread(g, 0.03, 0.15),
        },
        "outsider",
    ),
    "loose_cable": Entry(
        outsiders.LooseCable,
        swinging,
        lambda p, r, t, g: {
            "stiffness": _torque(p, t, g, 1, 4) / float(p.position[dof_of(p.model, t)]),
            "angle": float(r.home[p.model.joint(t).qposadr[0]] + p.position[dof_of(p.model, t)] * g.uniform(0.2, 0.9)),
        },
        "outsider",
    ),
    "repulsion": Entry(
        outsiders.Repulsion,
        swinging,
        lambda p, r, t, g: {
            "stiffness": _torque(p, t, g, 0.4, 1.5) / float(p.position[dof_of(p.model, t)]),
            "angle": float(r.home[p.model.joint(t).qposadr[0]]),
            "reach": float(p.position[dof_of(p.model, t)] * g.uniform(0.5, 0.9)),
        },
        "outsider",
    ),
}
"""Faults that the vocabulary lacks."""
