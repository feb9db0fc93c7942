"""What does the same as an effect that was found, and searches that begin with another one."""

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import effect
from nfpde.gap.accepted import Accepted
from nfpde.gap.beginnings import best_beginning, other_beginnings
from nfpde.gap.brief import brief
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.select import Selection
from nfpde.gap.stage import first_fit, in_noise
from nfpde.gap.trial import Court, Trial
from nfpde.gap.twins import find_twins, share_of_mixtures
from tests.test_gap_contacts import BLOCK, pushes

ANYTHING: Any = None


@pytest.mark.parametrize("many", [False, True])
def test_a_motor_that_pushes_is_found_for_a_force_that_does(many):
    """A block that friction holds against small forces: only at its size does a bias do what the force does.

    Of many windows a part tells which effects cannot do that at any size.
    """
    model = mujoco.MjModel.from_xml_string(BLOCK)
    if many:
        recordings = brief(cut_recordings(pushes(0.5, rows=800), 0, 0, 160), 1000)[0]
    else:
        recordings = cut_recordings(pushes(0.5), 0, 0, 60)
    base, court = first_fit(Replay(model, None, []), recordings, np.zeros((1, 0)), capped=True)
    stage = in_noise(base, court, recordings, 0)
    force = effect("external_force", "block", force_x=(-9, 9), force_y=(-9, 9), force_z=(-9, 9))
    fit = stage.court.fitter.start(Replay(model, None, [force]), np.array([[4.0, 0.0, 0.0]]), stage.base.fit.scatter)
    found = stage.court.judge(force, fit)
    bias = effect("actuator_bias", 0, offset=(-9, 9))
    nothing = effect("joint_offset", "along", offset=(-0.1, 0.1))  # the floor is the same everywhere
    others = [
        (effect("armature", "up", inertia=(0, 2)), np.array([[0.5]])),
        (bias, np.array([[0.1], [-0.1]])),
        (effect("joint_offset", "up", offset=(-0.1, 0.1)), np.array([[1e-3]])),
        (nothing, np.array([[1e-3]])),
    ]
    made = {e: Replay(model, None, [e]) for e, _ in others}
    alike = find_twins(stage.court, stage.base.fit, found, others, made.__getitem__, touches=True)
    assert alike[0].effect is bias
    assert alike[0].share > 0.9  # the last looks are 7 % apart: the nearest is half of that off
    ((_, start),) = alike[0].starts
    assert start[0, 0] == pytest.approx(4.0, rel=0.3)
    idle, tried = (made[e].sim.simulated_steps for e in (nothing, bias))
    assert (6 * idle < tried) is many  # 17 looks at a quarter of the windows, against as many there and 34 at all


MOTOR_XML = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="turn" axis="0 0 1" damping="0.02"/>
      <geom type="box" size="0.2 0.02 0.02" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="turn"/></actuator>
