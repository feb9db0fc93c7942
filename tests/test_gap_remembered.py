"""Effects that remember commands may be among the free parameters of a diagnosis."""

import math
import tracemalloc
from typing import Any

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.effects import effect
from nfpde.errors import BadDataset
from nfpde.gap.checks import check_fit
from nfpde.gap.foresight import check_commands
from nfpde.gap.recordings import WINDOW_TIME, cut_recordings
from nfpde.gap.replay import Replay
from nfpde.gap.search import Search
from nfpde.parameters import ParameterSpace
from nfpde.sim.simulator import steps_back
from tests.gap_systems import nominal, record

DT, LONGEST = 0.01, 0.05
SLOW = effect("actuation_delay", "*", delay=(0.0, LONGEST))


def start() -> Replay:
    return Replay(nominal(), ParameterSpace(SLOW.parameters), [])


def logged_late(dataset: Dataset, rows: int) -> Dataset:
    """Commands that are written down some rows after they acted."""
    return Dataset(
        [
            Episode(e.name, e.time[rows:], e.qpos[rows:], e.qvel[rows:], e.ctrl[: len(e) - rows] if rows else e.ctrl)
            for e in dataset
        ]
    )


def checked(dataset: Dataset, delay: float) -> None:
    replay = start()
    recordings = cut_recordings(dataset, replay.sim.history_steps(DT), 0, 60)
    check_fit(replay, dataset, recordings, np.array([delay]))


@pytest.mark.parametrize("delay", [0.0, 0.013, LONGEST])
def test_a_robot_whose_commands_act_late_passes(delay):
    """The commands that its model acts on are there, those from before a window as well."""
    replay = start()
    sound = record(episodes=3)
    windows = sound.windows(len(sound[0]) - 1, history=replay.sim.history_steps(DT))
    moved = replay.predict(np.array([[delay]]), windows)[0]
    states = np.concatenate([windows.state[:, :1], moved], axis=1)
    slow = Dataset([Episode(e.name, e.time, s[:, :2], s[:, 2:], e.ctrl) for e, s in zip(sound, states, strict=True)])
    checked(slow, delay)


def test_a_late_log_is_refused_beside_a_free_delay():
    """No delay acts before its command: the next row's command tells, with all that went before it moved along."""
    checked(record(episodes=3), 0.0)
    with pytest.raises(BadDataset, match="commands look one row late"):
        checked(logged_late(record(episodes=3), 1), 0.0)


@pytest.mark.parametrize("candidates", [[], [effect("actuator_lag", "lift", time_constant=(0.0, 0.02))]])
def test_windows_hold_what_free_effects_remember(candidates):
    """As many commands as the simulator with the candidate asks for; none starts where even one would miss some."""
    rest: Any = None
    search = Search(start(), record(episodes=4), [(c, np.zeros((1, 1))) for c in candidates], rest, 60, 0, rest, rest)
    recordings = search.cut()
    asked = Replay(nominal(), ParameterSpace(SLOW.parameters), candidates).sim
    assert recordings.fit.nhistory >= asked.history_steps(DT)
    assert recordings.fit.row.min() >= steps_back(asked.memory_time, DT) - 1 > 0
    assert np.isfinite(asked.predict(np.full((1, len(asked.space)), 0.01), recordings.fit)).all()


def long_logs(rows: int, episodes: int = 2) -> Dataset:
    """Noise of one command and one joint at a thousand rows a second."""
    rng = np.random.default_rng(0)
    time = 1e-3 * np.arange(rows)
    return Dataset([Episode(str(n), time, *rng.normal(size=(3, rows, 1))) for n in range(episodes)])


def test_states_are_kept_no_further_back_than_they_matter():
    """Commands count for as long as any effects remember, states only as far as the motion is taken up."""
    rest: Any = None
    plain = Replay(nominal(), None, [])
    candidates = [
        (effect("actuator_lag", "lift", time_constant=(0.0, 0.5)), np.zeros((1, 1))),
        (effect("backlash", "lift", width=(0.0, 0.1)), np.zeros((1, 1))),
    ]
    recordings = Search(plain, record(episodes=4), candidates, rest, 60, 0, rest, rest).cut()
    recalled = math.ceil(max(e.recall_time() for e, _ in candidates) / DT)
    assert recalled > 0
    for windows in (recordings.fit, recordings.held, recordings.rows):
        assert windows.past.shape[1] == round(WINDOW_TIME / DT) + recalled
        assert windows.nhistory > 1.5 * windows.past.shape[1]


def test_commands_are_checked_without_every_rows_history():
    """Rows are chosen by their commands first; with 500 commands before each of 40 000 they are 160 MB."""
    xml = """<mujoco><option timestep="0.001"/><worldbody><body><joint name="hinge" axis="0 1 0" damping="1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02"/></body></worldbody>
      <actuator><motor name="drive" joint="hinge"/></actuator></mujoco>"""
    slow = effect("actuation_delay", "drive", delay=(0.0, 0.5))
    replay = Replay(mujoco.MjModel.from_xml_string(xml), ParameterSpace(slow.parameters), [])
    data = long_logs(20_000)
    tracemalloc.start()
    check_commands(replay, data, np.array([0.01]))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 40e6
