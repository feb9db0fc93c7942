"""The benchmark of losses on a device does what its table says; tried on Warp's CPU device."""

import json
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_ind

from nfpde.bench import devices, losses_warp
from nfpde.bench import losses as recordings
from nfpde.bench.device_rows import CHANCE, diagnosis_row, softmax_row, trajectory_row
from nfpde.bench.estimation.calibration import CalibrationSettings, problem
from nfpde.bench.estimation.cell import facts_of_device
from nfpde.bench.partial import Partial
from nfpde.benchmarks import robot
from nfpde.errors import BadInput
from nfpde.estimation import NfpdeConfig, TrajectoryConfig
from nfpde.gap import Fitted
from nfpde.sim.warp import WarpSimulator
from nfpde.sim.warp_bare import bare_stepping
from tests.device import WARP


def in_this_process(folder):
    """What measures a robot here, where tests can reach it."""

    def measured(robot, device, quick):
        losses_warp.measure(robot.name, device, quick, str(folder / "rows.json"))
        return json.loads((folder / "rows.json").read_text())

    return measured


def test_the_table_and_the_file(monkeypatch, tmp_path, capsys):
    """One row for each robot and size: every pair counted once, rates of the same run beside each other."""
    hopper = robot("hopper")
    monkeypatch.setattr(losses_warp, "ROBOTS", {"hopper": hopper})
    monkeypatch.setattr(losses_warp, "VECTORS", 4)
    monkeypatch.setattr(losses_warp, "TINY_SIZES", (4, 24))
    monkeypatch.setattr(losses_warp, "_starts", lambda *_, cold: {"warm": 1.0})
    monkeypatch.setattr(losses_warp, "_in_its_own_process", in_this_process(tmp_path))
    calls = []
    original = WarpSimulator.losses
    monkeypatch.setattr(
        WarpSimulator,
        "losses",
        lambda self, xi, w, scale: calls.append(len(xi) * len(w)) or original(self, xi, w, scale),
    )
    losses_warp.run(True, tmp_path, "warp-cpu")
    facts = json.loads((tmp_path / "losses_warp-cpu_quick.json").read_text())
    assert [row["pairs"] for row in facts["rows"]] == [4, 24]
    assert set(calls) == {4, 24}
    for row in facts["rows"]:
        assert row["worlds_at_once"] == row["pairs"]
        for what in ("bare", "nominal"):
            share = row["evaluations_per_second"] / row[f"{what}_per_second"]
            assert row[f"share_of_{what}"] == pytest.approx(share)
        assert row["cpu_per_second"] > 0
        assert row["measured_bytes"] is None
        assert row["median_apart"] < 1e-3
        assert row["share_apart"] == 0
    table = (tmp_path / "losses_warp-cpu_quick.md").read_text()
    assert "nfpde bench losses --device warp-cpu --quick" in table
    assert "hopper warm 1.0 s" in table
    assert table in capsys.readouterr().out
    assert not list(tmp_path.glob("*.part.json"))


def test_bare_steps_are_those_of_the_losses():
    """The mark steps the same simulations, each with its parameters; or all of them with the nominal ones."""
    body = robot("hopper")
    sim = WarpSimulator(body.model, body.space, device=WARP, check_influence=False)
    windows = recordings._record(body, episodes=1, steps=8).transitions()
    xi = body.space.uniform(3, np.random.default_rng(0))
    expected = sim.predict(xi, windows)[:, :, 0]
    for vectors, wanted in ((xi, expected), (None, sim.predict(sim.nominal()[None].repeat(3, 0), windows)[:, :, 0])):
        steps: Any = bare_stepping(sim, 3, windows, vectors)
        for _ in range(2):  # every call begins anew
            steps()
        _, d, *_ = steps.args[2]
        found = np.hstack([d.qpos.numpy(), d.qvel.numpy()]).reshape(len(windows), 3, -1).swapaxes(0, 1)
        # one way derives the model's constants on the host, the other on the device
        np.testing.assert_allclose(found, wanted, atol=1e-4)
    assert np.abs(wanted - expected).max() > 1e-2


