"""Ordinary slips in the arguments of trainings and evaluations: one line each, which says what to give."""

from typing import Any

import numpy as np
import pytest

from nfpde.errors import BadInput
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import RandomizedParameters, SacConfig, evaluate_policy, make_environment, train_sac

MASS = Parameter("body_mass", "pendulum", 0.4, 1.6)
SPACE = ParameterSpace([MASS])
LIST: Any = [MASS]
MADE: Any = r"env is a {}; give an environment's name or a function that makes it: two are needed, for training and"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"env": make_environment("pendulum")}, MADE.format(r"\w+")),
        (
            {"env": RandomizedParameters(make_environment("pendulum"), [0.7], SPACE)},
            MADE.format("RandomizedParameters"),
        ),
        ({"env": 3}, MADE.format("int")),
        ({"env": None}, MADE.format("NoneType")),
        ({"space": LIST}, r"space is a list; give a ParameterSpace, which ParameterSpace\(\[Parameter"),
        ({"hyperparameters": {"hidden": (8,)}}, r"hyperparameters is a dict; give a SacConfig, as in SacConfig\(hid"),
    ],
)
def test_trainings(tmp_path, change, text):
    """Before anything is made."""
    call: Any = {"env": "pendulum", "space": SPACE, **change}
    with pytest.raises(BadInput, match=text):
        train_sac(call.pop("env"), [[0.7]], steps=150, out=tmp_path / "out", quiet=True, **call)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("env", [make_environment("pendulum"), 3, None])
def test_environments_of_evaluations(env):
    """A made one cannot be told from one that is in use."""
    with pytest.raises(BadInput, match=MADE.format(r"\w+")):
        evaluate_policy(lambda o: o[2:], env, [[0.7]], space=SPACE)


def test_spaces():
    """A list is no space, wherever one is taken."""
    text = r"space is a list; give a ParameterSpace"
    with pytest.raises(BadInput, match=text):
        evaluate_policy(lambda o: o[2:], "pendulum", [[0.7]], space=LIST)
    with pytest.raises(BadInput, match=text):
        RandomizedParameters(make_environment("pendulum"), [0.7], LIST)
    env = RandomizedParameters(make_environment("pendulum"), [0.7], SPACE)
    with pytest.raises(BadInput, match=text):
        evaluate_policy(lambda o: o[2:], env, space=LIST)


@pytest.mark.parametrize("hidden", [64, None, np.float64(8)])
def test_hidden_layers(hidden):
    """One number stands for no layers."""
    with pytest.raises(BadInput, match=r"SAC: hidden is .*; give the neurons of each layer, as in \(256, 256\)"):
        SacConfig(hidden=hidden)
