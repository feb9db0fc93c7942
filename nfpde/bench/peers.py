"""Exact transport solvers that need an environment of their own (`lapjv`, `lapx`, `Wasserstein` want NumPy 1).

Run by path with the Python of that environment, which need not hold this package: it answers requests on its standard
input, one JSON line each, with JSON lines. `Peers` is the other end.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = {"lapjv": "uniform", "lapx": "uniform", "Wasserstein": "random"}
"""Names on the package index, and the weights that each is compared on: those it is for."""


class Peers:
    """The solvers of another Python environment.

    Args:
        python: Its interpreter.

    Raises:
        OSError: The interpreter cannot be started.
        BadInput: It is no Python with what the solvers need; its own message is on the standard error.
    """

    def __init__(self, python: Path) -> None:
        self._python = python
        self._process = subprocess.Popen(
            [str(python), str(Path(__file__).resolve())], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.versions: dict[str, str] = self._ask({"do": "versions"})

    def load(self, points: Path) -> None:
        """Gives it the points and weights of a case, an npz file with x, y, a and b."""
        self._ask({"do": "load", "path": str(points)})

    def solve(self, package: str) -> tuple[float, float]:
        """CPU seconds and cost of one solver, the distance matrix included."""
        seconds, cost = self._ask({"do": "solve", "package": package})
        return seconds, cost

    def close(self) -> None:
        """Ends the other process."""
        self._process.communicate()

    def _ask(self, request: dict[str, str]) -> Any:
        if self._process.stdin is None or self._process.stdout is None:
            raise RuntimeError("the peers' process has no pipes")
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            answer = json.loads(self._process.stdout.readline())["answer"]
        except (BrokenPipeError, ValueError, TypeError, KeyError):
            from nfpde.errors import BadInput  # not at the top: the other end may lack this package

            self._process.kill()
            self._process.wait()
            raise BadInput(
                f"{self._python} gave no answer to {json.dumps(request)}; give the Python of an environment with "
                f"NumPy, SciPy and any of {', '.join(PACKAGES)}"
            ) from None
        return answer


def _solver(package: str) -> Callable[..., float]:
    """From a cost matrix and weights to the cost, with the package imported."""
    import numpy as np

    if package == "Wasserstein":
        from wasserstein import EMD  # pyright: ignore[reportMissingImports]

        solver = EMD(n_iter_max=10**9)
        return lambda cost, a, b: float(solver(a, b, cost))
    if package == "lapjv":
        from lapjv import lapjv  # pyright: ignore[reportMissingImports]

        return lambda cost, a, b: float(cost[np.arange(len(cost)), lapjv(cost)[0]].mean())
    from lap import lapjvr  # pyright: ignore[reportMissingImports]

    return lambda cost, a, b: float(lapjvr(cost)[0]) / len(cost)


def _answer(request: dict[str, str], data: dict[str, Any]) -> Any:
    import numpy as np
    from scipy.spatial.distance import cdist

    if request["do"] == "versions":
        found = {}
        for package in PACKAGES:
            try:
                found[package] = version(package)
            except PackageNotFoundError:
                continue
        return found
    if request["do"] == "load":
        with np.load(request["path"]) as case:
            data.update({name: case[name] for name in ("x", "y", "a", "b")})
        return None
    solve = _solver(request["package"])
    started = time.process_time()
    cost = solve(cdist(data["x"], data["y"]), data["a"], data["b"])
    return time.process_time() - started, cost


def main() -> None:
    """Answers requests until the input ends."""
    data: dict[str, Any] = {}
    for line in sys.stdin:
        print(json.dumps({"answer": _answer(json.loads(line), data)}), flush=True)


if __name__ == "__main__":
    main()
