"""Draw systems: a robot, its hidden faults, its recordings; what the diagnosis may see, and the key.

python -m nfpde.bench.gap.draw --seed 1000 --count 20 --out systems --keys keys
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.bench.gap.catalog import EFFECTS, OUTSIDERS, Entry
from nfpde.bench.gap.excite import controller
from nfpde.bench.gap.faults.base import Fault, Values
from nfpde.bench.gap.key import FaultKey, measure
from nfpde.bench.gap.nominal import Free, free_constants, nominal_model
from nfpde.bench.gap.pilot import Pilot, channels_of, pilot_of
from nfpde.bench.gap.plant import Plant
from nfpde.bench.gap.record import Noise, Run, episode, start_of
from nfpde.bench.gap.robots import ROBOTS, Robot
from nfpde.bench.gap.store import write_key, write_public

Array = NDArray[np.float64]

KINDS = {"one": 12, "none": 3, "two": 3, "outsider": 2}
"""Systems of each kind among as many consecutive ones as there are in all, in random order: left to chance, a table of
200 may hold ten sound robots where thirty are meant."""

SMALLEST = 0.1
"""Least size of a fault over the noise (root mean square over windows); smaller ones are drawn again."""

ATTEMPTS = 40

CONFLICTS = ({"gap", "limit"}, {"gap", "friction"}, {"gap", "drive"})
"""Families whose faults work on the same part of a drive here, besides equal ones."""


@dataclass(frozen=True)
class Hidden:
    """A fault before it is built: name in the vocabulary or among the outsiders, place, values, and how it is meant."""

    effect: str
    target: str
    values: Values
    fault: type[Fault] | None = None

    @property
    def meant(self) -> type[Fault]:
        """What does it: the plain reading where none was chosen."""
        return self.fault or entry(self.effect).fault

    def build(self) -> Fault:
        """A fresh fault."""
        return self.meant(self.target, self.values)


@dataclass(frozen=True)
class System:
    """A drawn system.

    Attributes:
        robot: the robot.
        xml: the model that its user has.
        free: constants that may be fitted, with their true values.
        hidden: the faults.
        runs: the recordings.
        key: everything that a scorer needs, as plain JSON values.
    """

    robot: Robot
    xml: str
    free: list[Free]
    hidden: list[Hidden]
    runs: list[Run]
    key: dict[str, Any]


def entry(effect: str) -> Entry:
    """The catalogue's entry of a name."""
    return EFFECTS.get(effect) or OUTSIDERS[effect]


def draw_system(seed: int, index: int, kind: str | None = None) -> System:
    """The system of a seed and an index, always the same; of a kind (see `KINDS`), or of the one whose turn it is.

    Effects take turns, too: 28 consecutive indices have 28 different first choices. A draw whose faults do not show in
    the recordings is drawn again, after some attempts with another effect.

    Raises:
        RuntimeError: no attempt gave a fault that shows.
    """
    kind = kind or kind_of_turn(seed, index)
    round_, place = divmod(index, len(EFFECTS))
    first = str(np.random.default_rng([seed, 2, round_, 1]).permutation(list(EFFECTS))[place])
    for attempt in range(ATTEMPTS):
        found = _attempt(
            kind, first if attempt < ATTEMPTS // 2 else None, np.random.default_rng([seed, 3, index, attempt + 1])
        )
        if found is not None:
            found.key.update(seed=seed, index=index, kind=kind, attempts=attempt + 1)
            return found
    raise RuntimeError(f"seed {seed}, index {index}: no fault that shows in {ATTEMPTS} attempts")


def kind_of_turn(seed: int, index: int) -> str:
    """The kind of system whose turn it is at an index."""
    round_, place = divmod(index, sum(KINDS.values()))
    rng = np.random.default_rng([seed, 1, round_, 1])  # streams may not differ by trailing zeros alone
    return str(rng.permutation([kind for kind, count in KINDS.items() for _ in range(count)])[place])


