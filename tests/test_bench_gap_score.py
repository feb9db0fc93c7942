"""Scores of hand-made diagnoses."""

import math

import pytest

from nfpde.bench.gap.score import judge, same_place
from nfpde.bench.gap.summary import by_size, confusion, figures, wilson
from nfpde.bench.gap.table import table


def key_of(kind, *faults, floor=0.1):
    return {
        "index": 4,
        "kind": kind,
        "robot": "arm",
        "faults": list(faults),
        "noise_floor": floor,
        "floor_by_step": [floor] * 25,
        "windows": 100,
        "free": [],
        "actuators": {"motor1": "elbow", "motor2": "wrist"},
        "bodies": {"fore": "elbow", "hand": "wrist"},
    }


def fault(effect, target, values, visible=1.0, size=2.0):
    flat = {}
    for name, value in values.items():
        flat.update(
            {f"{name}[{i}]": visible for i in range(len(value))} if isinstance(value, list) else {name: visible}
        )
    scales = {n: math.dist(v, [0] * len(v)) if isinstance(v, list) else abs(v) for n, v in values.items()}
    return {"effect": effect, "target": target, "values": values, "scales": scales, "size": size, "visible": flat}


def effect(name, target, others=(), **values):
    parameters = {k: {"value": v, "low": v, "high": v, "unit": ""} for k, v in values.items()}
    declared = [{"effect": e, "target": t} for e, t in others]
    return {"effect": name, "target": target, "parameters": parameters, "indistinguishable": declared}


def diagnosis(verdict, *effects, after=0.1, where="elbow"):
    return {
        "schema": 1,
        "verdict": verdict,
        "effects": list(effects),
        "where": [{"joint": where, "share": 0.9, "regime": "slow"}],
        "gap": {
            "before": 1.0,
            "after_effects": after,
            "noise_floor": 0.08,
            "horizons": {"1": {"before": 1.0, "after_effects": after}, "40": {"before": 1.0, "after_effects": 9.0}},
        },
        "simulated_steps": 1000,
    }


COULOMB = fault("coulomb_friction", "elbow", {"torque": 0.5})
DELAY = fault("actuation_delay", "motor2", {"delay": 0.02})


def one(answer, truth=COULOMB):
    return judge(key_of("one", truth), "done", 3.0, answer)


def test_the_right_name_at_the_right_place_is_right():
    """Cause, place, value error and the gap over the floor."""
    row = one(diagnosis("effects", effect("coulomb_friction", "elbow", torque=0.51), after=0.12))
    assert (row.right, row.cause, row.alone, row.place, row.reason) == (True, True, True, True, "")
    assert row.errors == {"torque": pytest.approx(0.02)}
    assert row.after == pytest.approx(1.2)  # the horizon of 40 steps has no floor in the key
    assert row.own_after == pytest.approx(1.5)


def test_a_declared_set_counts_for_the_cause_and_not_alone():
    """Place is that of the entry in the set; no value is scored for a neighbour."""
    answer = diagnosis("effects", effect("load_friction", "elbow", [("coulomb_friction", "elbow")], base=0.1))
    row = one(answer)
    assert (row.right, row.cause, row.alone, row.place, row.set_size) == (True, True, False, True, 2)
    assert row.errors == {}


def test_a_set_must_hold_cause_and_place_together():
    """The hidden effect elsewhere and another effect here do not add up."""
    answer = diagnosis("effects", effect("load_friction", "elbow", [("coulomb_friction", "wrist")], base=0.1))
    row = one(answer)
    assert (row.right, row.cause, row.place, row.reason) == (False, True, False, "place")


def test_another_effect_at_the_place_has_the_place_only():
    """Its cause is wrong, the joint right."""
    row = one(diagnosis("effects", effect("viscous_damping", "elbow", damping=1.0)))
    assert (row.right, row.cause, row.place, row.reason) == (False, False, True, "cause")


