"""Commands that were logged a row late are refused; no sound log is, whatever contacts and encoders do to it."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from nfpde.dataset import Dataset, Episode
from nfpde.errors import BadDataset
from nfpde.gap.foresight import check_commands
from nfpde.gap.replay import Replay
from tests.gap_systems import nominal, record
from tests.test_gap_contacts import BLOCK, pushes


def test_a_few_rows_that_contacts_throw_about_are_no_late_log():
    """A block whose height is read in steps of .8 mm, while it chatters by .2 mm on its floor: no reading is right.

    What is left of single rows is then a matter of chance; of forty such logs none is refused.
    """
    model = mujoco.MjModel.from_xml_string(BLOCK)
    replay = Replay(model, None, [])
    for seed in range(40):
        data, rng = pushes(0.5, noise=0.0, seed=seed), np.random.default_rng(seed)
        zero, coarse = rng.uniform(), []
        for episode in data:
            qpos = episode.qpos + 1e-4 * rng.normal(size=episode.qpos.shape)
            qpos[:, 1] = 8e-4 * (np.round(episode.qpos[:, 1] / 8e-4 - zero) + zero)
            coarse.append(replace(episode, qpos=qpos, qvel=episode.qvel + 1e-4 * rng.normal(size=qpos.shape)))
        check_commands(replay, Dataset(coarse), np.zeros(0))


def test_late_logs_of_few_rows_are_seen():
    """Of an arm with a noise of a ten-thousandth, three hundred rows are enough, whichever they are."""
    replay = Replay(nominal(), None, [])
    for seed in range(6):
        sound = record(noise=1e-4, episodes=2, rows=150, seed=seed)
        check_commands(replay, sound, np.zeros(0))
        late = Dataset([Episode(e.name, e.time[1:], e.qpos[1:], e.qvel[1:], e.ctrl[:-1]) for e in sound])
        with pytest.raises(BadDataset, match="commands look one row late"):
            check_commands(replay, late, np.zeros(0))