def _attempt(kind: str, first: str | None, rng: np.random.Generator) -> System | None:
    effects = _effects(kind, first, rng)
    robot = _robot(effects, rng)
    if robot is None:
        return None
    xml = nominal_model(robot, rng)
    blank = Plant(xml, robot.control_dt)
    places = [entry(effect).places(blank.model, robot) for effect in effects]
    targets = [str(rng.choice(where)) for where in places]
    free = _free(blank, effects, targets, rng)
    base = {f.constant: f.true for f in free}
    sound = Plant(xml, robot.control_dt, base)
    seed = int(rng.integers(2**31))
    quiet = Noise(np.zeros(sound.model.nv), np.zeros(sound.model.nv))
    pilot = pilot_of(sound, _record(sound, robot, seed, quiet, most=4))
    (meaning,) = rng.spawn(1)
    hidden = [
        Hidden(
            effect,
            target,
            entry(effect).draw(pilot, robot, target, rng),
            entry(effect).read(blank.model, target, meaning),
        )
        for effect, target in zip(effects, targets, strict=True)
    ]
    noise = _noise(sound, pilot, rng)
    truth = Plant(xml, robot.control_dt, base, [h.build() for h in hidden])
    runs = _record(truth, robot, seed, noise)
    if not all(run.stable and np.abs(run.clean_qvel).max() < 100 for run in runs):
        return None
    faults = [FaultKey(h.effect, h.target, h.values, h.meant) for h in hidden]
    key = measure(xml, robot, free, faults, truth, runs, rng)
    if any(fault["size"] < SMALLEST for fault in key["faults"]):
        return None
    key["noise"] = {"qpos": noise.qpos.tolist(), "qvel": noise.qvel.tolist(), "grain": noise.grain}
    key["free"] = [asdict(f) for f in free]
    return System(robot, xml, free, hidden, runs, key)


def _robot(effects: list[str], rng: np.random.Generator) -> Robot | None:
    """A random one of the robots that have a place for every effect."""
    fits = []
    for robot in ROBOTS.values():
        model = mujoco.MjModel.from_xml_path(str(robot.path))
        if all(entry(effect).places(model, robot) for effect in effects):
            fits.append(robot)
    return fits[int(rng.integers(len(fits)))] if fits else None


def _effects(kind: str, first: str | None, rng: np.random.Generator) -> list[str]:
    if kind == "none":
        return []
    if kind == "outsider":
        return [str(rng.choice(list(OUTSIDERS)))]
    effects = [first or str(rng.choice(list(EFFECTS)))]
    if kind == "two":
        one = EFFECTS[effects[0]].family
        fits = [e for e, x in EFFECTS.items() if x.family != one and {x.family, one} not in CONFLICTS]
        effects.append(str(rng.choice(fits)))
    # sensors come last, so that play and friction are built on what the other faults have left
    return sorted(effects, key=lambda e: (EFFECTS[e].fault.distorts, EFFECTS[e].family == "gap"))


def _free(blank: Plant, effects: list[str], targets: list[str], rng: np.random.Generator) -> list[Free]:
    """Constants that are off, in two systems of three; never one that is itself the fault."""
    if rng.random() > 2 / 3:
        return []
    damped = {t for e, t in zip(effects, targets, strict=True) if e == "viscous_damping"}
    found = free_constants(blank.model, rng)
    return [f for f in found if f.field != "dof_damping" or f.element not in damped]


def _noise(sound: Plant, pilot: Pilot, rng: np.random.Generator) -> Noise:
    """Noise of a share of the motion's spread, none in one system of seven; an encoder's grain in one of five."""
    nv = sound.model.nv
    if rng.random() < 1 / 7:
        return Noise(np.zeros(nv), np.zeros(nv))
    qpos = np.exp(rng.uniform(np.log(1e-4), np.log(3e-3))) * channels_of(pilot.position)
    qvel = np.exp(rng.uniform(np.log(3e-4), np.log(1e-2))) * channels_of(pilot.speed)
    grain = 2 * np.pi / 2 ** int(rng.integers(12, 17)) if rng.random() < 0.2 else 0.0
    return Noise(qpos, qvel, grain)


def _record(plant: Plant, robot: Robot, seed: int, noise: Noise, most: int = 12) -> list[Run]:
    """Four to twelve episodes of 3 to 10 s; the same starts and motions for every plant of a seed."""
    rng = np.random.default_rng(seed)
    bounds = plant.model.actuator_ctrlrange
    runs = []
    for _ in range(int(rng.integers(4, 13))):
        rows = round(float(rng.uniform(3, 10)) / robot.control_dt)
        start = start_of(robot, plant.model, rng)
        control = controller(robot, bounds[:, 0], bounds[:, 1], rows, rng)
        runs.append(episode(plant, robot, start, control, rows, noise, int(rng.integers(2**31))))
        if len(runs) == most:
            break
    return runs


def main() -> None:
    """Write systems and keys to two folders."""
    parser = argparse.ArgumentParser(description="Draw systems with a hidden fault.")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--keys", type=Path, required=True)
    given = parser.parse_args()
    for index in range(given.start, given.start + given.count):
        system = draw_system(given.seed, index)
        name = f"{given.seed}-{index:04d}"
        write_public(system.xml, system.free, system.robot, system.runs, given.out / name)
        write_key(system.key, given.keys / f"{name}.json")
        print(name, flush=True)


if __name__ == "__main__":
    main()
