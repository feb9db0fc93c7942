import numpy as np
from numpy.typing import NDArray

__all__ = ["solve_matrix", "solve_numbers", "solve_points"]

_Floats = NDArray[np.float64]
_Answer = tuple[float, NDArray[np.int64], NDArray[np.int64], _Floats, _Floats, _Floats, float]

def solve_points(
    x: _Floats, y: _Floats, a: _Floats | None, b: _Floats | None, metric: str, threads: int
) -> _Answer: ...
def solve_numbers(x: _Floats, y: _Floats, a: _Floats | None, b: _Floats | None, order: float) -> _Answer: ...
def solve_matrix(cost: _Floats, a: _Floats | None, b: _Floats | None, threads: int) -> _Answer: ...
