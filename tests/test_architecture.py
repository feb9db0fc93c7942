"""The import rules, checked from the source text (nothing is imported)."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "nfpde"

# A unit may import only units of the rows above it; units of one row never import each other.
ROWS = [
    {"decimals", "errors", "kernels", "starting"},
    {"storage"},
    {"progress", "checkpoint"},
    {"parameters"},
    {"elements"},
    {"dataset", "truth"},
    {"effects"},
    {"sim", "flow", "ot"},
    {"live", "nearby"},
    {"distribution"},
    {"corner", "benchmarks", "losses"},
    {"estimation", "evaluate", "rl"},
    {"gap"},
    {"explained"},
    {"bench"},
    {"cli"},
]
RANK = {unit: rank for rank, row in enumerate(ROWS) for unit in row}

# Libraries that only these files may import, as paths below nfpde/; a folder stands for all its files.
ONLY_IN = {
    "zuko": ["flow/model.py"],
    "cma": ["gap/funnel.py"],
    "stable_baselines3": ["rl"],
    "nfpde._rust_ot": ["ot.py"],
    "pyarrow": ["dataset"],
    "mujoco_warp": ["sim"],
    "warp": ["sim", "kernels"],
    "typer": ["cli.py", "cli"],
}
WITHOUT_TORCH = ["errors", "storage", "progress", "parameters", "dataset", "elements", "effects", "sim"]


def files_of(unit):
    home = PACKAGE / unit
    return [*home.rglob("*.py")] or [home.with_suffix(".py")]


def imported_names(path):
    """Full dotted names the file imports, wherever in the file the import stands."""
    here = ["nfpde", *path.relative_to(PACKAGE).parent.parts] if PACKAGE in path.parents else []
    return names_in(path.read_text(encoding="utf-8"), here)


def names_in(source, here):
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level + 1] if node.level else []
            module = [*base, *(node.module or "").split(".")] if node.module else base
            names += [".".join([*module, a.name]) for a in node.names]
        elif isinstance(node, ast.Import):
            names += [a.name for a in node.names]
    return names


def existing_units():
    inside = [p for p in PACKAGE.iterdir() if p.is_dir() or p.suffix == ".py"]
    return sorted({p.stem for p in inside if not p.stem.startswith(("_", "."))})


def is_within(name, library):
    return name == library or name.startswith(library + ".")


def test_every_unit_has_a_row():
    """A new file or folder in nfpde/ takes its place among the rows."""
    assert set(existing_units()) <= RANK.keys()


@pytest.mark.parametrize("unit", existing_units())
def test_unit_imports_only_lower_rows(unit):
    """No unit imports one of its own row or of a row below it."""
    for path in files_of(unit):
        units = {n.split(".")[1] for n in imported_names(path) if n.startswith("nfpde.")}
        for other in (units & RANK.keys()) - {unit}:
            assert RANK[other] < RANK[unit], f"{path.relative_to(ROOT)} may not import nfpde.{other}"


def test_nothing_below_imports_the_whole_package():
    """`import nfpde` or `from nfpde import fit` inside the package would hide which unit is meant."""
    for path in PACKAGE.rglob("*.py"):
        for name in imported_names(path):
            module, _, attribute = name.partition(".")
            if module == "nfpde":
                assert attribute.split(".")[0] in {*RANK, "_rust_ot", "__version__"}, (
                    f"{path.relative_to(ROOT)}: {name}"
                )


@pytest.mark.parametrize("library", ONLY_IN)
def test_a_library_is_imported_in_its_place_only(library):
    """Each heavy or risky dependency has one door."""
    doors = [PACKAGE / where for where in ONLY_IN[library]]
    for path in PACKAGE.rglob("*.py"):
        if any(door == path or door in path.parents for door in doors):
            continue
        for name in imported_names(path):
            assert not is_within(name, library), f"{path.relative_to(ROOT)} may not import {library}"


@pytest.mark.parametrize("unit", [u for u in WITHOUT_TORCH if u in existing_units()])
def test_torch_stays_out(unit):
    """Data and simulation work, and start, without torch."""
    for path in files_of(unit):
        for name in imported_names(path):
            assert not is_within(name, "torch"), f"{path.relative_to(ROOT)} may not import torch"


def test_kernels_import_only_warp():
    """Kernels can be read by someone who knows only Warp."""
    for path in (PACKAGE / "kernels").rglob("*.py"):
        for name in imported_names(path):
            assert name.split(".")[0] in {"warp", "math"} or name.startswith("nfpde.kernels"), path.relative_to(ROOT)


def test_the_kernels_link_is_a_link_that_nobody_imports():
    """`kernels` shows where the kernels are; importing through it would load each of them twice."""
    link = ROOT / "kernels"
    assert link.is_symlink()
    assert link.readlink() == Path("nfpde/kernels")
    for path in [*PACKAGE.rglob("*.py"), *(ROOT / "tests").rglob("*.py")]:
        for name in imported_names(path):
            assert not is_within(name, "kernels"), f"{path.relative_to(ROOT)}: import nfpde.kernels instead"


def test_files_stay_readable():
    """One job a file: none over 400 lines, and no drawer for everything."""
    for path in PACKAGE.rglob("*.py"):
        assert path.stem not in {"utils", "util", "helpers", "common", "core", "misc"}, path.relative_to(ROOT)
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 400, path.relative_to(ROOT)


def test_no_pickle():
    """Files written by others are read without running code from them."""
    for path in PACKAGE.rglob("*.py"):
        for name in imported_names(path):
            assert name.split(".")[0] not in {"pickle", "cPickle", "dill", "joblib"}, path.relative_to(ROOT)


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("from nfpde.sim.cpu import MujocoSimulator", "nfpde.sim.cpu.MujocoSimulator"),
        ("def f():\n    import torch.nn", "torch.nn"),
        ("from . import states", "nfpde.sim.states"),
        ("from ..errors import BadInput", "nfpde.errors.BadInput"),
    ],
)
def test_imports_are_found(source, expected):
    """The reader of imports sees relative ones and those inside functions."""
    assert names_in(source, ["nfpde", "sim"]) == [expected]
