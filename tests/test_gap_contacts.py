"""The diagnosis beside contacts, where small changes make jumps."""

from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import effect
from nfpde.gap import diagnose_gap, stage
from nfpde.gap.brief import brief, shorter
from nfpde.gap.chart import Chart
from nfpde.gap.fit import Fitter
from nfpde.gap.grain import Encoders
from nfpde.gap.noise import learn_scatter
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.sensors import sensor_noise
from nfpde.gap.stage import best_of_pits, first_fit, in_noise
from nfpde.parameters import Parameter, ParameterSpace

BALL = """
<mujoco><option timestep="0.002"/>
<worldbody>
  <geom name="floor" type="plane" size="5 5 .1" solref="0.02 0.3"/>
  <body name="ball" pos="0 0 .1"><joint name="up" type="slide" axis="0 0 1"/>
    <geom type="sphere" size=".1" mass="1" solref="0.02 0.3"/></body>
</worldbody></mujoco>
"""


def drops(height=0.0, noise=(0.0, 0.0), fall=0.4, rows=200, seed=0, xml=BALL):
    """Recordings of a ball that falls on a floor at a height, and bounces."""
    rng = np.random.default_rng(seed)
    out = []
    for number in range(4):
        model = mujoco.MjModel.from_xml_string(xml.replace('type="plane"', f'type="plane" pos="0 0 {height}"'))
        data = mujoco.MjData(model)
        data.qpos[0] = height + fall * rng.uniform()
        qpos, qvel = np.empty((rows, 1)), np.empty((rows, 1))
        for row in range(rows):
            qpos[row], qvel[row] = data.qpos, data.qvel
            mujoco.mj_step(model, data, 5)
        qpos += noise[0] * rng.normal(size=qpos.shape)
        qvel += noise[1] * rng.normal(size=qvel.shape)
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, np.zeros((rows, 0))))
    return Dataset(out)


BLOCK = """
<mujoco><option timestep="0.002" cone="elliptic"/><default><geom friction=".5"/></default>
<worldbody>
  <geom name="floor" type="plane" size="5 5 .1"/>
  <body name="block" pos="0 0 .1"><joint name="along" type="slide" axis="1 0 0"/>
    <joint name="up" type="slide" axis="0 0 1"/><geom type="box" size=".1 .1 .1" mass="1"/></body>
</worldbody>
<actuator><motor joint="along"/></actuator></mujoco>
"""


def pushes(friction, rows=200, seed=0, height=0.0, noise=1e-4):
    """Recordings of a block that is pushed to and fro on a floor with a sliding coefficient and a height."""
    rng = np.random.default_rng(seed)
    out = []
    for number in range(4):
        slippery = BLOCK.replace('friction=".5"', f'friction="{friction}"')
        model = mujoco.MjModel.from_xml_string(slippery.replace('type="plane"', f'type="plane" pos="0 0 {height}"'))
        data = mujoco.MjData(model)
        ctrl = 6 * np.sin(2 * np.pi * rng.uniform(0.5, 1.5) * 0.01 * np.arange(rows))[:, None] + rng.normal(0, 2)
        qpos, qvel = np.empty((rows, 2)), np.empty((rows, 2))
        for row in range(rows):
            qpos[row], qvel[row] = data.qpos, data.qvel
            data.ctrl[:] = ctrl[row]
            mujoco.mj_step(model, data, 5)
        qpos += noise * rng.normal(size=qpos.shape)
        qvel += 10 * noise * rng.normal(size=qvel.shape)
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, ctrl))
    return Dataset(out)


