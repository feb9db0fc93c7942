"""A table of hidden faults is never lost: not to fewer systems, nor to those of another seed, limit or code."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from nfpde.bench.gap import cases as case_module
from nfpde.bench.gap import run as bench
from nfpde.cli import app
from nfpde.errors import BadInput


def made_up(case: case_module.Case) -> int:
    """A case that is finished at once."""
    for path, content in (
        (case.answer, {"status": "time limit", "seconds": 1.0, "diagnosis": None}),
        (case.key, {"faults": [], "index": case.index, "kind": "none", "robot": "arm"}),
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content))
    return case.index


@pytest.fixture(autouse=True)
def _no_diagnosis(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "run_case", made_up)


def test_fewer_cases_lose_no_row(tmp_path: Path):
    """The table keeps what it had, says of how many systems it is, and a later call measures only what is missing."""
    out = tmp_path / "out"
    first = bench.run(31, out, cases=3, folder=tmp_path / "here")
    assert bench.run(31, out, cases=1, folder=tmp_path / "there") == first
    assert [row["index"] for row in json.loads((out / "gap.json").read_text())["rows"]] == [0, 1, 2]
    assert "bench gap --seed 31 --cases 3 " in (out / "gap.md").read_text()
    assert not (tmp_path / "there" / "answers").exists()
    # the second system is missing: it is not among those that are asked for, and is not made up for
    content = json.loads((out / "gap.json").read_text())
    (out / "gap.json").write_text(json.dumps(content | {"rows": content["rows"][::2]}))
    assert bench.run(31, out, cases=1, folder=tmp_path / "there") == first[::2]
    assert "Stopped after 2 of 3 systems." in (out / "gap.md").read_text()
    assert bench.run(31, out, cases=2, folder=tmp_path / "there") == first
    assert [p.name for p in (tmp_path / "there" / "answers").iterdir()] == ["0001.json"]


@pytest.mark.parametrize(
    ("seed", "limit", "code", "words"),
    [
        (32, 300.0, "this", "seed 31, this one has 32"),
        (31, 60.0, "this", r"limit 300\.0, this one has 60\.0"),
        (31, 300.0, "that", "code 'this', this one has 'that'"),
    ],
)
def test_a_table_of_others_is_refused(tmp_path, monkeypatch, seed, limit, code, words):
    """Before anything is measured or written, and the message says what to do."""
    monkeypatch.setattr(bench, "fingerprint", lambda device: "this")
    bench.run(31, tmp_path / "out", cases=2, folder=tmp_path / "here")
    before = {p.name: p.read_bytes() for p in (tmp_path / "out").iterdir()}
    monkeypatch.setattr(bench, "fingerprint", lambda device: code)
    with pytest.raises(BadInput, match=rf"gap\.json is a table with {words}; give another folder"):
        bench.run(seed, tmp_path / "out", cases=1, folder=tmp_path / "there", limit=limit)
    assert {p.name: p.read_bytes() for p in (tmp_path / "out").iterdir()} == before
    assert not (tmp_path / "there").exists()


def test_every_seed_has_a_folder_of_its_own(tmp_path, monkeypatch):
    """The command writes no table over that of another seed."""
    monkeypatch.chdir(tmp_path)
    for seed in ("31", "32"):
        result = CliRunner().invoke(app, ["bench", "gap", "--seed", seed, "--cases", "1"])
        assert result.exit_code == 0, result.output
    assert sorted(p.parent.name for p in Path("docs/results").rglob("gap.json")) == ["gap_31", "gap_32"]


@pytest.mark.parametrize(("asked", "drawn"), [("3", 3), ("40", 12)])
def test_quick_draws_no_more_than_asked_for(tmp_path, monkeypatch, asked, drawn):
    """Twelve at most, and fewer where fewer are asked for."""
    made = []
    monkeypatch.setattr(bench, "draw_only", lambda *_, cases, kind: made.append(cases))
    call = ["bench", "gap", "--seed", "31", "--draw-only", "--quick", "--cases", asked, "--folder", str(tmp_path)]
    assert CliRunner().invoke(app, call).exit_code == 0
    assert made == [drawn]
