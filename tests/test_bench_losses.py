"""The benchmark of prediction losses does what its table says."""

import json

import numpy as np
import pytest

from nfpde.bench import losses
from nfpde.benchmarks import robot
from nfpde.sim import MujocoSimulator

HOPPER = robot("hopper")


@pytest.fixture(scope="module")
def data():
    return losses._record(HOPPER, episodes=2, steps=15)


def test_recordings_are_the_nominal_robots(data):
    """At the nominal parameters the losses that are timed are zero but for the warm start."""
    sim = MujocoSimulator(HOPPER.model, HOPPER.space, check_influence=False)
    nominal = (HOPPER.space.low + HOPPER.space.high) / 2
    np.testing.assert_allclose(nominal, sim.nominal(), rtol=1e-14)
    assert sim.losses(nominal, data.transitions(), np.ones(sim.states.ndiff)).max() < 1e-20


def test_all_ways_do_what_they_count(data):
    """Every vector with every transition, and a share of them for the slow ways."""
    ways, n = losses._ways(HOPPER, data), len(data.transitions())
    counts = {name: way() for name, way in ways.items()}
    fast, slow = losses.VECTORS * n, len(range(0, n, losses.BATCH))
    assert list(counts.values()) == [fast, fast, fast, slow, slow]


def test_the_table_and_the_file(data, monkeypatch, tmp_path, capsys):
    """One row for every robot and way; the ratio is the C loop's time over the way's."""
    monkeypatch.setattr(losses, "ROBOTS", {"hopper": HOPPER})
    monkeypatch.setattr(losses, "_record", lambda robot: data)
    seconds = {losses.C_LOOP: [1.0, 3.0, 2.0], losses.ROWS: [2.0, 3.0, 8.0]}
    monkeypatch.setattr(losses, "_measure", lambda ways, repeats: seconds)
    losses.run(True, tmp_path)
    facts = json.loads((tmp_path / "losses_quick.json").read_text())
    first, second = facts["rows"]
    assert (first["ratio"], first["median_ratio"]) == (1, 1)
    assert (second["ratio"], second["median_ratio"]) == (0.5, 0.5)
    assert (second["evaluations_per_second"], second["median_per_second"]) == (0.5, 1 / 3)
    table = (tmp_path / "losses_quick.md").read_text()
    assert "nfpde bench losses --quick" in table
    assert facts["versions"]["mujoco"] in table
    assert table in capsys.readouterr().out
