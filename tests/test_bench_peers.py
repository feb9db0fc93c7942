"""Transport solvers of another Python: what cannot be one is refused in a line."""

import sys
from pathlib import Path

import numpy as np
import pytest

from nfpde.bench.peers import Peers
from nfpde.errors import BadInput
from tests.command_line import run


@pytest.mark.parametrize("python", ["false", "true", "cat"])
def test_what_is_no_python_is_refused(python, tmp_path):
    """Whether it ends at once, in peace or not, or answers with something else; nothing is written."""
    path = next(p for p in (Path("/bin") / python, Path("/usr/bin") / python) if p.exists())
    status, out, err = run("bench", "ot", "--quick", "--out", tmp_path / "out", "--peers-python", path)
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert err.startswith(f'nfpde: {path} gave no answer to {{"do": "versions"}}; give the Python of an environment')
    assert not (tmp_path / "out").exists()


def test_a_python_without_the_solvers_answers(tmp_path):
    """It says which it has, takes points, and is refused with what it was asked where a solver is missing."""
    peers = Peers(Path(sys.executable))
    assert peers.versions == {}
    np.savez(tmp_path / "case.npz", x=np.zeros((2, 1)), y=np.ones((2, 1)), a=np.ones(2) / 2, b=np.ones(2) / 2)
    peers.load(tmp_path / "case.npz")
    with pytest.raises(BadInput, match=r'gave no answer to \{"do": "solve", "package": "lapjv"\}'):
        peers.solve("lapjv")
