"""The diagnosis from recordings to report, on an arm whose faults are written out by hand."""

import json
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import effect
from nfpde.errors import BadDataset, BadInput
from nfpde.gap import diagnose_gap
from nfpde.parameters import Parameter, ParameterSpace
from tests.gap_systems import nominal, record

MASS = ParameterSpace([Parameter("body_mass", "fore", low=0.6, high=1.6)])


def weigh(model, factor):
    model.body_mass[2] *= factor
    model.body_inertia[2] *= factor


def rub(model):
    model.dof_frictionloss[1] = 0.2
    weigh(model, 1.1)


@pytest.fixture(scope="module")
def friction():
    """Coulomb friction of 0.2 Nm at the elbow and a forearm that is a tenth too heavy, with sensor noise."""
    return diagnose_gap(nominal(), record(rub, noise=1e-3), MASS)


def test_the_cause_is_named_with_its_value(friction):
    """Cause, place and value of the fault, the mass beside it, and nothing else."""
    assert friction.verdict == "effects"
    cause = friction.effects[0]
    assert (cause.effect, cause.target) == ("coulomb_friction", "elbow")
    assert len(friction.effects) == 1
    torque = cause.parameters["torque"]
    assert torque.value == pytest.approx(0.2, rel=0.02)  # the interval below is the statistical statement
    assert torque.low - 0.002 < 0.2 < torque.high + 0.002
    assert friction.base["body_mass:fore"].value == pytest.approx(1.1, rel=0.01)


def test_the_gap_closes_to_the_noise_floor(friction):
    """What is left is the noise; the ladder falls; the elbow holds the larger share."""
    gap = friction.gap
    assert gap.before == 1.0 > gap.after_parameters > gap.after_effects
    assert gap.after_effects == pytest.approx(gap.noise_floor, rel=0.2)
    assert friction.effects[0].shrink_low > 0.5
    assert friction.where[0].joint == "elbow"
    assert sum(p.share for p in friction.where) == pytest.approx(1.0)


def test_every_candidate_that_was_tried_has_intervals(friction):
    """That of the cause is as wide as where it is named; those of effects that were told apart are no points."""
    cause = friction.effects[0]
    [own] = [c for c in friction.ranking if (c.effect, c.target) == (cause.effect, cause.target)]
    named, ranked = (c.parameters["torque"] for c in (cause, own))
    assert ranked.high - ranked.low == pytest.approx(named.high - named.low, rel=1e-9)
    others = [v for c in friction.ranking if c is not own for v in c.parameters.values()]
    assert others
    assert all(v.low <= v.value <= v.high and v.low < v.high for v in others)


def test_the_answer_for_machines(friction, tmp_path):
    """diagnosis.json holds the contract's entries, and only finite numbers."""
    found = json.loads(friction.save(tmp_path).read_text())
    assert found["schema"] == 1
    assert found["effects"][0]["parameters"]["torque"]["unit"] == "Nm"
    rungs = {"before", "after_parameters", "after_effects", "noise_floor"}
    assert rungs | {"horizons"} <= set(found["gap"])
    assert all(set(level) == rungs for level in found["gap"]["horizons"].values())
    assert set(found["held_out_episodes"]) <= set(range(6))
    assert found["simulated_steps"] > 0
    assert "coulomb_friction" in " ".join(found["summary"])


def test_the_same_seed_gives_the_same_answer(friction):
    """Two runs agree in every number but the time they took."""
    again = diagnose_gap(nominal(), record(rub, noise=1e-3), MASS).to_json()
    once = friction.to_json()
    again["seconds"] = once["seconds"]
    assert again == once


def saturate(model):
    model.actuator_forcelimited[1], model.actuator_forcerange[1] = 1, (-2.3, 2.3)


def test_what_acts_in_few_windows_is_named():
    """A torque limit that a twentieth of the commands exceed hides in the tails of the noise, and is found."""
    data = record(saturate, noise=1e-3)
    beyond = np.concatenate([np.abs(e.ctrl[:, 1]) > 2.3 for e in data])
    assert 0.02 < beyond.mean() < 0.08
    found = diagnose_gap(nominal(), data)
    assert found.verdict == "effects"
    assert (found.effects[0].effect, found.effects[0].target) == ("torque_limit", "bend")
    assert found.effects[0].parameters["limit"].value == pytest.approx(2.3, rel=0.01)
    assert found.where[0].joint == "elbow"