def test_only_the_first_effect_counts():
    """The hidden effect in second place is no right cause."""
    row = one(diagnosis("effects", effect("viscous_damping", "elbow"), effect("coulomb_friction", "elbow", torque=0.5)))
    assert not row.cause
    assert row.extra == 1


def test_nothing_named_is_neither():
    """Whatever the verdict."""
    row = one(diagnosis("no_gap"))
    assert (row.right, row.cause, row.place) == (False, False, False)
    assert row.reason == "nothing named: no_gap"


@pytest.mark.parametrize(
    ("true", "named", "same"),
    [
        ("motor1", "elbow", True),
        ("elbow", "motor1", True),
        ("motor1", "motor2", False),
        ("all", "motor1", False),
        ("world", "", True),
        ("contact", "floor", True),
        ("contact", "fore", False),
        ("contact", None, True),
        ("fore", "hand", False),
        ("fore", "elbow", True),
    ],
)
def test_places(true, named, same):
    """An actuator is where its joint is; the whole robot and the world are one place each."""
    assert same_place(key_of("one"), true, named) is same


def test_all_actuators_of_a_robot_with_one_are_that_one():
    """And not otherwise."""
    key = {**key_of("one"), "actuators": {"motor": "elbow"}}
    assert same_place(key, "all", "motor")
    assert same_place(key, "elbow", "all")


def test_vectors_are_read_in_every_form():
    """A list, or one entry an axis; the error is that of each axis over the length of the vector."""
    truth = fault("external_force", "fore", {"force": [3.0, 0.0, 4.0]})
    forms = (
        {"force": [3.5, 0.0, 4.0]},
        {"force_x": 3.5, "force_y": 0.0, "force_z": 4.0},
        {"force[0]": 3.5, "force[1]": 0.0, "force[2]": 4.0},
    )
    for values in forms:
        row = one(diagnosis("effects", effect("external_force", "fore", **values)), truth)
        assert row.errors == {"force[0]": pytest.approx(0.1), "force[1]": 0, "force[2]": 0}


def test_values_that_do_not_show_are_not_scored():
    """A tenth of them must show with ten standard errors: 0.3 over noise at 1000 samples does not."""
    truth = fault("coulomb_friction", "elbow", {"torque": 0.5}, visible=0.3)
    assert one(diagnosis("effects", effect("coulomb_friction", "elbow", torque=5.0)), truth).errors == {}


def test_a_missing_value_is_an_infinite_error():
    """An effect that says nothing of a value that shows has not found it."""
    truth = fault("load_friction", "elbow", {"base": 0.1, "share": 0.2})
    row = one(diagnosis("effects", effect("load_friction", "elbow", base=0.1)), truth)
    assert row.errors == {"base": 0, "share": math.inf}


def test_signs_by_convention_may_be_turned_together():
    """A tilt of opposite axes is the same tilt; one with a single axis turned is not."""
    truth = fault("gravity_tilt", "world", {"roll": 0.03, "pitch": 0.04})
    turned = one(diagnosis("effects", effect("gravity_tilt", "world", roll=-0.03, pitch=-0.04)), truth)
    mixed = one(diagnosis("effects", effect("gravity_tilt", "world", roll=-0.03, pitch=0.04)), truth)
    assert max(turned.errors.values()) == pytest.approx(0)
    assert max(mixed.errors.values()) > 1


def within(answer, low, high):
    """The same answer with other intervals."""
    for name, v in answer["effects"][0]["parameters"].items():
        v.update(low=low[name], high=high[name])
    return answer


def test_intervals_hold_the_true_value_or_not():
    """Of those values that are scored, with the sign that the errors are of."""
    truth = fault("load_friction", "elbow", {"base": 0.1, "share": 0.2})
    answer = diagnosis("effects", effect("load_friction", "elbow", base=0.12, share=0.25))
    row = one(within(answer, {"base": 0.09, "share": 0.24}, {"base": 0.13, "share": 0.26}), truth)
    assert row.inside == {"base": True, "share": False}
    tilt = fault("gravity_tilt", "world", {"roll": 0.03})
    answer = diagnosis("effects", effect("gravity_tilt", "world", roll=-0.031))
    assert one(within(answer, {"roll": -0.033}, {"roll": -0.029}), tilt).inside == {"roll": True}
    assert one(within(answer, {"roll": 0.029}, {"roll": 0.033}), tilt).inside == {"roll": False}
    hidden = fault("coulomb_friction", "elbow", {"torque": 0.5}, visible=0.3)
    assert one(diagnosis("effects", effect("coulomb_friction", "elbow", torque=5.0)), hidden).inside == {}


