"""What MODEL, DATA and --params on a command line stand for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nfpde.benchmarks import BENCHMARKS
from nfpde.dataset import Dataset, load_dataset
from nfpde.errors import BadInput
from nfpde.parameters import ParameterSpace
from nfpde.sim import Device, MujocoSimulator
from nfpde.sim import make_simulator as on_device

if TYPE_CHECKING:
    from nfpde.sim.warp import WarpSimulator

DEVICE_HELP = "cpu, cuda (MuJoCo Warp), warp-cpu (its kernels without a GPU, for tests), or auto: cuda if there is one"
MODEL_HELP = f"MJCF or URDF file, or a benchmark robot: {', '.join(BENCHMARKS)}"


def make_simulator(model: str, params: Path | None, device: Device = "auto") -> MujocoSimulator | WarpSimulator:
    """The simulator of a model file or benchmark robot, with the parameters of a TOML file.

    Raises:
        BadInput: neither a file nor a benchmark robot, or a model file without parameters to estimate.
        NfpdeError: whatever is wrong with the model or the parameters.
    """
    known = BENCHMARKS.get(model)
    path = model_file(model)
    if params is None and known is None:
        raise BadInput(
            f"say with --params which parameters of {model} are unknown: a TOML file of [[parameter]] tables with "
            "field, target, low and high"
        )
    space = known.space if known is not None and params is None else ParameterSpace.from_toml(params or "")
    return on_device(path, space, device=device)


def model_file(model: str) -> Path:
    """The file of a model: a path, or a benchmark robot's name.

    Raises:
        BadInput: neither.
    """
    known = BENCHMARKS.get(model)
    if known is None and not Path(model).is_file():
        raise BadInput(f"{model!r} is neither a file nor a benchmark robot ({', '.join(BENCHMARKS)})")
    return Path(model) if known is None else known.path


def read_dataset(path: Path, resample: float | None) -> Dataset:
    """Load recordings; a folder made by `nfpde collect` stands for its data file, the only one in it."""
    found = [f for f in path.iterdir() if f.suffix.lower() in (".npz", ".csv", ".parquet")] if path.is_dir() else []
    made_here = [f.name for f in found] == ["data.npz"]
    return load_dataset(found[0] if made_here else path, resample=resample)
