"""The hand-written types of the Rust module are those of the built module."""

import subprocess
import sys

import pytest


@pytest.mark.slow
def test_stub_matches_the_built_module():
    """Mypy's stubtest finds no difference."""
    command = [sys.executable, "-m", "mypy.stubtest", "nfpde._rust_ot"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
