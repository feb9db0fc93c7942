"""A disk that is full while a training writes: the file is named, nothing half is left, and the training goes on."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from nfpde.distribution import ParameterDistribution
from nfpde.flow import build_flow
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import load_policy
from tests.command_line import run

SPACE = ParameterSpace([Parameter("body_mass", "pendulum", low=0.8, high=1.2)])


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """The system refuses to let a file grow larger, as a full disk would."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    ("size", "file"), [(2_000, "replay/000000000000-000000000150.npz"), (30_000, "state.safetensors")]
)
def test_a_full_disk_is_one_line_with_the_files_name(tmp_path, size, file):
    """What the system says, of which file; then, with room again, the same command trains to its end."""
    home, out = tmp_path / "distribution", tmp_path / "policy"
    ParameterDistribution(SPACE, build_flow(1, hidden_features=(8,))).save(home)
    command = ("train", "pendulum", "--distribution", home, "--out", out, "--steps", 150, "--evaluation-every", 150,
               "--evaluation-episodes", 2, "--device", "cpu", "--quiet")  # fmt: skip
    with files_of_at_most(size):
        status, _, err = run(*command)
    assert (status, err) == (1, f"nfpde: {out / file}: File too large\n")
    assert not [p for p in out.rglob("*") if p.suffix == ".tmp" or p.name == "state.safetensors"]
    assert run(*command)[::2] == (0, "")
    assert np.isfinite(load_policy(out).predict(np.zeros(3))).all()