</mujoco>
"""
STALL, NO_LOAD = 0.5, 6.0


def turns():
    """Recordings of a motor whose torque sinks with its speed, computed by hand: no gravity, one inertia."""
    model = mujoco.MjModel.from_xml_string(MOTOR_XML)
    inertia, dt = (0.2**2 + 0.02**2) / 3, 0.002
    rng, out = np.random.default_rng(5), []
    for number in range(4):
        ctrl = 1.2 * np.sign(np.sin(2 * np.pi * rng.uniform(0.4, 0.9) * 0.02 * np.arange(240)))[:, None]
        ctrl *= rng.uniform(0.1, 1.0, size=(8, 1)).repeat(30, 0)
        qpos, qvel = np.zeros((240, 1)), np.zeros((240, 1))
        q, v = 0.0, 0.0
        for row in range(240):
            qpos[row], qvel[row] = q, v
            for _ in range(10):
                most = STALL * np.clip(1 - max(v, 0.0) / NO_LOAD, 0, None)
                least = -STALL * np.clip(1 + min(v, 0.0) / NO_LOAD, 0, None)
                # damping is implicit in MuJoCo's Euler steps
                v = (inertia * v + dt * float(np.clip(ctrl[row, 0], least, most))) / (inertia + dt * 0.02)
                q += dt * v
        out.append(Episode(str(number), 0.02 * np.arange(240), qpos, qvel, ctrl))
    return model, Dataset(out)


def test_a_motor_that_tires_with_speed_is_looked_for_beside_a_limit():
    """What cannot do what was found, by any mixture of what is screened, costs no more than that."""
    model, data = turns()
    recordings = cut_recordings(data, 0, 0, 60)
    base, court = first_fit(Replay(model, None, []), recordings, np.zeros((1, 0)), capped=False)
    stage = in_noise(base, court, recordings, 0)
    limit = effect("torque_limit", 0, limit=(0.05, 5))
    fit = stage.court.fitter.start(Replay(model, None, [limit]), np.array([[STALL]]), stage.base.fit.scatter)
    found = stage.court.judge(limit, fit)
    curve = effect("torque_speed", 0, no_load_speed=(1, 60), stall_torque=(0.05, 5))
    zero = effect("joint_offset", "turn", offset=(-0.1, 0.1))  # nothing depends on the position
    others = [(zero, np.array([[0.05], [-0.05]])), (curve, np.array([[10.0, 0.3], [20.0, 1.0], [4.0, 2.0]]))]
    made = []

    def replay_with(one):
        made.append(Replay(model, None, [one]))
        return made[-1]

    (twin,) = find_twins(stage.court, stage.base.fit, found, others, replay_with, touches=False)
    assert twin.effect is curve
    truth = stage.court.judge(curve, stage.court.fitter.start(twin.replay, np.array([[NO_LOAD, STALL]]), fit.scatter))
    assert np.abs(truth.held).max() < 1e-9  # the physics by hand are the effect's
    idle, tried = (r.sim.simulated_steps for r in made)
    assert 10 * idle < tried  # 2 values, against 3 and twice 32


def test_what_mixtures_of_changes_can_make():
    """The share of the squares in their span; what changes nothing adds nothing."""
    changes, wanted = np.array([[2.0, 0.0, 0.0], [1e9, 1e-2, 0.0], [0.0, 0.0, 0.0]]), np.array([3.0, 4.0, 12.0])
    assert share_of_mixtures(changes[:1], wanted) == pytest.approx(9 / 169)
    assert share_of_mixtures(np.eye(3)[[0, 1, 1]], wanted) == pytest.approx(25 / 169)
    assert share_of_mixtures(changes[2:], wanted) == 0.0
    # nearly parallel ones have no second direction
    assert share_of_mixtures(changes, wanted) == pytest.approx(9 / 169)


@pytest.mark.parametrize(("sigma", "left", "asks"), [(None, 1.0, False), (None, 9.0, True), (np.ones(2), 1.0, True)])
def test_twins_are_asked_for_where_screening_may_have_missed_them(sigma, left, asks):
    """Beside contacts always, in smooth motion where what was found leaves something over."""
    selection = known({}, sigma=sigma)
    assert selection._asks_for_twins(trial(RUB, left)) is asks


RUB, SPRING, MOTOR, LOAD = (
    effect(name, "elbow", **bounds)
    for name, bounds in (
        ("coulomb_friction", {"torque": (0, 1)}),
        ("viscous_damping", {"damping": (0, 1)}),
        ("armature", {"inertia": (0, 1)}),
        ("joint_offset", {"offset": (-1, 1)}),
    )
)


def trial(which, left, density=0.0):
    """A trial that leaves a gap, at a density."""
    densities = density + 0.1 * np.random.default_rng(3).normal(size=40)
    fit: Any = SimpleNamespace(left=left, cost=-float(densities.sum()))
    return Trial(which, fit, densities, ANYTHING, densities)


class Known(Selection):
    """A selection that knows what each beginning leads to."""

    leads: dict[str, Any]

    def run(self, base, earlier=None, *, further=False):
        assert earlier is not None
        assert further
        return self.leads[earlier[1][0].effect.name]

    def gap_of(self, trial: Any):
        return trial.fit.left

    _usual_gap = gap_of

    def at_floor(self, trial: Any):
        return trial.fit.left < 1.5

    def floor(self, trial: Any):
        return 1.0

    def given_by_noise(self, trial: Any, current: Any, sigma: Any, gain: Any):
        return False

    def slope(self, trial, current):
        return 1.0


def known(leads, **more):
    court = Court(np.arange(40) // 4, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0), ANYTHING)
    yardstick: Any = SimpleNamespace(floor=np.ones((40, 2, 4)), rounding=0.0)
    selection = Known(ANYTHING, None, 1, court, [], yardstick=yardstick, **more)
    selection.leads = leads
    return selection


def begins(selection, final, *effects):
    """Effects to begin with."""
    return [a.effect for a in other_beginnings(selection, BASE, final, accepted(*effects))]


def accepted(*effects):
    return [Accepted(e, trial(e, 1.0), (), (), ()) for e in effects]


BASE, MIMIC = trial(None, 100.0), trial(RUB, 10.0, 5.0)
FIRST = [MIMIC, trial(SPRING, 20.0, 4.0), trial(MOTOR, 90.0, 1.0), trial(LOAD, 30.0, -3.0)]


class Leading(Selection):
    """A selection that takes the densest candidate, and knows which candidates do what another does."""

    leads: dict[str, list[Trial]]
    turns = 0

    def twins(self, current, found: Any, trials, taken):
        self.turns += 1
        return [t for t in self.leads.get(found.effect.name, []) if t not in trials]

    def accept(self, current, trials, first_gap, level=0.0, settled=None):
        best: Any = max(trials, key=lambda t: t.density.mean())
        return best, Accepted(best.effect, best, (), (), tuple(trials))


def test_what_does_the_same_is_looked_for_until_nothing_else_is_accepted():
    """A cause that no screening saw is reached from one effect to the next; one that stays is asked about once."""
    near, nearer, cause = trial(RUB, 9.0, 1.0), trial(SPRING, 3.0, 2.0), trial(MOTOR, 1.0, 3.0)
    court = Court(np.arange(40) // 4, ANYTHING, ANYTHING, np.zeros((2, 4)), np.zeros(0), ANYTHING)
    selection = Leading(ANYTHING, None, 1, court, [], yardstick=ANYTHING)
    selection.leads = {RUB.name: [nearer], SPRING.name: [cause, near]}
    field, chosen = selection._beside_twins(BASE, selection.accept(BASE, [near], 100.0), [near], [], 100.0)
    assert chosen[0] is cause
    assert field == [cause, nearer, near]
    selection.turns, selection.leads = 0, {MOTOR.name: [near, nearer]}
    field, chosen = selection._beside_twins(BASE, selection.accept(BASE, [cause], 100.0), [cause], [], 100.0)
    assert chosen[0] is cause
    assert field == [cause, nearer, near]
    assert selection.turns == 1


def test_others_to_begin_with():
    """Those that removed half as much, surely; none where all is explained, unless by as many as may be."""
    selection = known({}, ranking=FIRST)
    assert begins(selection, MIMIC, RUB) == [SPRING]
    assert begins(selection, MIMIC, RUB, SPRING) == []
    assert begins(selection, trial(RUB, 1.9), RUB) == []
    assert begins(selection, trial(RUB, 1.0), RUB, MOTOR, LOAD) == [SPRING]
    assert begins(selection, BASE) == []


@pytest.mark.parametrize(
    ("mine", "left", "density", "other", "taken"),
    [
        ([RUB], 10.0, 5.0, (1.0, 9.0), True),  # explains more
        ([RUB], 10.0, 5.0, (1.0, 5.0), False),  # not surely
        ([RUB], 10.0, 5.0, (9.99, 9.0), False),  # surely, and not worth a name
        ([RUB, MOTOR, LOAD], 1.0, 9.0, (1.0, 9.0), True),  # the same with two instead of three
        ([RUB, MOTOR, LOAD], 1.0, 9.0, (1.0, 8.0), False),  # less
    ],
)
def test_the_better_beginning_is_taken(mine, left, density, other, taken):
    """One that explains more, or no less with fewer effects."""
    found = trial(None, left, density), accepted(*mine)
    rng = np.random.default_rng(4)
    better = trial(None, *other), accepted(SPRING, LOAD)
    better[0].density[:] += 0.01 * rng.normal(size=40)
    selection = known({"viscous_damping": better}, ranking=FIRST)
    got = best_beginning(selection, BASE, *found)
    assert (got[0] is better[0]) is taken
    assert (got[0] is found[0]) is not taken
