"""Distributions over the physical parameters."""

import io
import json
from typing import Any

import numpy as np
import pytest
import torch
from rich.console import Console
from safetensors.torch import load_file, save_file

from nfpde.distribution import ParameterDistribution
from nfpde.errors import BadInput, SpaceMismatch
from nfpde.flow import GaussianMixture, build_flow
from nfpde.parameters import Parameter, ParameterSpace

torch.set_num_threads(1)  # the tensors are small: more threads only wait for each other

ONE = ParameterSpace([Parameter("mass", low=2.0, high=6.0, unit="kg")])
TWO = ParameterSpace([*ONE, Parameter("damping", low=0.0, high=0.01)])


def make(kind: Any = "realnvp", space=TWO):
    d = len(space)
    if kind == "mixture":
        means = torch.stack([torch.full((d,), -1.0), torch.linspace(0.5, 1.5, d)])
        covariances = torch.stack([0.3 * torch.eye(d) + 0.2, 0.5 * torch.eye(d)])
        return ParameterDistribution(space, GaussianMixture(torch.tensor([0.25, 0.75]), means, covariances))
    flow = build_flow(d, kind, transforms=3, hidden_features=(16, 16), seed=3)
    g = torch.Generator().manual_seed(7)
    with torch.no_grad():
        for p in flow.parameters():
            p.add_(0.1 * torch.randn(p.shape, generator=g, dtype=torch.float64))
    return ParameterDistribution(space, flow)


CASES = [("nsf", ONE), ("mixture", ONE), ("realnvp", TWO), ("mixture", TWO)]


def grid(space, n):
    """Midpoints of n cells a parameter, (n**D, D), and the volume of a cell."""
    lines = [low + (high - low) * (np.arange(n) + 0.5) / n for low, high in zip(space.low, space.high, strict=True)]
    points = np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, len(space))
    return points, np.prod(space.width / n)


@pytest.mark.parametrize(("kind", "space"), CASES)
def test_density_integrates_to_one_over_the_box(kind, space):
    """The density in physical units, summed over a grid of the box, is one."""
    points, volume = grid(space, 20000 if len(space) == 1 else 250)
    total = np.exp(make(kind, space).log_prob(points)).sum() * volume
    # the midpoint rule near the bounds, where the slope of the sigmoid is steepest, keeps about three digits
    assert total == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize(("kind", "space"), CASES)
def test_moments_of_samples_are_the_moments_of_the_density(kind, space):
    """Mean, standard deviation and median of samples agree with integrals over a grid."""
    distribution = make(kind, space)
    points, volume = grid(space, 20000 if len(space) == 1 else 250)
    p = np.exp(distribution.log_prob(points)) * volume
    mean = p @ points
    std = np.sqrt(p @ (points - mean) ** 2)
    n = 20_000
    # five standard errors, and what the grid misses
    np.testing.assert_allclose(distribution.mean(n), mean, atol=(5 / n**0.5 + 2e-3) * std.max(), rtol=2e-3)
    np.testing.assert_allclose(distribution.std(n), std, rtol=5 / n**0.5)
    median = distribution.quantiles(0.5, n)
    below = np.array([p[points[:, i] <= median[i]].sum() for i in range(len(space))])
    np.testing.assert_allclose(below, 0.5, atol=5 * 0.5 / n**0.5 + 4e-3)
    assert distribution.quantiles([0.1, 0.9]).shape == (2, len(space))


def test_log_prob_is_minus_infinity_outside_the_open_box():
    """On a bound and beyond, in any parameter, also far away."""
    distribution = make()
    xi = [[2.0, 0.005], [4.0, 0.01], [1.0, 0.005], [4.0, np.inf], [4.0, 0.005]]
    values = distribution.log_prob(xi)
    assert (values[:4] == -np.inf).all()
    assert np.isfinite(values[4])
    assert distribution.log_prob(np.empty((0, 2))).shape == (0,)


def test_log_prob_does_not_depend_on_the_batch(monkeypatch):
    """Points evaluated in pieces give what they give at once."""
    distribution = make()
    xi = distribution.sample(10)
    whole = distribution.log_prob(xi)
    monkeypatch.setattr("nfpde.distribution.distribution._CHUNK", 3)
    # matrix products of other sizes may round otherwise
    np.testing.assert_allclose(distribution.log_prob(xi), whole, rtol=1e-12)


def test_samples_repeat_and_leave_global_generators_alone():
    """Equal seeds give equal samples; torch's and NumPy's global states do not move."""
    distribution = make()
    before = torch.get_rng_state(), np.random.get_state(legacy=False)  # noqa: NPY002
    xi = distribution.sample(30, seed=4)
    assert xi.dtype == np.float64
    np.testing.assert_array_equal(xi, distribution.sample(30, seed=4))
    assert not np.array_equal(xi, distribution.sample(30, seed=5))
    assert torch.equal(torch.get_rng_state(), before[0])
    np.testing.assert_equal(np.random.get_state(legacy=False), before[1])  # noqa: NPY002


