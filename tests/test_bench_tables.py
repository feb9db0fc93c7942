"""The benchmark tables: small runs of the real thing, and what their text claims."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from nfpde.bench import fit as fit_bench
from nfpde.bench import ot as ot_bench
from nfpde.bench.ot_threads import scaling
from nfpde.bench.ot_wanted import verdicts
from nfpde.estimation import NfpdeConfig

torch.set_num_threads(1)


def test_transport_table_names_peers_versions_and_losses(tmp_path, monkeypatch):
    """Small cases run beside the peers; the costs agree and the table says where this package is slower."""
    cases = (ot_bench.Case(20, 20, 3, "gauss", "uniform"), ot_bench.Case(15, 9, 2, "mix", "random"))
    monkeypatch.setattr(ot_bench, "QUICK", cases)
    ot_bench.run(True, tmp_path)
    record = json.loads((tmp_path / "ot_quick.json").read_text())
    assert [r["case"] for r in record["rows"]] == ["uniform n=20 d=3 gauss", "random 15 x 9 d=2 mix"]
    assert {"nfpde", "POT", "SciPy"} <= set(record["rows"][0]["seconds"])
    # the solvers are exact: only rounding of sums of twenty distances is left
    assert max(r["apart"] for r in record["rows"]) < 1e-12
    table = (tmp_path / "ot_quick.md").read_text()
    slower = sum(min(r["seconds"].values()) < r["seconds"]["nfpde"] for r in record["rows"])
    assert f"Slower than a peer in {slower} of 2 cases" in table
    assert "nfpde bench ot --quick" in table


def test_what_is_wanted_is_said_with_its_worst_case():
    """The smallest ratio of all cases and peers decides; time and memory of large cases have limits."""
    small = {"n": 100, "m": 100, "d": 6, "weights": "uniform"}
    rows = [
        {"case": "one", **small, "seconds": {"nfpde": 1.0, "POT": 3.0, "lapx": 1.5, "SciPy": 2.0}},
        {"case": "two", **small, "seconds": {"nfpde": 1.0, "POT": 3.0, "lapx": 0.5, "SciPy": 2.0}},
    ]
    large = [{"case": "big", "weights": "uniform", "seconds": 11.0, "megabytes": 120.0}]
    lines = verdicts(rows, large)
    assert "| uniform n=100, 300 | 1x lapjv and lapx and SciPy | 0.50x (lapx, two) | FAIL |" in lines
    assert "| every case | 1x POT and SciPy | 2.00x (SciPy, one) | pass |" in lines
    assert "| big | 12 s, 100 MB | 11.0 s, 120 MB | FAIL |" in lines
    assert len(lines) == 3  # nothing is said of what was not measured
    large = [large[0] | {"megabytes": float("nan"), "seconds": seconds} for seconds in (11.0, 13.0)]
    assert verdicts([], large) == [
        "| big | 12 s, 100 MB | 11.0 s, not measured | not measured |",
        "| big | 12 s, 100 MB | 13.0 s, not measured | FAIL |",
    ]


def test_threads_are_timed_and_change_no_bit():
    """A row for each power of two up to the cores; one cost."""
    x, y, a, b = ot_bench.clouds(ot_bench.Case(60, 50, 3, "gauss", "random"))
    rows = scaling(x, y, a, b)
    assert [row["threads"] for row in rows] == [2**k for k in range(len(rows))]
    assert all(row["seconds"] > 0 and row["same_bits"] for row in rows)


def test_transport_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    """A case that was measured before the interruption is not measured again; the file of parts is gone at the end."""
    cases = [ot_bench.Case(n, n, 2, "gauss", "uniform") for n in (8, 9)]
    monkeypatch.setattr(ot_bench, "QUICK", cases)
    measured = []

    def measure(case, peers):
        measured.append(case.n)
        if len(measured) == 2:
            raise KeyboardInterrupt
        return original(case, peers)

    original = ot_bench._measure
    monkeypatch.setattr(ot_bench, "_measure", measure)
    with pytest.raises(KeyboardInterrupt):
        ot_bench.run(True, tmp_path)
    ot_bench.run(True, tmp_path)
    assert measured == [8, 9, 9]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ot_quick.json", "ot_quick.md"]


def test_peers_of_another_environment(tmp_path, monkeypatch):
    """The second interpreter's solvers take part, with costs that agree; here it is this one, with stand-ins."""
    (tmp_path / "lapjv.py").write_text(
        "from scipy.optimize import linear_sum_assignment\n"
        "def lapjv(cost):\n    return linear_sum_assignment(cost)[::-1]\n"
    )
    package = tmp_path / "lapjv-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: lapjv\nVersion: 1.0\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    cases = (ot_bench.Case(20, 20, 3, "gauss", "uniform"), ot_bench.Case(15, 9, 2, "mix", "random"))
    monkeypatch.setattr(ot_bench, "QUICK", cases)
    ot_bench.run(True, tmp_path, Path(sys.executable))
    record = json.loads((tmp_path / "ot_quick.json").read_text())
    assert record["versions"]["lapjv"] == "1.0"
    assert ["lapjv" in row["seconds"] for row in record["rows"]] == [True, False]
    assert max(r["apart"] for r in record["rows"]) < 1e-12


