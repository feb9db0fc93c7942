"""The key of a system: its faults, how far they show, and how small the gap of the true robot is."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.bench.gap import sizes
from nfpde.bench.gap.faults.base import Fault, Values
from nfpde.bench.gap.nominal import Free
from nfpde.bench.gap.plant import Plant
from nfpde.bench.gap.record import Run
from nfpde.bench.gap.robots import Robot

Array = NDArray[np.float64]

WINDOWS = 120
"""Windows over which sizes are measured."""

FACTORS = ("scale", "kp_scale", "kv_scale", "ratio")
"""Values that multiply something."""

CHANGE = 0.1
"""Relative change of a true value whose trace is measured."""


@dataclass(frozen=True)
class FaultKey:
    """A fault as the key describes it, and what builds it."""

    effect: str
    target: str
    values: Values
    fault: type[Fault]

    def build(self, values: Values | None = None) -> Fault:
        """A fresh fault, with other values where they are given."""
        return self.fault(self.target, self.values if values is None else values)


def measure(
    xml: str,
    robot: Robot,
    free: Sequence[Free],
    faults: Sequence[FaultKey],
    truth: Plant,
    runs: Sequence[Run],
    rng: np.random.Generator,
) -> dict[str, Any]:
    """The key of a recorded system, as plain JSON values.

    `size` of a fault is the root mean square, over windows of ten steps and all channels, of what the fault changes
    over the spread of the noise, after the free constants have taken what they can; `raw_size` is before that.
    `noise_floor` and `floor_by_step` are the shares of the nominal model's gap that the true robot leaves, predicted
    from states as they were measured: over ten steps, and at each step. A smoother of the states can be below.

    `visible` says for each true value what a change by a tenth of its scale does, in the same unit, that neither the
    free constants nor the other true values could do as well.
    """
    base = {f.constant: f.true for f in free}
    at = sizes.windows(runs, WINDOWS, rng)
    nominal, sound = Plant(xml, robot.control_dt), Plant(xml, robot.control_dt, base)
    floor, spread = sizes.floor_of(truth, at)
    before = sizes.predict(nominal, at, sizes.from_reading, clean=False, steps=sizes.FAR)
    by_step = sizes.floor_by_step(floor, before, at)
    floor, spread, before = floor[:, : sizes.HORIZON], spread[: sizes.HORIZON], before[:, : sizes.HORIZON]
    scale = np.maximum(np.sqrt((before**2).mean(0)), spread)
    gaps = {
        "nominal": sizes.gap(before, scale),
        "true_constants": sizes.gap(sizes.predict(sound, at, sizes.from_reading, clean=False), scale),
        "true": sizes.gap(floor, scale),
    }
    answers = list(_answers(xml, robot, free, base, at))
    described = []
    for i, fault in enumerate(faults):
        rest = [f.build() for j, f in enumerate(faults) if j != i]
        lacking = Plant(xml, robot.control_dt, base, rest)
        errors = sizes.predict(lacking, at, sizes.without(i), clean=True)
        described.append(
            {
                "effect": fault.effect,
                "target": fault.target,
                "reading": fault.fault.reading,
                "values": fault.values,
                "scales": scales(fault.values),
                "size": sizes.size(errors, spread, answers),
                "raw_size": sizes.size(errors, spread),
                "visible": {},
            }
        )
        if "delay" in fault.values:  # its trace is in proportion to it
            described[-1]["visible"]["delay"] = CHANGE * described[-1]["size"]
    traces = _traces(xml, robot, base, faults, at)
    for (i, name), trace in traces.items():
        others = [other for key, other in traces.items() if key != (i, name)]
        described[i]["visible"][name] = sizes.size(trace, spread, [*answers, *others])
    model = nominal.model
    moved = {model.actuator(i).name: model.joint(model.actuator_trnid[i, 0]).name for i in range(model.nactuator)}
    return {
        "schema": 1,
        "robot": robot.name,
        "faults": described,
        "gap": gaps,
        "noise_floor": sizes.share(gaps["true"], gaps["nominal"]),
        "floor_by_step": by_step,
        "windows": len(at.starts),
        "actuators": moved,
        "bodies": {model.body(b).name: _carrier(model, b) for b in range(1, model.nbody)},
    }


def _carrier(model: mujoco.MjModel, body: int) -> str:
    """The joint that moves a body relative to what carries it."""
    while body and not model.body_jntnum[body]:
        body = int(model.body_parentid[body])
    last = int(model.body_jntadr[body] + model.body_jntnum[body] - 1)
    return model.joint(last).name if body else "world"


def _answers(
    xml: str, robot: Robot, free: Sequence[Free], base: dict[Any, float], at: sizes.Windows
) -> Iterator[Array]:
    """What a small change of each free constant does to the predictions of the robot without faults."""
    if not free:
        return
    reference = sizes.predict(Plant(xml, robot.control_dt, base), at, sizes.from_clean, clean=True)
    for f in free:
        moved = {**base, f.constant: f.true * 1.02}
        yield sizes.predict(Plant(xml, robot.control_dt, moved), at, sizes.from_clean, clean=True) - reference


def scales(values: Values) -> dict[str, float]:
    """What an error of each true value is measured in.

    A number: its size. A factor, which would be 1 without the fault: its distance from 1. A vector, and roll with
    pitch: its length. The rest angle of a spring: at least 0.3 rad.
    """
    found = {}
    for name, value in values.items():
        if isinstance(value, list):
            found[name] = float(np.linalg.norm(value))
        elif name in FACTORS:
            found[name] = abs(value - 1)
        elif name in ("roll", "pitch"):
            found[name] = float(np.hypot(values["roll"], values["pitch"]))
        else:
            found[name] = max(abs(value), 0.3 if name == "rest" else 0.0)
    return found


def _changes(values: Values) -> Iterator[tuple[str, Values]]:
    """Every number of the values, changed by a tenth of its scale."""
    scale = scales(values)
    for name, value in values.items():
        if isinstance(value, list):
            for i in range(len(value)):
                changed = copy.deepcopy(values)
                changed[name][i] += CHANGE * scale[name]
                yield f"{name}[{i}]", changed
        else:
            yield name, {**values, name: value + CHANGE * scale[name]}


def _traces(
    xml: str, robot: Robot, base: dict[Any, float], faults: Sequence[FaultKey], at: sizes.Windows
) -> dict[tuple[int, str], Array]:
    """What a change of each true value does to the predictions of the true robot; of delays, nothing is said.

    Another delay has another memory, so that it cannot start from the same moments.
    """
    found = {}
    for i, fault in enumerate(faults):
        for name, values in _changes(fault.values):
            if name == "delay":
                continue
            built = [f.build(values if j == i else None) for j, f in enumerate(faults)]
            other = Plant(xml, robot.control_dt, base, built)
            found[i, name] = sizes.predict(other, at, sizes.from_clean_moment, clean=True)
    return found
