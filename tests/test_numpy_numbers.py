"""Numbers out of arrays are as good as plain ones, wherever a number is asked for."""

import json
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
import torch

import nfpde
from nfpde.errors import BadInput
from nfpde.flow import GaussianMixture, build_flow
from tests.linear_robots import SPACE, linear_simulator, moments

torch.set_num_threads(1)

NUMPY: Any = np  # its numbers are no `int` to a type checker
UINT8, INT32, INT64, FLOAT32, FLOAT64 = NUMPY.uint8, NUMPY.int32, NUMPY.int64, NUMPY.float32, NUMPY.float64


def population():
    return nfpde.ParameterDistribution(SPACE, GaussianMixture(torch.ones(1), torch.zeros(1, 2), torch.eye(2)[None]))


@pytest.mark.parametrize(("given", "plain"), [(INT64(3), 3), (UINT8(3), 3)])
def test_settings_take_numpy_integers(given, plain):
    """They become plain ones, which a checkpoint can hold."""
    config = nfpde.TrajectoryConfig(starts=given)
    assert config == nfpde.TrajectoryConfig(starts=plain)
    assert json.loads(json.dumps(asdict(config)))["starts"] == plain


def test_settings_take_numpy_numbers():
    """Of single precision too, and integers for numbers."""
    config = nfpde.NfpdeConfig(learning_rate=FLOAT32(0.5), clip=INT64(1), beta=FLOAT64(0.25))
    assert json.loads(json.dumps(asdict(config))) == asdict(nfpde.NfpdeConfig(learning_rate=0.5, clip=1, beta=0.25))


@pytest.mark.parametrize("value", [None, np.bool_(True), True, 2.0, FLOAT64(2.0), "2", INT64(0), np.ones(2)])
def test_an_integer_setting_takes_nothing_else(value):
    """No truth value, no fraction, nothing below its least, and None only where a setting may be left open."""
    with pytest.raises(BadInput, match=r"starts is .* must be an integer of at least 1"):
        nfpde.TrajectoryConfig(starts=value)
    assert nfpde.NfpdeConfig(beta=None).beta is None


def test_samples_and_measures_take_numpy_integers():
    """Numbers of samples and seeds give what plain ones give."""
    found = population()
    assert np.array_equal(found.sample(INT64(3), INT64(1)), found.sample(3, 1))
    truth = nfpde.Truth(SPACE, np.array([[1.0, 2.0]]), ["a"])
    given = nfpde.evaluate(found, truth, samples=INT64(50), seed=INT32(4))
    assert given.to_json() == nfpde.evaluate(found, truth, samples=50, seed=4).to_json()
    assert nfpde.Parameter("geom_friction", "*", 0, 1, component=INT64(1)) == nfpde.Parameter(
        "geom_friction", "*", 0, 1, component=1
    )
    flow = build_flow(INT64(2), hidden_features=[INT64(8)], transforms=INT64(2), seed=INT64(1))
    json.dumps(flow.config())


def test_a_fit_takes_a_numpy_seed(tmp_path):
    """It is the plain one's run: the same folder is read back."""
    dataset = nfpde.Dataset(moments("a", (1.0, 0.5), np.random.default_rng(0)))
    config = nfpde.TrajectoryConfig(starts=1, rounds=1, population_rounds=1)
    first = nfpde.fit(linear_simulator(), dataset, config=config, seed=INT64(3), out=tmp_path, quiet=True)
    again = nfpde.fit(linear_simulator(), dataset, config=config, seed=3, out=tmp_path, quiet=True)
    assert again.info["seed"] == first.info["seed"] == 3
    with pytest.raises(BadInput, match="seed"):
        nfpde.fit(linear_simulator(), dataset, config=config, seed=FLOAT64(3.0), quiet=True)


def test_no_episodes_of_an_earlier_fit_are_left(tmp_path):
    """A folder that is saved into again holds the new result alone."""
    found = population()
    nfpde.FitResult(found, found, [], {"method": "trajectory"}, found).save(tmp_path)
    assert nfpde.FitResult.load(tmp_path).episodes is not None
    nfpde.FitResult(found, found, [], {"method": "softmax"}).save(tmp_path)
    assert nfpde.FitResult.load(tmp_path).episodes is None
    assert not (tmp_path / "episodes").exists()
