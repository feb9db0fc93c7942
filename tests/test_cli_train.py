"""`nfpde train` from the command line."""

import json
import shutil

import matplotlib.image
import mujoco
import numpy as np
import pytest

from nfpde.benchmarks import BENCHMARKS
from nfpde.benchmarks.pendulum import PENDULUM_XML
from nfpde.cli.fitted import check_model
from nfpde.distribution import ParameterDistribution
from nfpde.errors import BadInput
from nfpde.flow import build_flow
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import TASKS
from nfpde.sim import model_hash
from nfpde.truth import Truth
from tests.command_line import TINY, run


@pytest.fixture(scope="module")
def pendulums(tmp_path_factory):
    """A distribution over pendulums, as a folder."""
    home = tmp_path_factory.mktemp("pendulums")
    space = ParameterSpace([Parameter("body_mass", "pendulum", low=0.8, high=1.2)])
    ParameterDistribution(space, build_flow(1, hidden_features=(8,))).save(home / "distribution")
    Truth(space, np.array([[1.0], [1.1]]), ["a", "b"]).save(home / "truth.json")
    return home


def test_train(pendulums, tmp_path):
    """A policy for pendulums, its returns as JSON and as a picture."""
    sizes = ("--steps", 300, "--evaluation-every", 150, "--evaluation-episodes", 2, "--device", "cpu", "--quiet")
    files = ("--distribution", pendulums, "--truth", pendulums / "truth.json", "--out", tmp_path / "policy")
    status, out, err = run("train", "pendulum", *files, *sizes)
    assert (status, err) == (0, "")
    for name in ("policy.safetensors", "train.json", "returns.png"):
        assert (tmp_path / "policy" / name).is_file()
        assert name in out
    json.loads((tmp_path / "policy" / "train.json").read_text())
    assert min(matplotlib.image.imread(tmp_path / "policy" / "returns.png").shape[:2]) > 300


SIZES = ("--steps", 150, "--evaluation-every", 150, "--evaluation-episodes", 2, "--device", "cpu", "--quiet")
PARAMETERS = '[[parameter]]\nfield = "dof_damping"\ntarget = "hinge"\nlow = 0.01\nhigh = 0.2\n'


@pytest.fixture(scope="module")
def fits(tmp_path_factory):
    """A fit of the stock pendulum, and one of the same with a heavier bob in a file of its own."""
    home = tmp_path_factory.mktemp("fits")
    (home / "heavy.xml").write_text(PENDULUM_XML.read_text().replace('mass="0.6"', 'mass="2"'))
    (home / "unknown.toml").write_text(PARAMETERS)
    assert run("collect", "pendulum", "--episodes", 1, "--steps", 30, "--out", home / "data")[0] == 0
    for name, model in (("stock", "pendulum"), ("heavy", home / "heavy.xml")):
        files = ("--params", home / "unknown.toml", "--out", home / name)
        assert run("fit", model, home / "data", *files, *TINY)[::2] == (0, "")
    return home


def test_another_robot_than_the_fitted_one_is_refused(fits, tmp_path):
    """Environment, fit and way out in one line, from the fit's folder and from the distribution within."""
    for inner in ("", "distribution"):
        files = ("--distribution", fits / "heavy" / inner, "--out", tmp_path / "policy")
        status, out, err = run("train", "pendulum", *files, *SIZES)
        assert (status, out, err.count("\n")) == (1, "", 1)
        assert "environment nfpde/Pendulum-v0's own model is not the one that " in err
        assert f"{fits / 'heavy' / 'fit.json'} was fitted to: " in err
        assert "--model FILE" in err
    assert not (tmp_path / "policy").exists()
    files = ("--distribution", fits / "stock", "--model", fits / "heavy.xml", "--out", tmp_path / "policy")
    status, _, err = run("train", "pendulum", *files, *SIZES)
    assert status == 1
    assert f"the model {fits / 'heavy.xml'} is not the one that {fits / 'stock' / 'fit.json'} was fitted to" in err


def test_the_fitted_robot_is_trained_on(fits, tmp_path):
    """The stock one by its name, another one by its file, a third one where that is asked for."""
    ways = {"stock": (), "heavy": ("--model", fits / "heavy.xml"), "scene": ("--another-model",)}
    settings = {}
    for way, more in ways.items():
        fit = fits / ("heavy" if way == "scene" else way)
        assert run("train", "pendulum", "--distribution", fit, "--out", tmp_path / way, *more, *SIZES)[::2] == (0, "")
        settings[way] = json.loads((tmp_path / way / "train.json").read_text())["settings"]["model"]
    assert settings["heavy"] != settings["stock"] == settings["scene"]


def test_a_fit_that_names_no_model_is_taken(fits, tmp_path):
    """One of a function instead of a model, or of another MuJoCo, cannot be compared."""
    for simulator in ({"class": "CallableSimulator"}, {"class": "MujocoSimulator", "model": "5ca1", "mujoco": "0"}):
        fit = tmp_path / simulator["class"]
        shutil.copytree(fits / "heavy", fit)
        (fit / "fit.json").write_text(json.dumps({"schema_version": 1, "simulator": simulator}))
        assert run("train", "pendulum", "--distribution", fit, "--out", fit / "policy", *SIZES)[::2] == (0, "")


@pytest.mark.parametrize("name", sorted(set(BENCHMARKS) & set(TASKS)))
def test_every_benchmark_is_its_environments_model(name, tmp_path):
    """A fit by a benchmark's name is one of the robot that training by that name simulates."""
    body = BENCHMARKS[name]
    fit = {"schema_version": 1, "simulator": {"model": model_hash(body.model), "mujoco": mujoco.__version__}}
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    check_model(tmp_path / "fit.json", name, None, body.space)
    fit["simulator"]["model"] = "5ca1ab1e"
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    with pytest.raises(BadInput, match="is not the one that"):
        check_model(tmp_path / "fit.json", name, None, body.space)