def test_samples_stay_inside_the_open_box():
    """A density far beyond float64's sigmoid still gives samples with a finite log density."""
    eye = torch.eye(2)[None]
    for far in (800.0, -800.0):
        distribution = ParameterDistribution(TWO, GaussianMixture(torch.ones(1), torch.full((1, 2), far), eye))
        xi = distribution.sample(5)
        assert ((xi > TWO.low) & (xi < TWO.high)).all()
        assert np.isfinite(distribution.log_prob(xi)).all()


@pytest.mark.parametrize(("kind", "space"), CASES)
def test_saved_and_loaded_is_the_same_to_the_bit(tmp_path, kind, space):
    """Samples and densities do not change; saving again over it works; no file is left beside the two."""
    distribution = make(kind, space)
    make(kind, space).save(tmp_path / "run")
    distribution.save(tmp_path / "run")
    assert sorted(p.name for p in (tmp_path / "run").iterdir()) == ["distribution.json", "flow.safetensors"]
    back = ParameterDistribution.load(tmp_path / "run", space)
    assert back.space == space
    xi = distribution.sample(50, seed=2)
    np.testing.assert_array_equal(back.sample(50, seed=2), xi)
    np.testing.assert_array_equal(back.log_prob(xi), distribution.log_prob(xi))
    versions = json.loads((tmp_path / "run" / "distribution.json").read_text())["versions"]
    assert torch.__version__.startswith(versions["torch"])


def test_load_refuses_another_space(tmp_path):
    """The first difference is named, with both values."""
    make().save(tmp_path)
    other = ParameterSpace([Parameter("mass", low=2.0, high=7.0, unit="kg"), TWO[1]])
    with pytest.raises(SpaceMismatch, match=r"parameter 0 \(mass\): high is 7.0 here and 6.0 there"):
        ParameterDistribution.load(tmp_path, other)
    with pytest.raises(SpaceMismatch, match="1 parameters against 2"):
        ParameterDistribution.load(tmp_path, ONE)


def edit(folder, **entries):
    path = folder / "distribution.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **entries}))


def test_load_refuses_what_does_not_fit(tmp_path):
    """Missing files, other schemas, damage and tensors of another shape are named."""

    def refuses(text):
        with pytest.raises(BadInput, match=text):
            ParameterDistribution.load(tmp_path)

    refuses(r"distribution\.json cannot be read \(No such file")
    (tmp_path / "distribution.json").write_text("{")
    refuses(r"distribution\.json is not JSON")
    (tmp_path / "distribution.json").write_text("[]")
    refuses("schema_version is None, this version of nfpde reads 1")
    make().save(tmp_path)
    edit(tmp_path, schema_version=2)
    refuses("schema_version is 2, this version of nfpde reads 1")
    make().save(tmp_path)
    edit(tmp_path, density={"kind": "realnvp", "features": 3})
    refuses("a density of 3 features for 2 parameters")
    edit(tmp_path, density={"kind": "realnvp", "features": 2, "transforms": 3, "hidden_features": [8]})
    refuses(r"the tensor flow\.transform\.transforms\.0\.hyper\.\d\.\w+ is torch\.float64 .* needs torch\.float64")
    edit(tmp_path, density=None)
    refuses(r"distribution\.json: the entry 'density' must be an object with a kind and sizes, got None")
    edit(tmp_path, density={"kind": "glow"})
    refuses(r"distribution\.json: unknown density kind 'glow'")
    edit(tmp_path, space={})
    refuses(r"distribution\.json: .*expected an object with a list 'parameters'")
    make().save(tmp_path)
    path = tmp_path / "flow.safetensors"
    tensors = load_file(path)
    save_file({**tensors, "loc": torch.zeros(3, dtype=torch.float64)}, path)
    refuses(r"the tensor loc is torch.float64 \(3,\), but distribution.json needs torch.float64 \(2,\)")
    save_file({**tensors, "loc": torch.zeros(2)}, path)
    refuses("the tensor loc is torch.float32")
    save_file({**tensors, "loc": torch.full((2,), float("nan"), dtype=torch.float64)}, path)
    refuses("the tensor loc holds NaN")
    save_file({k: v for k, v in tensors.items() if k != "loc"}, path)
    refuses("the tensor loc is missing")
    save_file({**tensors, "loc": torch.zeros(2, dtype=torch.float64)}, path)
    refuses("their hashes differ")
    path.write_bytes(path.read_bytes()[:40])
    refuses("is damaged")
    path.unlink()
    refuses(r"flow\.safetensors cannot be read")