def test_a_table_that_was_stopped_goes_on(monkeypatch, tmp_path, capsys):
    """Robots that were measured are not measured again, until the table is whole or something else is measured."""
    monkeypatch.setattr(losses_warp, "ROBOTS", {n: robot(n) for n in ("hopper", "walker2d")})
    monkeypatch.setattr(losses_warp, "_starts", lambda *_, cold: {"cold" if cold else "warm": 1.0})
    measured = []

    def measure(robot, device, quick):
        measured.append(robot.name)
        if measured == ["hopper", "walker2d"]:
            raise KeyboardInterrupt
        missing = dict.fromkeys(("bare_per_second", "nominal_per_second", "cpu_per_second"), 1.0)
        rows = [sized(0.95, 1e6, 90) | missing | {"robot": robot.name, "pairs": 1}]
        return {"rows": rows, "device": "a card"}

    monkeypatch.setattr(losses_warp, "_in_its_own_process", measure)
    with pytest.raises(KeyboardInterrupt):
        losses_warp.run(False, tmp_path, "warp-cpu")
    losses_warp.run(False, tmp_path, "warp-cpu")
    assert measured == ["hopper", "walker2d", "walker2d"]
    assert "going on from" in capsys.readouterr().out
    facts = json.loads((tmp_path / "losses_warp-cpu.json").read_text())
    assert [row["robot"] for row in facts["rows"]] == ["hopper", "walker2d"]
    assert facts["start_seconds"] == {"hopper": {"cold": 1.0}, "walker2d": {"warm": 1.0}}
    losses_warp.run(False, tmp_path, "warp-cpu")
    assert measured[3:] == ["hopper", "walker2d"]


def test_parts_of_another_measurement_are_not_taken(tmp_path):
    """Another version, device or command begins anew."""
    path = tmp_path / "table.part.json"
    assert Partial(path, {"version": 1}).get("a", lambda: 1) == 1
    assert Partial(path, {"version": 1}).get("a", lambda: 2) == 1
    assert Partial(path, {"version": 2}).get("a", lambda: 2) == 2


def test_other_devices_are_refused(tmp_path):
    """The table of the plain CPU is another command's."""
    with pytest.raises(BadInput, match="cuda or warp-cpu"):
        losses_warp.run(True, tmp_path, "cpu")


def test_a_problem_of_the_calibration_on_both_devices():
    """The same recordings fitted with either simulator: best values apart by a fraction of their standard deviation."""
    settings = CalibrationSettings(TrajectoryConfig(starts=2, steps=4, rounds=3), steps=30, samples=99)
    here, there = (problem("pendulum", "", settings, 0, device) for device in ("cpu", "warp-cpu"))
    assert here["true"] == there["true"]
    apart = np.abs(np.array(there["value"]) - here["value"])
    # single precision moves no estimate by what its recordings could tell
    assert (apart < 0.05 * np.array(here["std"])).all()


def test_a_file_says_where_its_fits_were_simulated():
    """Nothing on the CPU, as in all files before; elsewhere the device and what it is."""
    body = robot("hopper")
    assert facts_of_device(body, "cpu") == {}
    assert facts_of_device(body, "warp-cpu")["device"].startswith("warp-cpu: MuJoCo Warp")


def sized(share, rate, used):
    return {
        "robot": "hopper",
        "worlds_at_once": 32_000,
        "share_of_bare": share,
        "share_of_nominal": 0.8,
        "evaluations_per_second": rate,
        "predicted_bytes": 100,
        "measured_bytes": used,
        "median_apart": 1e-5,
        "share_apart": 0.0,
    }


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        (
            [sized(0.95, 1e6, 90), sized(0.93, 1.05e6, 95)],
            r"hopper: pass; least share 0.93 \(0.80 of one model\), larger / smaller sizes' rate 1.00, .* 0.95, ",
        ),
        ([sized(0.95, 1e6, 90), sized(0.85, 1e6, 90)], "hopper: FAIL; least share 0.85"),
        # a GPU that was not full may become faster, one that was must not become slower
        ([sized(0.95, 1e6, 90), sized(0.95, 2e6, 90)], "hopper: pass; .* rate 1.00, memory used / predicted 0.90"),
        ([sized(0.95, r, 90) for r in (1e6, 2e6, 1.5e6)], "hopper: FAIL; .* rate 0.75, memory used / predicted 0.90"),
        ([sized(0.95, 1e6, 150)], "hopper: FAIL; least share 0.95 .* rate 1.00, memory used / predicted 1.50"),
        ([sized(0.95, 1e6, 90) | {"share_apart": 0.002}], "hopper: FAIL; .* 0.20% beyond 1%"),
        ([sized(0.5, 1e6, 90) | {"worlds_at_once": 1000}], "hopper: no size with 30000 worlds at once was measured"),
    ],
)
def test_what_is_wanted_of_a_gpu(rows, text):
    """Share of bare stepping, linearity and memory each decide, over the sizes that fill a GPU."""
    assert re.search(text, "\n".join(losses_warp._verdicts(rows)))


