"""The benchmark tables: small runs of the real thing, and what their text claims."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from nfpde.bench import fit as fit_bench
from nfpde.bench import ot as ot_bench
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


def test_fit_table_keeps_finished_cells(tmp_path, monkeypatch):
    """A second call finds its cells done and fits nothing; other settings start afresh."""
    tiny = NfpdeConfig(iterations=1, samples=10, transitions=4, transforms=2, hidden=8, gradient_steps=1)
    monkeypatch.setattr(fit_bench, "NfpdeConfig", lambda **_: tiny)
    monkeypatch.setattr(fit_bench, "CELLS", (("softmax", "flow"), ("cai", "flow")))
    fitted = []
    real = fit_bench.fit
    monkeypatch.setattr(fit_bench, "fit", lambda *a, **k: fitted.append(k["method"]) or real(*a, **k))
    fit_bench.run(True, tmp_path)
    assert fitted == ["softmax", "softmax", "cai", "cai"]
    fit_bench.run(True, tmp_path)
    assert len(fitted) == 4
    table = (tmp_path / "fit_quick.md").read_text()
    assert table.count("| gaussian | 0 |") == table.count("| mixture | 0 |") == 2