def test_no_effect_where_there_is_none():
    """A lighter forearm is a parameter, not an effect: no alarm."""
    found = diagnose_gap(nominal(), record(lambda model: weigh(model, 0.85), noise=2e-3, seed=1), MASS)
    assert (found.verdict, found.effects) == ("no_gap", [])
    assert found.base["body_mass:fore"].value == pytest.approx(0.85, rel=0.01)


def test_an_effect_that_nobody_knows_is_left_unexplained():
    """A torque that beats with the angle, as of a cogging motor, is none of the library's."""
    found = diagnose_gap(nominal(), record(force=lambda data: 0.3 * np.sin(9 * data.qpos[1]), noise=1e-3, seed=2))
    assert found.verdict == "unexplained"
    assert found.where[0].joint == "elbow"
    assert found.residual_force is not None


def flip(data, joint, names=(1.0, 1.0)):
    sign = np.ones(2)
    sign[joint] = -1
    return Dataset([Episode(e.name, e.time, e.qpos * sign, e.qvel * sign, e.ctrl) for e in data])


def test_a_flipped_joint_is_named():
    """Recordings whose elbow counts the other way are refused with its name."""
    with pytest.raises(BadDataset, match="elbow's sign looks flipped"):
        diagnose_gap(nominal(), flip(record(), 1))


def test_swapped_joints_are_named():
    """Recordings whose joints stand in another order are refused with both names."""
    data = record(seed=3)
    swapped = [Episode(e.name, e.time, e.qpos[:, ::-1], e.qvel[:, ::-1], e.ctrl[:, ::-1]) for e in data]
    with pytest.raises(BadDataset, match="shoulder and elbow look swapped"):
        diagnose_gap(nominal(), Dataset(swapped))


def test_velocities_against_positions_are_named():
    """A speed of the wrong sign beside a position of the right one is refused."""
    data = record(seed=4)
    wrong = [Episode(e.name, e.time, e.qpos, e.qvel * [1.0, -1.0], e.ctrl) for e in data]
    with pytest.raises(BadDataset, match="elbow: its qvel runs against"):
        diagnose_gap(nominal(), Dataset(wrong))


def test_a_robot_at_rest_tells_nothing():
    """Without motion there is nothing to diagnose, and the text says what to record."""
    time = np.arange(300) * 0.01
    still = [Episode(str(i), time, np.zeros((300, 2)), np.zeros((300, 2)), np.zeros((300, 2))) for i in range(4)]
    with pytest.raises(BadDataset, match="nothing moves"):
        diagnose_gap(nominal(), Dataset(still))


def test_another_robot_is_refused():
    """Recordings with other columns than the model's joints are refused before anything is fitted."""
    other = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(BadDataset, match="nq"):
        diagnose_gap(other, record(episodes=2))


def test_differences_of_rounding_are_no_gap():
    """Recordings without noise of a robot that differs in the last digits: nothing is left to explain."""
    data = record(lambda model: model.dof_damping.__imul__(1 + 1e-13))
    start = nominal().dof_damping[0]
    assert start * (1 + 1e-13) != start
    report = diagnose_gap(nominal(), data, windows=40)
    assert (report.verdict, list(report.effects)) == ("no_gap", [])
    assert max(max(abs(t.before - t.measured)) for t in report.traces) > 0
    assert {t.unit for t in report.traces} <= {f"{unit}, from the window's start" for unit in ("rad", "rad/s")}


def test_an_effect_may_be_one_of_the_free_parameters():
    """Friction that is known to be there is fitted as a parameter is, and not looked for once more."""
    friction = effect("coulomb_friction", "elbow", torque=(0.0, 0.5))
    data = record(force=lambda data: -0.15 * np.tanh(data.qvel[1] / 1e-3), noise=1e-3, seed=4)
    found = diagnose_gap(nominal(), data, ParameterSpace(friction.parameters), windows=40)
    assert ("coulomb_friction", "elbow") not in {(c.effect, c.target) for c in found.ranking}
    (name,) = [p.name for p in friction.parameters]
    assert found.base[name].value == pytest.approx(0.15, rel=0.05)
    assert found.effects == []


@pytest.mark.parametrize(("name", "value"), [("seed", -1), ("seed", 0.5), ("windows", 19), ("nthread", -1)])
def test_wrong_numbers_are_refused_first(name, value):
    """By name, with what they may be."""
    options: dict[str, Any] = {name: value}
    with pytest.raises(BadInput, match=f"{name} is {value}; it must be a whole number, at least"):
        diagnose_gap(nominal(), record(rows=3), **options)
