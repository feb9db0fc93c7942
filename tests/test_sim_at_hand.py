"""Simulators that were not used lately hold no memory, and simulate the same when they are."""

import gc

import numpy as np

from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim import MujocoSimulator
from nfpde.sim.cpu import _AT_HAND
from tests.models import PENDULUM, load, make_windows

SPACE = ParameterSpace([Parameter("dof_damping", "hinge", 0.0, 0.5)])
XI = np.array([[0.1], [0.3]])


def made(count):
    model = load(PENDULUM)
    return [MujocoSimulator(model, SPACE, nthread=1, check_influence=False) for _ in range(count)]


def test_those_used_last_keep_their_batch():
    """Used anew, one that gave it back takes the place of whoever was not used for longest."""
    sims, windows = made(_AT_HAND + 2), make_windows(load(PENDULUM), 5, 3)
    for sim in sims:
        sim.predict(XI, windows)
    assert [sim._batch is not None for sim in sims] == [False] * 2 + [True] * _AT_HAND
    sims[0].predict(XI, windows)
    assert [sim._batch is not None for sim in sims] == [True, False, False] + [True] * (_AT_HAND - 1)
    sims[3].predict(XI, windows)
    sims[1].predict(XI, windows)
    assert [sim._batch is not None for sim in sims[:5]] == [True, True, False, True, False]


def test_they_simulate_the_same():
    windows = make_windows(load(PENDULUM), 5, 3)
    alone = made(1)[0].predict(XI, windows)
    sims = made(_AT_HAND + 2)
    for sim in [*sims, *sims]:
        np.testing.assert_array_equal(sim.predict(XI, windows), alone)


def test_those_that_are_gone_take_no_place():
    (first,), windows = made(1), make_windows(load(PENDULUM), 5, 3)
    first.predict(XI, windows)
    for _ in range(2 * _AT_HAND):
        made(1)[0].predict(XI, windows)
        gc.collect()
    assert first._batch is not None