def test_short_windows_are_those_of_the_recordings():
    """Every short window is the one that the recordings have there, commands from before its start included."""
    data = pushes(0.2, rows=90)
    cut = cut_recordings(data, 3, 0, 160)
    steps = [r.horizons[-1] for r in brief(cut)]
    assert steps == list(cut.horizons[: len(steps)])
    assert steps
    for short in brief(cut):
        every = data.windows(short.horizons[-1], stride=1, history=3, past=3)
        where = {(e, r): i for i, (e, r) in enumerate(zip(every.episode, every.row, strict=True))}
        for half, whole in ((short.fit, cut.fit), (short.held, cut.held)):
            assert set(half.episode) <= set(whole.episode)
            chosen = every[np.array([where[e, r] for e, r in zip(half.episode, half.row, strict=True)])]
            for name in ("state", "ctrl", "history", "past"):
                np.testing.assert_array_equal(getattr(half, name), getattr(chosen, name))
        assert len(short.block) == len(short.held)


def test_few_short_windows_lie_all_over_the_recordings():
    """No more windows than asked for, each once, from the first to the last."""
    windows = cut_recordings(pushes(0.2), 0, 0, 160).fit
    short = shorter(windows, 2, 50)
    places = list(zip(short.episode, short.row, strict=True))
    assert len(places) == len(set(places)) == 50
    assert places[0] == (windows.episode[0], windows.row[0])
    assert places[-1] == (windows.episode[-1], windows.row[-1] + windows.horizon // 2 * 2 - 2)
    assert len(shorter(windows, 2, 10**6)) == windows.horizon // 2 * len(windows)


@pytest.mark.parametrize("height", [0.03, 0.005, -0.002])
def test_a_floor_is_found(height):
    """A floor that is off, by more than a window falls or by less, is found to within a tenth of a millimetre.

    A ball on one slide cannot tell it from an offset of the slide's sensor: either may be named.
    """
    report = diagnose_gap(mujoco.MjModel.from_xml_string(BALL), drops(height=height, noise=(1e-4, 1e-3)))
    assert report.verdict == "effects"
    (cause,) = report.effects
    assert "ground_height" in {cause.effect, *(r.effect for r in cause.indistinguishable)}
    (value,) = cause.parameters.values()
    assert value.value == pytest.approx(height, abs=1e-4)
    # noise of a hundred rows or more on it, each read to .1 mm; slopes over millimetres are those of a free fall
    assert value.high - value.low < 1e-4


def test_how_slippery_a_floor_is():
    """A coefficient two and a half times too large is named and corrected to within 5 %."""
    report = diagnose_gap(mujoco.MjModel.from_xml_string(BLOCK), pushes(0.2))
    assert [c.effect for c in report.effects] == ["ground_friction"]
    assert report.effects[0].parameters["sliding"].value == pytest.approx(0.2, rel=0.05)


def test_what_a_wrong_floor_made_look_like_noise_is_asked_about():
    """A floor that is lower than in the model, and slippery: the second shows once the first is known.

    A block on one slide upwards cannot tell the floor's height from an offset of that slide.
    """
    report = diagnose_gap(mujoco.MjModel.from_xml_string(BLOCK), pushes(0.48, height=-0.01, noise=1e-7))
    assert report.verdict == "effects"
    first, second = sorted(report.effects, key=lambda c: c.effect == "ground_friction")
    assert first.effect in ("ground_height", "joint_offset")
    assert second.effect == "ground_friction"
    assert second.parameters["sliding"].value == pytest.approx(0.48, abs=0.005)


def test_coordinates_of_free_parameters():
    """There and back again; a sign is kept, a factor is a step, a quarter of other bounds is one."""
    space = ParameterSpace([Parameter("body_mass", "ball", 0.5, 2.5, scale_inertia=False)])
    effects = [effect("ground_height", height=(-0.1, 0.1)), effect("ground_friction", sliding=(0.05, 3.0))]
    chart = Chart(Replay(mujoco.MjModel.from_xml_string(BALL), space, effects))
    xi = np.array([[0.5, -0.1, 0.05], [1.0, -0.002, 0.3], [1.5, 0.0, 0.3 * np.e], [2.5, 0.1, 3.0]])
    at = chart.inward(xi)
    assert chart.outward(at) == pytest.approx(xi, rel=1e-12)
    assert at[:, 0] == pytest.approx([0, 1, 2, 4])
    assert (np.sign(at[:, 1]) == [-1, -1, 0, 1]).all()
    assert at[2, 2] - at[1, 2] == pytest.approx(1)


@pytest.mark.parametrize(("fall", "factor"), [(0.0, 2.0), (0.4, 1.25)])
def test_noise_of_sensors_beside_contacts(fall, factor):
    """Noise comes back where a ball bounces; at rest, where a contact's answer to it is not linear, its size does."""
    noise = (1e-4, 2e-3)
    data = drops(noise=noise, fall=fall)
    replay = Replay(mujoco.MjModel.from_xml_string(BALL), None, [])
    rows = data.windows(1)
    ratio = sensor_noise(replay, np.zeros(0), rows, Encoders.of([rows.start])) / noise
    assert np.abs(np.log(ratio)).max() < np.log(factor)


@pytest.mark.parametrize("seed", range(6))
def test_parameters_are_found_beside_contacts(seed):
    """Damping and stiffness of a ball on a spring that bounces are found from the far corner of their bounds."""
    spring = BALL.replace('axis="0 0 1"', 'axis="0 0 1" stiffness="20" springref="0.1" damping="1"')
    truth = spring.replace('damping="1"', 'damping="2"').replace('stiffness="20"', 'stiffness="30"')
    space = ParameterSpace([Parameter("dof_damping", "up", 0.2, 8.0), Parameter("jnt_stiffness", "up", 10.0, 60.0)])
    replay = Replay(mujoco.MjModel.from_xml_string(spring), space, [])
    recordings = brief(cut_recordings(drops(noise=(1e-4, 1e-3), xml=truth, seed=seed), 0, 0, 160))[-1]
    found, _ = first_fit(replay, recordings, np.array([[7.9, 59.0]]), capped=True)
    # noise of the starts passes through the contacts: it does not only scatter the values, it shifts them
    assert found.fit.xi == pytest.approx([2.0, 30.0], rel=0.05)


class Pitted:
    """A replay of one parameter: a slope that leads to .3 from everywhere, and a pit every twelfth on the way."""

    low, high, nfree, effects = np.zeros(1), np.ones(1), 1, ()

    def inward(self, xi):
        return xi

    def outward(self, u):
        return u

    def residuals(self, xi, windows, horizons, force=None):
        off = xi[:, 0] - 0.3
        both = np.stack([off, 0.25 * np.sin(12 * np.pi * off)], -1)
        return np.tile(both[:, None, None], (1, 50, 1, 1))


def test_parameters_are_looked_for_behind_pits():
    """From the far end slopes stop in the nearest pit; looks all over the bounds find the deepest."""
    anything: Any = None
    pitted: Any = Pitted()
    fitter, far = Fitter(anything, (1, 2)), np.array([[0.95]])
    scatter = learn_scatter(0.1 * np.random.default_rng(0).normal(size=(200, 1, 2)), 0, 1e-5 * np.ones((1, 2)))
    stuck = fitter.improve(fitter.start(pitted, far, scatter), 6)
    assert abs(stuck.xi[0] - 0.3) > 0.1
    assert best_of_pits(fitter, stuck, far).xi == pytest.approx([0.3], abs=1e-3)


@pytest.mark.parametrize(("right", "look", "looks"), [(True, True, False), (False, True, True), (False, False, False)])
def test_a_fit_that_leaves_noise_alone_is_in_no_pit(right, look, looks, monkeypatch):
    """Parameters are looked for all over their bounds where more than the sensors' noise is left, if at all."""
    called = []
    monkeypatch.setattr(stage, "best_of_pits", lambda fitter, fit, guesses: called.append(fit) or fit)
    spring = BALL.replace('axis="0 0 1"', 'axis="0 0 1" stiffness="20" springref="0.1" damping="1"')
    bounds = (0.2, 8.0) if right else (5.0, 8.0)  # the ball has a damping of 1
    replay = Replay(
        mujoco.MjModel.from_xml_string(spring), ParameterSpace([Parameter("dof_damping", "up", *bounds)]), []
    )
    recordings = brief(cut_recordings(drops(noise=(1e-4, 1e-3), xml=spring), 0, 0, 160))[-1]
    base, court = first_fit(replay, recordings, np.array([[1.2 if right else 7.9]]), capped=True, look=False)
    assert not called
    in_noise(base, court, recordings, 0, look=look)
    assert bool(called) == looks


PUCK = """
<mujoco><option timestep="0.002"/><default><geom friction="{friction}"/></default>
<worldbody>
  <geom name="table" type="plane" size="5 5 .1"/>
  <body name="puck" pos="0 0 .02"><joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
    <joint name="z" type="slide" axis="0 0 1"/><geom type="cylinder" size=".04 .02" mass=".3"/></body>
  <body name="arm" pos="2 0 1"><joint name="hinge" axis="0 1 0" damping=".2"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass=".5"/></body>
</worldbody>
<actuator><motor joint="hinge"/></actuator></mujoco>
"""


def shots(friction, rows=150, noise=1e-4):
    """A puck that slides for some tenths of a second, then rests, beside an arm that swings on."""
    rng, out = np.random.default_rng(0), []
    model = mujoco.MjModel.from_xml_string(PUCK.format(friction=friction))
    for number in range(6):
        data = mujoco.MjData(model)
        data.qvel[:2] = rng.uniform(0.3, 0.9, 2)
        qpos, qvel = np.empty((rows, 4)), np.empty((rows, 4))
        ctrl = np.sin(2 * np.pi * (0.5 + 0.2 * number) * 0.01 * np.arange(rows))[:, None]
        for row in range(rows):
            qpos[row], qvel[row], data.ctrl[:] = data.qpos, data.qvel, ctrl[row]
            mujoco.mj_step(model, data, 5)
        noises = np.array([1.0, 1.0, 0.05, 1.0]) * noise
        qpos += noises * rng.normal(size=qpos.shape)
        qvel += 10 * noises * rng.normal(size=qvel.shape)
        out.append(Episode(str(number), 0.01 * np.arange(rows), qpos, qvel, ctrl))
    return Dataset(out)


def test_what_happens_at_the_beginning_alone_is_seen():
    """For late commands the first rows of an episode are useless; here nothing else shows how slippery the table is."""
    nominal = mujoco.MjModel.from_xml_string(PUCK.format(friction=0.5))
    report = diagnose_gap(nominal, shots(0.25))
    assert (report.verdict, [c.effect for c in report.effects]) == ("effects", ["ground_friction"])
    assert report.effects[0].parameters["sliding"].value == pytest.approx(0.25, abs=0.01)
    assert diagnose_gap(nominal, shots(0.5)).verdict == "no_gap"


def test_parameters_are_fitted_to_the_end_before_anything_is_blamed():
    """Without noise mass and friction are exact, and leave less than the floor: no candidate finishes their work."""
    recordings = brief(cut_recordings(pushes(0.3, noise=0.0), 0, 0, 120))[0]
    mass, friction = (
        Parameter("body_mass", "block", low=0.3, high=4.0, scale_inertia=False),
        Parameter("geom_friction", "*", low=0.1, high=1.0),
    )
    start = Replay(mujoco.MjModel.from_xml_string(BLOCK), ParameterSpace([mass, friction]), [])
    base, court = first_fit(start, recordings, np.array([[3.0, 0.9], [2.15, 0.55]]), capped=True)
    stage = in_noise(base, court, recordings, 0)
    assert stage.base.fit.xi == pytest.approx([1.0, 0.3], rel=1e-6)
    assert stage.yardstick.gap(stage.base.held).mean() < stage.yardstick.floor.mean()
