"""`nfpde train` from the command line."""

import json

import matplotlib.image
import numpy as np
import pytest

from nfpde.distribution import ParameterDistribution
from nfpde.flow import build_flow
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.truth import Truth
from tests.command_line import run


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