def test_free_parameters_are_scored_where_the_case_is_right():
    """Controls too; beside an effect that the library lacks they have no true value."""
    fitted = {
        "body_mass:fore": {"value": 1.0, "low": 0.9, "high": 1.1},
        "body_mass:hand": {"value": 2, "low": 2, "high": 3},
    }
    free = [{"field": "body_mass", "element": name, "true": 1.05} for name in ("fore", "hand")]

    def said(kind, verdict, *faults):
        answer = diagnosis(verdict) | {"parameters": fitted}
        return judge({**key_of(kind, *faults), "free": free}, "done", 1.0, answer).base_inside

    assert said("none", "no_gap") == {"body_mass:fore": True, "body_mass:hand": False}
    assert said("none", "unexplained") == {}
    assert said("one", "no_gap", COULOMB) == {}
    assert said("outsider", "unexplained", fault("magnet", "elbow", {})) == {}


def test_controls_want_silence():
    """Any verdict but "no_gap" is an alarm."""
    assert judge(key_of("none"), "done", 1.0, diagnosis("no_gap")).right
    assert not judge(key_of("none"), "done", 1.0, diagnosis("unexplained")).right
    row = judge(key_of("none"), "done", 1.0, diagnosis("effects", effect("armature", "elbow")))
    assert not row.right
    assert row.extra == 1


def test_outsiders_want_unexplained_and_the_joint():
    """The place comes from the map of the gap."""
    magnet = fault("magnet", "elbow", {"torque": 1.0})
    assert judge(key_of("outsider", magnet), "done", 1.0, diagnosis("unexplained")).place
    row = judge(
        key_of("outsider", magnet), "done", 1.0, diagnosis("effects", effect("armature", "elbow"), where="wrist")
    )
    assert (row.right, row.place) == (False, False)


@pytest.mark.parametrize(
    ("effects", "found"),
    [
        ([effect("coulomb_friction", "elbow", torque=0.5), effect("actuation_delay", "wrist", delay=0.02)], 2),
        ([effect("actuation_delay", "motor2", delay=0.02), effect("coulomb_friction", "elbow", torque=0.5)], 2),
        ([effect("coulomb_friction", "elbow", torque=0.5), effect("actuation_delay", "motor1", delay=0.02)], 1),
        ([effect("coulomb_friction", "elbow", [("actuation_delay", "motor2")], torque=0.5)], 1),
        ([effect("armature", "elbow")], 0),
        ([], 0),
    ],
)
def test_pairs_need_an_effect_for_each(effects, found):
    """In any order; one effect whose set holds both is one."""
    row = judge(key_of("two", COULOMB, DELAY), "done", 1.0, diagnosis("effects", *effects))
    assert (row.found, row.right) == (found, found == 2)


def test_failures_and_broken_answers_are_rows_too():
    """A time limit and a JSON without its entries are wrong cases with their reason."""
    late = judge(key_of("one", COULOMB), "time limit", 300.0, None)
    broken = one({"schema": 1, "verdict": "effects"})
    assert (late.right, late.reason) == (False, "time limit")
    assert not broken.right
    assert "breaks the contract" in broken.reason


