"""Disks and folders in the way of a training: a full disk is named and gone on after, a folder in use is refused."""

import numpy as np
import pytest

from nfpde.distribution import ParameterDistribution
from nfpde.flow import build_flow
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import load_policy
from nfpde.storage import alone_in
from tests.command_line import run
from tests.full_disk import files_of_at_most

SPACE = ParameterSpace([Parameter("body_mass", "pendulum", low=0.8, high=1.2)])


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


def test_a_folder_in_which_another_process_trains_is_refused(tmp_path):
    """One line with the folder, nothing written; as soon as the other has ended the command trains."""
    home, out = tmp_path / "distribution", tmp_path / "policy"
    ParameterDistribution(SPACE, build_flow(1, hidden_features=(8,))).save(home)
    command = ("train", "pendulum", "--distribution", home, "--out", out, "--steps", 150, "--evaluation-every", 150,
               "--evaluation-episodes", 2, "--device", "cpu", "--quiet")  # fmt: skip
    with alone_in(out, "training"):
        status, said, err = run(*command)
        assert (status, said) == (1, "")
        assert err == (
            f"nfpde: training in {out}: another process is at work there; wait for its end, or give another folder\n"
        )
        assert [p.name for p in out.iterdir()] == [".lock"]
    assert run(*command)[::2] == (0, "")
    assert not (out / ".lock").exists()