@pytest.mark.parametrize("case", ot_bench.FULL, ids=str)
def test_clouds_are_what_the_case_says(case):
    """Sizes, weights that sum to one, duplicates and lattices."""
    x, y, a, b = ot_bench.clouds(case)
    assert x.shape == (case.n, case.d)
    assert y.shape == (case.m, case.d)
    if case.weights == "uniform":
        assert a is None
        assert b is None
    else:
        assert a is not None
        assert b is not None
        np.testing.assert_allclose([a.sum(), b.sum()], 1.0, rtol=1e-12)  # rounding of a sum
    if case.kind == "duplicates":
        assert len(np.unique(x, axis=0)) <= case.n // 10
    if case.kind == "lattice":
        assert (x == np.round(x)).all()


def test_fits_go_on_where_they_were_stopped(tmp_path, monkeypatch):
    """A cell that was fitted before the interruption is not fitted again; other code and other devices start afresh."""
    tiny = NfpdeConfig(iterations=1, samples=10, transitions=4, transforms=2, hidden=8, gradient_steps=1)
    monkeypatch.setattr(fit_bench, "NfpdeConfig", lambda **_: tiny)
    monkeypatch.setattr(fit_bench, "CELLS", (("softmax", "flow"), ("cai", "flow")))
    fitted, last = [], [3]
    real = fit_bench.fit

    def fit(*arguments, method, **options):
        fitted.append(method)
        if len(fitted) == last[0]:
            raise KeyboardInterrupt
        return real(*arguments, method=method, **options)

    monkeypatch.setattr(fit_bench, "fit", fit)
    with pytest.raises(KeyboardInterrupt):
        fit_bench.run(True, tmp_path)
    last[0] = 6
    with monkeypatch.context() as patch:
        patch.setattr(fit_bench, "code_of", lambda *_: "other")
        with pytest.raises(KeyboardInterrupt):
            fit_bench.run(True, tmp_path)
    assert fitted == ["softmax", "softmax", "cai"] * 2, "nothing of the first call has a place in the second"
    del fitted[:]
    last[0] = 3
    with pytest.raises(KeyboardInterrupt):
        fit_bench.run(True, tmp_path)
    fit_bench.run(True, tmp_path)
    assert fitted == ["softmax", "softmax", "cai", "cai", "cai"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["fit_quick.json", "fit_quick.md"]
    last[0] = 0
    table = (tmp_path / "fit_quick.md").read_text()
    assert table.count("| gaussian | 0 |") == table.count("| mixture | 0 |") == 2
    monkeypatch.setattr(fit_bench, "facts_of_device", lambda body, device: {"device": f"{device}: MuJoCo Warp"})
    asked = []
    make = fit_bench.make_simulator
    monkeypatch.setattr(fit_bench, "make_simulator", lambda *a, device: asked.append(device) or make(*a, device="cpu"))
    fit_bench.run(True, tmp_path, "warp-cpu")
    assert asked == ["warp-cpu"] * 4
    elsewhere = (tmp_path / "fit_warp-cpu_quick.md").read_text()
    assert "nfpde bench fit --device warp-cpu --quick" in elsewhere
    assert "MuJoCo Warp" in elsewhere
