"""The README's promises: its Python runs, its commands exist, its files are there."""

import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.main import get_command

import nfpde
from nfpde.benchmarks import collect, robot
from nfpde.cli import app

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def commands(page: Path) -> list[str]:
    """Command lines of a page: indented, or in a block of a shell."""
    return re.findall(r"^(?:    |\.venv/bin/)(nfpde (?!bench).*?)(?: +#.*)?$", page.read_text(), flags=re.MULTILINE)


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def test_python_of_the_readme_runs_in_order(tmp_path, monkeypatch):
    """Every Python block runs, after the ones before it, on a recorded Hopper."""
    hopper = robot("hopper")
    (tmp_path / "hopper.xml").write_text(hopper.path.read_text())
    nfpde.save_dataset(collect(hopper, "gaussian", episodes=12)[0], tmp_path / "logs.npz")
    monkeypatch.chdir(tmp_path)
    smallest = nfpde.TrajectoryConfig(starts=1, steps=1, rounds=1, draws=4, population_rounds=1)
    full = nfpde.fit
    monkeypatch.setattr(nfpde, "fit", lambda *a, **k: full(*a, **{"config": smallest, "quiet": True, **k}))
    monkeypatch.setattr(nfpde, "diagnose_gap", partial(nfpde.diagnose_gap, windows=20))
    rng = np.random.default_rng(0)
    scope: dict[str, Any] = {"x": rng.normal(size=(5, 2)), "y": rng.normal(size=(7, 2))}
    code = blocks("python")
    assert len(code) >= 4
    for block in code:
        exec(compile(block, "README.md", "exec"), scope)
    assert scope["result"].gap <= 1e-9, "the last block's transport result"
    assert "worn_gear" in nfpde.effect_names()


def test_toml_of_the_readme_is_a_parameter_space(tmp_path):
    """The parameters.toml shown is read, and holds what the text says."""
    (tmp_path / "parameters.toml").write_text(blocks("toml")[0])
    space = nfpde.ParameterSpace.from_toml(tmp_path / "parameters.toml")
    assert space.names == ["body_mass:thigh", "geom_friction:*"]


@pytest.mark.parametrize("line", sorted({c for page in PAGES for c in commands(page)}))
def test_commands_exist_with_their_options(line):
    """Every option of a command line shown, in the README or beside it, is one that the command has."""
    _, name, *words = line.split()
    command = get_command(app).commands[name]  # type: ignore[attr-defined]
    known = {option for p in command.params for option in p.opts}
    assert {w for w in words if w.startswith("--")} <= known


def test_make_targets_and_linked_files_exist():
    """What the README sends people to is there."""
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    named = set(re.findall(r"(?:`|^    )make ([a-z-]+)", README, flags=re.MULTILINE))
    assert {"demo", "test", "bench-gap"} <= named <= set(targets)
    for page in PAGES:
        for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text()):
            assert (page.parent / link).is_file(), (page, link)
