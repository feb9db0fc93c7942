"""Faults that the vocabulary lacks, the memory of all, and dry friction beside the simulator's own."""

import numpy as np
import pytest

from nfpde.bench.gap.faults import bodies, commands, drives, friction, outsiders, sensors
from nfpde.bench.gap.plant import Plant
from nfpde.bench.gap.robots import ROBOTS
from tests.gap_plants import CONTROL, GEAR, MASS, SERVO, SLIDER, moved


def test_angle_outsiders_follow_their_laws():
    """Cogging has no mean, a magnet pulls in, a cable pulls on one side, repulsion pushes out."""
    turn = np.linspace(0, 2 * np.pi, 361)[:-1]
    cogging = outsiders.Cogging("elbow", {"torque": 0.3, "teeth": 7})
    assert np.mean([cogging.law(a) for a in turn]) == pytest.approx(0, abs=1e-12)
    assert max(cogging.law(a) for a in turn) == pytest.approx(0.3, rel=1e-2)
    magnet = outsiders.Magnet("elbow", {"torque": 0.5, "angle": 0.4, "width": 0.1})
    assert magnet.law(0.5) == pytest.approx(-0.5)
    assert magnet.law(0.3) == pytest.approx(0.5)
    assert abs(magnet.law(1.4)) < 1e-15
    cable = outsiders.LooseCable("elbow", {"stiffness": 2.0, "angle": 0.2})
    assert (cable.law(0.1), cable.law(0.7)) == (0, pytest.approx(-1.0))
    bump = outsiders.Repulsion("elbow", {"stiffness": 2.0, "angle": 0.0, "reach": 0.5})
    assert bump.law(0.1) > 0 > bump.law(-0.1)


def test_a_bearing_that_seizes_runs_freely_first():
    """Full speed for a while, standstill at the end."""
    seen = moved(SLIDER, outsiders.SeizingUp("rail", {"torque": 8.0}), None, 300, qvel=1.0)
    assert seen[170, 1] == pytest.approx(1.0, abs=1e-12)
    assert abs(seen[-1, 1]) < 1e-12


def test_a_sloshing_load_is_a_rigid_one_until_it_is_moved():
    """At rest the cart carries the same weight; pushed, the load follows late and swings at sqrt(g / l)."""
    hanging = SLIDER.replace('axis="1 0 0"', 'axis="0 0 1"')
    fault = {"mass": 0.8, "length": 0.1}
    still = moved(hanging, outsiders.Sloshing("cart", fault), MASS * 9.81 / GEAR, 30)
    assert np.abs(still).max() < 1e-9
    pushed = moved(SLIDER, outsiders.Sloshing("cart", fault), 2.0 / GEAR, 400)
    rigid = moved(SLIDER, None, 2.0 / GEAR, 400)
    assert pushed[2, 1] > 1.3 * rigid[2, 1]  # at first only 1.2 of 2 kg are pushed
    assert pushed[-1, 1] == pytest.approx(rigid[-1, 1], rel=0.05)


def test_a_moment_brings_every_memory_back():
    """Going on from a saved moment gives the same numbers, for each fault that remembers."""
    ctrl = np.sin(np.arange(40) / 3)[:, None]
    for fault in (
        commands.DeadTime("all", {"delay": 0.02}),
        commands.Lag("all", {"time_constant": 0.05}),
        drives.GearPlay("servo", {"width": 0.1}),
        sensors.LateReading("all", {"delay": 0.02}),
        outsiders.Sloshing("arm", {"mass": 0.1, "length": 0.1}),
    ):
        plant = Plant(SERVO, CONTROL, faults=[fault])
        plant.begin(np.zeros(1), np.zeros(1), ctrl[0])
        for u in ctrl[:20]:
            plant.advance(u)
        moment = plant.save()
        ends = []
        for _ in range(2):
            plant.load(moment)
            for u in ctrl[20:]:
                plant.advance(u)
            ends.append(np.concatenate(plant.reading()))
        np.testing.assert_array_equal(ends[0], ends[1])


class NativeFriction(bodies.Grease):
    """The same by MuJoCo's own friction loss."""

    def alter(self, model):
        model.dof_frictionloss[model.joint(self.target).dofadr[0]] = self.values["torque"]


@pytest.mark.parametrize(("joint", "torque"), [("lift", 2.0), ("bend", 0.8), ("yaw", 0.5)])
def test_coulomb_friction_agrees_with_the_simulators_own(joint, torque):
    """On an arm whose joints drive each other, both slow the joint alike; MuJoCo's creeps where it should stick."""
    robot = ROBOTS["arm3"]
    wave = np.sin(0.1 * np.arange(60)[:, None] + np.array([0.0, 2.0, 4.0])) * np.array(robot.open_torque)
    speeds = []
    for faults in ([friction.DryFriction(joint, {"torque": torque})], [NativeFriction(joint, {"torque": torque})], []):
        plant = Plant(robot.path.read_text(), robot.control_dt, faults=faults)
        plant.begin(np.array(robot.home), np.zeros(3), wave[0])
        speeds.append([])
        for u in wave:
            plant.advance(u)
            speeds[-1].append(plant.data.qvel[plant.model.joint(joint).dofadr[0]])
    own, native, without = map(np.array, speeds)
    effect = np.sqrt(((native - without) ** 2).mean())
    assert np.sqrt(((own - native) ** 2).mean()) < 0.05 * effect
