"""The model that the user has: a robot's file with masses and dampings of this copy, and what may be off in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from nfpde.bench.gap.plant import ALONE
from nfpde.bench.gap.robots import Robot
from nfpde.parameters import Parameter, ParameterSpace


@dataclass(frozen=True)
class Free:
    """A constant of the model that is off.

    Attributes:
        field: `body_mass` or `dof_damping`.
        element: the body or joint.
        low: lower bound that the user gives.
        high: upper bound.
        nominal: the model's value.
        true: the robot's value.
        follows: whether a body's inertia is off by the same factor as its mass; else it is the model's.
    """

    field: str
    element: str
    low: float
    high: float
    nominal: float
    true: float
    follows: bool = True

    @property
    def constant(self) -> tuple[str, str]:
        """What `Plant` calls it."""
        return self.field if self.follows else ALONE, self.element


def nominal_model(robot: Robot, rng: np.random.Generator) -> str:
    """MJCF of this copy of the robot: every mass and damping a little different from the file's."""
    spec = mujoco.MjSpec.from_file(str(robot.path))
    for geom in spec.geoms:
        if geom.mass > 0:
            geom.mass = float(f"{geom.mass * np.exp(rng.uniform(-0.3, 0.3)):.4g}")
    for joint in spec.joints:
        damping = joint.damping[0] if np.ndim(joint.damping) else joint.damping
        if damping > 0:
            changed = float(f"{damping * np.exp(rng.uniform(-0.4, 0.4)):.3g}")
            joint.damping = [changed, 0, 0] if np.ndim(joint.damping) else changed
    spec.compile()
    return spec.to_xml()


def free_constants(model: mujoco.MjModel, rng: np.random.Generator) -> list[Free]:
    """Two to five masses and dampings that are up to 30 % and 50 % off, with bounds that hold the truth.

    The inertia of one body of two follows its mass, as with other wood; in the others a load sits in the centre.
    """
    (material,) = rng.spawn(1)
    masses = [("body_mass", model.body(b).name, float(model.body_mass[b])) for b in range(1, model.nbody)]
    dampings = [
        ("dof_damping", model.joint(j).name, float(model.dof_damping[model.jnt_dofadr[j]]))
        for j in range(model.njnt)
        if model.dof_damping[model.jnt_dofadr[j]] > 0
    ]
    chosen = [*_some(masses, rng, 1, 3), *_some(dampings, rng, 1, 2)]
    found = []
    for field, element, value in chosen:
        off = 0.3 if field == "body_mass" else 0.5
        true = value * float(rng.uniform(1 - off, 1 + off))
        low, high = value * (1 - off) * float(rng.uniform(0.7, 0.95)), value * (1 + off) * float(rng.uniform(1.05, 1.4))
        alone = field == "body_mass" and material.random() < 0.5
        found.append(Free(field, element, float(f"{low:.3g}"), float(f"{high:.3g}"), value, true, not alone))
    return found


def write_parameters(free: list[Free], path: Path) -> None:
    """Write the `[[parameter]]` tables of the constants that a diagnosis may fit; nothing for none."""
    if free:
        ParameterSpace([Parameter(f.field, f.element, f.low, f.high) for f in free]).to_toml(path)


def _some(
    items: list[tuple[str, str, float]], rng: np.random.Generator, least: int, most: int
) -> list[tuple[str, str, float]]:
    count = min(int(rng.integers(least, most + 1)), len(items))
    return [items[i] for i in sorted(rng.permutation(len(items))[:count])]