def test_figures_count_what_they_say():
    """Three of four causes, one alarm of two controls, medians over all values."""
    good = one(diagnosis("effects", effect("coulomb_friction", "elbow", torque=0.52)))
    bad = one(diagnosis("effects", effect("armature", "wrist")))
    quiet = judge(key_of("none"), "done", 9.0, diagnosis("no_gap"))
    alarm = judge(key_of("none"), "done", 9.0, diagnosis("unexplained"))
    rows = [good, good, good, bad, quiet, alarm]
    shown = {name: (value, n, met) for name, _, value, n, met in figures(rows)}
    assert shown["right cause, one effect"] == (0.75, 4, False)
    assert shown["right place, one effect"] == (0.75, 4, False)
    assert shown["alarms on controls"] == (0.5, 2, False)
    assert shown["pairs, both found"] == (None, 0, None)
    assert shown["relative error of fitted values, median"][0] == pytest.approx(0.04)
    assert shown["seconds, median"] == (3.0, 6, True)
    assert confusion(rows)["coulomb_friction"] == {"coulomb_friction": 3, "armature": 1}
    assert [b["cases"] for b in by_size(rows)] == [0, 0, 4, 0, 0, 0]
    facts = {"command": "c", "seed": 1, "code": "0f", "versions": {}, "machine": "m", "device": "cpu"}
    page = table(rows, {**facts, "cases": 6}, "gap.png")
    assert "Cases right: 4 of 6.\n" in page
    assert "Stopped after 6 of 200 systems." in table(rows, {**facts, "cases": 200}, "gap.png")
    assert "| right cause, one effect | >= 95 % | 75.0 % |" in page
    assert "Cases that are not right (2)" in page
    assert "hold the true value in 0.0 % of 3 values of effects; in no free parameters" in page


def test_pairs_go_by_the_lesser_size_and_outsiders_by_their_own():
    """A pair of sizes 50 and 0.5 counts where 0.5 lies; its place there is not mixed with single effects'."""
    great, small = (fault("coulomb_friction", "elbow", {"torque": 0.5}, size=s) for s in (50.0, 0.5))
    found = diagnosis("effects", effect("coulomb_friction", "elbow", torque=0.5))
    rows = [
        judge(key_of("two", great, small), "done", 1.0, found),
        judge(key_of("one", great), "done", 1.0, found),
        judge(key_of("outsider", fault("magnet", "elbow", {}, size=5.0)), "done", 1.0, diagnosis("unexplained")),
    ]
    sizes = by_size(rows)
    assert [(b["pairs"], b["both"]) for b in sizes] == [(0, None), (1, 0.0), *[(0, None)] * 4]
    assert [(b["outsiders"], b["unexplained"]) for b in sizes] == [*[(0, None)] * 3, (1, 1.0), *[(0, None)] * 2]
    assert [b["cases"] for b in sizes] == [0, 0, 0, 0, 0, 1]
    facts = {"command": "c", "seed": 1, "code": "0f", "versions": {}, "machine": "m", "device": "cpu", "cases": 3}
    page = table(rows, facts, "gap.png")
    assert "| 0.3 to 1 | 0 |  |  |  | 1 | 0.0 % | 0 |  |" in page
    assert "| 3 to 10 | 0 |  |  |  | 0 |  | 1 | 100.0 % |" in page


def test_a_page_of_sound_robots_says_nothing_of_faults():
    """What is counted over hidden faults has no number there, and no empty tables."""
    rows = [judge(key_of("none"), "done", 9.0, diagnosis(verdict)) for verdict in ("no_gap", "no_gap", "unexplained")]
    facts = {"command": "c", "seed": 1, "code": "0f", "versions": {}, "machine": "m", "device": "cpu", "cases": 3}
    page = table(rows, facts, "gap.png")
    assert page.startswith("# Diagnosis of sound robots\n")
    assert "| alarms on controls | <= 2 % | 33.3 % |" in page
    assert "Cases right: 2 of 3.\n" in page
    assert not any(word in page for word in ("nan", "gap.png", "## By size", "## By effect", "without the declared"))


def test_wilson_intervals():
    """The published example of 0.2 of 10: 0.057 to 0.51."""
    assert wilson(0.2, 10) == (pytest.approx(0.0567, abs=1e-4), pytest.approx(0.5098, abs=1e-4))
