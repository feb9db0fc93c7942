"""What a diagnosis holds: simulations of the candidates that it looks at, not of all that it has looked at."""

import weakref

import numpy as np

from nfpde import MujocoSimulator, diagnose_gap
from nfpde.gap.refit import FIRST
from nfpde.parameters import Parameter, ParameterSpace
from tests.gap_systems import nominal, record

SPACE = ParameterSpace([Parameter("dof_damping", "elbow", low=0.0, high=0.2)])


def test_what_is_released_is_taken_anew():
    """The same predictions, to the last bit."""
    sim, windows = MujocoSimulator(nominal(), SPACE, nthread=1), record(episodes=1, rows=60).windows(8)
    before = sim.predict([[0.1]], windows)
    sim.release()
    assert sim._batch is None
    np.testing.assert_array_equal(sim.predict([[0.1]], windows), before)


def test_candidates_hold_nothing_once_they_are_looked_at(monkeypatch):
    """Of dozens of candidates no more simulations live than are fitted beside each other, and those of the base."""
    alive, most = weakref.WeakSet[MujocoSimulator](), [0]
    prepared = MujocoSimulator._prepared_batch

    def counted(self, n):
        alive.add(self)
        batch = prepared(self, n)
        most[0] = max(most[0], sum(sim._batch is not None for sim in alive))
        return batch

    def rubs(data):
        return -0.15 * np.tanh(20 * data.qvel[1])

    dataset = record(force=rubs, noise=1e-3, episodes=4, rows=200)
    monkeypatch.setattr(MujocoSimulator, "_prepared_batch", counted)
    found = diagnose_gap(nominal(), dataset, SPACE, windows=40)
    assert found.candidates > 40
    assert 1 < most[0] <= FIRST[0] + 6