def test_a_world_that_is_wrong_shows_wherever_it_is():
    """Losses of windows that come again are compared with double precision at every place where that is known."""
    expected = np.array([[1.0, 2.0], [3.0, 4.0]])
    found = np.tile(np.hstack([expected, [[9.0], [9.0]]]), 4)
    assert losses_warp._apart(found, expected, 3).shape == (2, 8)
    assert losses_warp._apart(found, expected, 3).max() == 0
    found[1, 10] = 4.4
    assert (losses_warp._apart(found, expected, 3) > 0.05).sum() == 1


@pytest.mark.parametrize(
    ("taken", "calls", "told"),
    [
        ([0.004] + [0.012] * 10 + [0.008] * 100, 1 + 58, 0.008),
        ([3.0, 5.0, 4.0, 3.0, 4.0], 1 + 3, 4.0),
        ([0.1, 0.3, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2], 1 + 7, 0.2),
    ],
    ids=["something else ran for the first tenth of a second", "long calls", "the wanted calls take long enough"],
)
def test_what_slows_few_calls_down_is_not_told(monkeypatch, taken, calls, told):
    clock, made = [0.0], []

    def way():
        clock[0] += taken[len(made)]
        made.append(taken[len(made)])
        return len(made)

    monkeypatch.setattr(losses_warp, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    seconds, last = losses_warp._seconds(way, repeats=7)
    assert (seconds, last) == (pytest.approx(told), calls)


def test_from_end_to_end_on_both_devices(monkeypatch, tmp_path, capsys):
    """A row with seconds, answers and verdict for both fits and a diagnosis, each of them run on both devices."""
    small = devices.Sizes(
        episodes=2,
        steps=20,
        softmax=NfpdeConfig(iterations=1, samples=10, transitions=4, transforms=1, hidden=4),
        trajectory=TrajectoryConfig(starts=2, steps=6, rounds=8, draws=20, population_rounds=1),
        seeds=2,
        systems=(5,),
        windows=40,
    )
    asked = []

    def diagnose(model, data, space, *, seed, windows, device):
        asked.append((device, windows, len(data) > 0, model.is_file()))
        cause = SimpleNamespace(
            effect="backlash" if device == "cpu" else "dead_zone",
            target="elbow",
            parameters={"width": Fitted(0.1, 0.09, 0.11, "rad")},
        )
        gap = SimpleNamespace(after_effects=0.25)
        return SimpleNamespace(verdict="effects", effects=[cause], base={}, gap=gap)

    monkeypatch.setattr(devices, "QUICK", small)
    monkeypatch.setattr(devices, "ROBOT", "pendulum")
    monkeypatch.setattr(devices, "diagnose_gap", diagnose)
    monkeypatch.setattr(losses_warp, "run", lambda *_: None)
    devices.run(True, tmp_path, "warp-cpu")
    facts = json.loads((tmp_path / "devices_warp-cpu_quick.json").read_text())
    assert [name.split(":")[0] for name in facts["devices"]] == ["cpu", "warp-cpu"]
    trajectory, softmax, diagnosis = facts["rows"]
    # either search stops within 0.03 standard deviations of its optimum (1e-3 in cost), by its own noise estimate
    assert max(trajectory["standard_deviations"]) < 0.3
    # nor is it rounding that decides where they stop
    assert 0 < max(trajectory["by_rounding"]) < 0.3
    assert trajectory["same"]
    assert [len(distances) for distances in softmax["distances"]] == [2, 2]
    assert asked == [("cpu", 40, True, True), ("warp-cpu", 40, True, True)]
    assert diagnosis["answers"] == ["effects, backlash elbow (width 0.1)", "effects, dead_zone elbow (width 0.1)"]
    table = (tmp_path / "devices_warp-cpu_quick.md").read_text()
    assert "nfpde bench devices --device warp-cpu --quick" in table
    assert table in capsys.readouterr().out
    assert table.count("| FAIL |") == 1 + (not softmax["same"])
    assert not list(tmp_path.glob("*.part.json"))


def of_distances(*distances):
    return [{"seconds": 1.0, "distance": d} for d in distances]


def test_softmax_on_two_devices_is_judged_by_the_spread_of_seeds():
    """The t-test of two samples, against scipy's: a difference within the seeds' spread is none, a wider one fails."""
    rng = np.random.default_rng(0)
    a, b = 0.3 + 0.02 * rng.normal(size=5), 0.3 + 0.02 * rng.normal(size=5)
    for shift in (0.0, 0.01, 0.02, 0.03, 0.04, -0.1):
        row = softmax_row("fit", of_distances(*a), of_distances(*(b + shift)))
        assert row["same"] == (np.asarray(ttest_ind(a, b + shift))[1] > CHANCE)
    assert softmax_row("fit", of_distances(0.2, 0.2), of_distances(0.2, 0.2))["same"], "the same numbers"
    assert not softmax_row("fit", of_distances(0.2, np.nan), of_distances(0.2, 0.2))["same"], "no number"


def test_the_same_devices_are_seldom_called_different():
    """Of 2000 comparisons of five seeds with five, one in twenty fails, within four binomial standard deviations."""
    draws = np.random.default_rng(1).normal(size=(2000, 2, 5))
    failed = sum(not softmax_row("fit", of_distances(*a), of_distances(*b))["same"] for a, b in draws)
    assert abs(failed - 100) < 4 * np.sqrt(2000 * 0.05 * 0.95)


@pytest.mark.parametrize(("moved", "same"), [(0.0, True), (0.4, True), (0.5, False), (np.nan, False)])
def test_trajectories_are_judged_in_their_standard_deviations(moved, same):
    """The worst robot and parameter counts: 0.3 of both fits' deviations together, which is 0.42 of either's."""
    value, std = np.array([[1.0, 20.0], [2.0, 30.0]]), np.array([[0.1, 5.0], [0.2, 7.0]])
    other = value.copy()
    other[1, 0] += moved * std[1, 0]
    fits = [
        {"seconds": 1.0, "distance": 0.1, "converged": done, "value": v.tolist(), "std": std.tolist()}
        for v, done in ((value, True), (other, False))
    ]
    row = trajectory_row("fit", fits[0], fits[1])
    assert row["same"] == same
    assert row["answers"] == ["0.1 from the truth", "0.1 from the truth, stopped before it settled"]


def test_robots_that_rounding_moves_are_told_and_not_judged():
    """One of three robots is elsewhere on the CPU already; the two that are not have the same answer, 0.1 apart."""
    value, std = np.array([[1.0], [2.0], [3.0]]), np.array([[0.1], [0.1], [0.1]])

    def fit(*moved):
        there = value + np.sqrt(2) * std * np.array(moved)[:, None]
        return {"seconds": 1.0, "distance": 0.1, "converged": True, "value": there.tolist(), "std": std.tolist()}

    here, there = fit(0, 0, 0), fit(0.1, -0.7, 0.02)
    assert not trajectory_row("fit", here, there)["same"]
    rounded = [fit(0, 0.2, 0), fit(0.1, 0.5, 0), fit(0, 0, 0.01)]
    row = trajectory_row("fit", here, there, rounded)
    assert row["same"]
    assert row["apart"] == (
        "0.1 standard deviations at most; 0.3 allowed, of 2 of 3 robots; others, and A by rounding alone: 0.7 (0.5)"
    )
    assert row["by_rounding"] == pytest.approx([0.1, 0.5, 0.01])
    assert not trajectory_row("fit", here, fit(0.4, -0.7, 0.02), rounded)["same"], "a robot that rounding leaves alone"
    assert not trajectory_row("fit", here, here, [fit(1, 1, 1)])["same"], "no robot is left to judge"


def found(verdict="effects", cause="backlash elbow", value=0.1, mass=1.0):
    causes = {cause: {"width": {"value": value, "low": value - 0.01, "high": value + 0.01}}} if cause else {}
    base = {"mass": {"value": mass, "low": 0.9, "high": 1.1}}
    return {"seconds": 1.0, "verdict": verdict, "causes": causes, "parameters": base, "left": 0.2}


@pytest.mark.parametrize(
    ("other", "says"),
    [
        (found(), "2 fitted values within each other's intervals; gap left 0.2, 0.2"),
        (found(value=0.109), "2 fitted values within each other's intervals; gap left 0.2, 0.2"),
        (found(value=0.111), "outside of the other's interval: backlash elbow width; gap left 0.2, 0.2"),
        (found(mass=1.2), "outside of the other's interval: mass; gap left 0.2, 0.2"),
        (found(cause="backlash hip"), "other causes; gap left 0.2, 0.2"),
        (found("unexplained", cause=""), "another verdict; other causes; gap left 0.2, 0.2"),
    ],
)
def test_diagnoses_are_judged_by_verdict_causes_and_values(other, says):
    """Each difference is named and fails; values may differ by what the recordings leave open."""
    row = diagnosis_row("diagnosis", found(), other)
    assert row["apart"] == says
    assert row["same"] == says.startswith("2 fitted")
