"""Judge one diagnosis by the key of its system."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from nfpde.bench.gap.sizes import HORIZON

Json = Mapping[str, Any]

EVERYWHERE = ("", "all", "world", "contact", "floor")
"""Targets of effects that have only one place."""

BY_CONVENTION = ("gravity_tilt", "joint_offset")
"""Effects whose sign is a convention of the axes; their values may all be turned round."""

VISIBLE = 10.0
"""A value counts when a change by a tenth of it shows with at least so many standard errors."""

LEAST_FLOOR = 1e-3
"""A noise floor counts as at least this share of the gap: less cannot be asked of any solver."""


@dataclass
class Row:
    """What came out of one case.

    Attributes:
        index: number of the case.
        kind: "one", "none", "two" or "outsider".
        robot: the robot.
        truth: names of the hidden faults, with their targets.
        sizes: their sizes over the noise.
        status: "done", "time limit" or what failed.
        verdict: of the diagnosis; "" where it failed.
        named: what it named, in its order, with targets.
        right: whether the whole case is right: cause and place, no alarm, both of a pair, "unexplained".
        cause: for one fault: whether the first effect, or its declared set, is the hidden one.
        alone: the same without the set.
        place: for one fault and outsiders: whether the joint or actuator is right, whatever the effect.
        found: for pairs: how many of the two were found, cause and place.
        set_size: effects in the first one's declared set.
        extra: effects that were accepted beyond the hidden ones.
        errors: relative errors of the fitted values that these recordings determine.
        inside: of the same values, whether they lie in the stated 95 % interval.
        base_inside: the same of every free parameter, where the case is right.
        after: gap after the effects over what the true robot leaves, both as shares of the gap before.
        own_after: gap after the effects over the noise floor that the diagnosis itself states.
        seconds: wall time.
        steps: simulated steps.
        device: where it simulated, in its own words; "" where it failed.
        reason: why the case is not right; "" where it is.
    """

    index: int
    kind: str
    robot: str
    truth: list[str]
    sizes: list[float]
    status: str
    verdict: str = ""
    named: list[str] = field(default_factory=list)
    right: bool = False
    cause: bool = False
    alone: bool = False
    place: bool = False
    found: int = 0
    set_size: int = 0
    extra: int = 0
    errors: dict[str, float] = field(default_factory=dict)
    inside: dict[str, bool] = field(default_factory=dict)
    base_inside: dict[str, bool] = field(default_factory=dict)
    after: float | None = None
    own_after: float | None = None
    seconds: float = math.nan
    steps: float = 0.0
    device: str = ""
    reason: str = ""


def judge(key: Json, status: str, seconds: float, diagnosis: Json | None) -> Row:
    """Judge a case.

    Args:
        key: the key of the system.
        status: "done" or why there is no diagnosis.
        seconds: wall time of the diagnosis.
        diagnosis: content of diagnosis.json; None where there is none.
    """
    faults = key["faults"]
    row = Row(
        index=key["index"],
        kind=key["kind"],
        robot=key["robot"],
        truth=[f"{f['effect']} @ {f['target']}" for f in faults],
        sizes=[f["size"] for f in faults],
        status=status,
        seconds=seconds,
    )
    if diagnosis is None:
        row.reason = status
        return row
    try:
        _fill(row, key, diagnosis)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        row.status = row.reason = f"diagnosis.json breaks the contract: {type(error).__name__} {error}"
    return row


def _fill(row: Row, key: Json, diagnosis: Json) -> None:
    effects, faults = diagnosis["effects"], key["faults"]
    row.verdict, row.steps = diagnosis["verdict"], float(diagnosis["simulated_steps"])
    row.device = diagnosis.get("device", "")
    row.named = [f"{e['effect']} @ {e['target']}" for e in effects]
    row.set_size = len(effects[0].get("indistinguishable", ())) + 1 if effects else 0
    row.extra = max(len(effects) - (0 if row.kind in ("none", "outsider") else len(faults)), 0)
    row.after = after_over_floor(key, diagnosis["gap"])
    row.own_after = _own_after(diagnosis["gap"])
    if row.kind == "none":
        row.right = row.verdict == "no_gap" and not effects
        row.reason = "" if row.right else f"alarm: {row.verdict}"
    elif row.kind == "outsider":
        where = diagnosis["where"]
        row.place = bool(where) and _joint(key, where[0]["joint"]) == _joint(key, faults[0]["target"])
        row.right = row.verdict == "unexplained"
        row.reason = "" if row.right else f"verdict {row.verdict}"
    elif row.kind == "one":
        _one(row, key, effects, faults[0])
    else:
        _pair(row, key, effects, faults)
    if row.right and row.kind != "outsider":  # beside what the library lacks parameters have no true value
        row.base_inside = _base_inside(key, diagnosis.get("parameters", {}))


def _base_inside(key: Json, fitted: Json) -> dict[str, bool]:
    true = {f"{free['field']}:{free['element']}": free["true"] for free in key["free"]}
    return {name: v["low"] <= true[name] <= v["high"] for name, v in fitted.items() if name in true}


def _one(row: Row, key: Json, effects: Sequence[Json], fault: Json) -> None:
    if effects:
        first = list(members(effects[0]))
        named = [m for m in first if m["effect"] == fault["effect"]]
        row.cause, row.alone = bool(named), effects[0]["effect"] == fault["effect"]
        row.place = any(same_place(key, fault["target"], m["target"]) for m in named or first)
        if row.alone and same_place(key, fault["target"], effects[0]["target"]):
            row.errors, row.inside = value_errors(key, fault, effects[0])
    row.found = int(row.cause and row.place)
    row.right = row.found == 1
    if not row.right:
        row.reason = "place" if row.cause else "cause" if effects else f"nothing named: {row.verdict}"


def _pair(row: Row, key: Json, effects: Sequence[Json], faults: Sequence[Json]) -> None:
    """Each hidden fault needs an accepted effect of its own."""
    holders = [[i for i, e in enumerate(effects) if _holds(key, e, fault)] for fault in faults]
    one, two = holders
    both = any(i != j for i in one for j in two)
    row.found = 2 if both else int(bool(one)) + int(bool(two)) if not (one and two) else 1
    row.right = both
    for fault, held in zip(faults, holders, strict=True):
        exact = [effects[i] for i in held if effects[i]["effect"] == fault["effect"]]
        if exact:
            errors, inside = value_errors(key, fault, exact[0])
            row.errors.update({f"{fault['effect']}.{name}": e for name, e in errors.items()})
            row.inside.update({f"{fault['effect']}.{name}": e for name, e in inside.items()})
    row.reason = "" if both else f"{row.found} of 2 found, {row.verdict}"


def _holds(key: Json, effect: Json, fault: Json) -> bool:
    return any(
        m["effect"] == fault["effect"] and same_place(key, fault["target"], m["target"]) for m in members(effect)
    )


def members(effect: Json) -> Iterator[Json]:
    """An accepted effect and those that it declares indistinguishable from it."""
    yield effect
    yield from effect.get("indistinguishable", ())


def same_place(key: Json, true: str, named: str | None) -> bool:
    """Whether two targets are one place.

    An actuator and its joint are; so are "all" and the only actuator of a robot, and all names for a whole robot or
    world.
    """
    true, named = _only(key, true), _only(key, named or "")
    if true in EVERYWHERE or named in EVERYWHERE:
        return true in EVERYWHERE and named in EVERYWHERE
    return true == named or (_joint(key, true) == _joint(key, named) and not {true, named} <= set(key["bodies"]))


def _only(key: Json, target: str) -> str:
    return next(iter(key["actuators"])) if target in EVERYWHERE[:2] and len(key["actuators"]) == 1 else target


def _joint(key: Json, name: str) -> str:
    return key["actuators"].get(name) or key["bodies"].get(name) or name


def after_over_floor(key: Json, gap: Json) -> float | None:
    """Gap that is left over what the true robot leaves, as shares of the gap before: geometric mean over horizons.

    Of the horizons that the diagnosis reports, those count for which the key has a floor.
    """
    ratios = []
    for horizon, level in gap["horizons"].items():
        step = int(horizon)
        if 1 <= step <= len(key["floor_by_step"]) and level["before"] > 0:
            floor = max(key["floor_by_step"][step - 1], LEAST_FLOOR)
            ratios.append(max(level["after_effects"] / level["before"], LEAST_FLOOR / 10) / floor)
    return math.exp(sum(map(math.log, ratios)) / len(ratios)) if ratios else None


def _own_after(gap: Json) -> float | None:
    """The same with the floor that the diagnosis states."""
    after, floor, before = (gap.get(name) for name in ("after_effects", "noise_floor", "before"))
    if after is None or floor is None or not before:
        return None
    return (after / before) / max(floor / before, LEAST_FLOOR)


def value_errors(key: Json, fault: Json, effect: Json) -> tuple[dict[str, float], dict[str, bool]]:
    """Relative errors of the fitted values, in the scales of the key, and whether their intervals hold the true ones.

    Of those values alone that the recordings determine.
    """
    fitted = effect["parameters"]
    samples = math.sqrt(key["windows"] * HORIZON)
    true = dict(_flat(fault["values"]))
    found = {name: _fitted(fitted, name, len(true)) for name in true}
    signs = (1, -1) if fault["effect"] in BY_CONVENTION else (1,)
    answers = []
    for sign in signs:
        errors, inside = {}, {}
        for name, value in true.items():
            if fault["visible"][name] * samples >= VISIBLE:
                got, scale = found[name], fault["scales"][name.partition("[")[0]]
                errors[name] = math.inf if got is None else abs(sign * got[0] - value) / scale
                inside[name] = got is not None and got[1] <= sign * value <= got[2]
        answers.append((errors, inside))
    return min(answers, key=lambda e: sum(e[0].values()))


def _flat(values: Json) -> Iterator[tuple[str, float]]:
    for name, value in values.items():
        if isinstance(value, list):
            yield from ((f"{name}[{i}]", x) for i, x in enumerate(value))
        else:
            yield name, value


def _fitted(parameters: Json, name: str, count: int) -> tuple[float, float, float] | None:
    """The fitted value of a name and its interval: vectors may be lists or one entry an axis, an only value has any."""
    plain = {k.lower().replace(" ", "_"): (v["value"], v["low"], v["high"]) for k, v in parameters.items()}
    stem, _, rest = name.partition("[")
    if rest:
        axis = int(rest[:-1])
        if isinstance(plain.get(stem, (0.0,))[0], list):
            return _plain([x[axis] for x in plain[stem]])
        for form in (
            f"{stem}[{axis}]",
            f"{stem}_{axis}",
            f"{stem}_{'xyz'[axis]}",
            f"{stem}.{'xyz'[axis]}",
            "xyz"[axis],
        ):
            if form in plain:
                return _plain(plain[form])
        return None
    if name in plain:
        return _plain(plain[name])
    return _plain(next(iter(plain.values()))) if count == 1 and len(plain) == 1 else None


def _plain(numbers: Sequence[Any]) -> tuple[float, float, float]:
    value, low, high = map(float, numbers)
    return value, low, high