def test_arguments_that_do_not_fit_are_refused():
    """Wrong shapes and NaN are errors that say the rule."""
    with pytest.raises(BadInput, match="the density has 3 features and the space 2 parameters"):
        ParameterDistribution(TWO, build_flow(3))
    with pytest.raises(BadInput, match=r"must have shape \(n, 2\), got \(1, 3\)"):
        make().log_prob([1.0, 2.0, 3.0])
    with pytest.raises(BadInput, match="parameter vector 1 holds NaN"):
        make().log_prob([[3.0, 0.001], [np.nan, 0.001]])
    with pytest.raises(BadInput, match=r"nominal must have shape \(2,\)"):
        make().summary(nominal=[1.0])


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda d: d.sample(-1), "n is -1; it must be an integer of at least 0"),
        (lambda d: d.sample(2.5), "n is 2.5; it must be an integer"),
        (lambda d: d.sample(5, seed=2**64), "seed is 18446744073709551616; it must be an integer from -9223372036854"),
        (lambda d: d.sample(5, seed="a"), "seed is 'a'"),
        (lambda d: d.mean(0), "samples is 0; it must be an integer of at least 1"),
        (lambda d: d.std(0), "samples is 0"),
        (lambda d: d.summary(samples=0), "samples is 0"),
        (lambda d: d.summary(nominal=["a", "b"]), "nominal must be 2 numbers, one a parameter, got ['a', 'b']"),
        (lambda d: d.quantiles(0.5, samples=0), "samples is 0"),
        (lambda d: d.quantiles(1.5), "q is 1.5; it must be a number from 0 to 1, or a list of such"),
        (lambda d: d.quantiles([0.5, float("nan")]), "q is [0.5, nan]"),
        (lambda d: d.quantiles("half"), "q is 'half'"),
        (lambda d: d.log_prob("x"), "parameter vectors must be numbers in rows of one length, shape (n, 2), got 'x'"),
        (lambda d: d.log_prob([[1.0, 2.0], [1.0]]), "numbers in rows of one length"),
    ],
)
def test_nonsense_is_refused_by_name(call, text):
    """The message names the argument, the value and the rule; nothing of torch or numpy comes through."""
    with pytest.raises(BadInput) as caught:
        call(make())
    assert text in str(caught.value)


def test_arguments_at_their_limits():
    """No sample at all, one, both ends of the seeds and of the quantiles."""
    assert make().sample(0).shape == (0, 2)
    assert make("mixture").sample(0).shape == (0, 2)
    assert make().summary(samples=1).samples == 1
    for seed in (-(2**63), 2**64 - 1):
        assert make().sample(3, seed).shape == (3, 2)
    low, high = make().quantiles([0, 1])
    assert (low <= high).all()


def test_summary_says_what_the_samples_say():
    """Figures are those of the samples; a marginal on a bound is marked; the uniform one has a share of 0.9."""
    wide = torch.tensor([[0.0, 9.0]])  # the second one within e^-9 of its upper bound
    covariances = torch.diag(torch.tensor([1.8138**2, 0.01]))[None]
    distribution = ParameterDistribution(TWO, GaussianMixture(torch.ones(1), wide, covariances))
    summary = distribution.summary(nominal=[4.5, np.nan])
    mass, damping = summary.parameters
    xi = distribution.sample(summary.samples)
    assert mass.mean == pytest.approx(xi[:, 0].mean(), rel=1e-12)
    assert mass.q05 == pytest.approx(np.quantile(xi[:, 0], 0.05), rel=1e-12)
    assert mass.width_share == pytest.approx(0.9, abs=0.03)
    assert (mass.nominal, mass.unit, mass.low, mass.high, mass.leans_on) == (4.5, "kg", 2.0, 6.0, None)
    assert (damping.nominal, damping.leans_on) == (None, "high")
    assert damping.width_share < 0.001
    assert json.loads(json.dumps(summary.to_json(), allow_nan=False))["parameters"][1]["leans_on"] == "high"


def test_summary_prints_as_a_table():
    """Eighty columns hold names with units, nominal values and bounds; what leans on a bound is marked."""

    def show(distribution):
        out = io.StringIO()
        Console(file=out, width=80).print(distribution.summary(nominal=[4.5, np.nan]))
        return out.getvalue()

    text = show(make())
    for part in ("mass [kg]", "damping ", "nominal", " 4.5 ", "low", "0.01 ", "20000 samples"):
        assert part in text
    assert "leans on" not in text
    mixture = GaussianMixture(torch.ones(1), torch.tensor([[0.0, 9.0]]), 0.01 * torch.eye(2)[None])
    assert "leans on" in show(ParameterDistribution(TWO, mixture))
