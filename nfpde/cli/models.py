"""What MODEL, DATA and --params on a command line stand for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mujoco import MjModel

from nfpde.benchmarks import BENCHMARKS
from nfpde.dataset import Dataset, expand_names, load_dataset
from nfpde.dataset.files import read_column_names
from nfpde.elements import QPOS_WIDTHS, element_names
from nfpde.errors import BadDataset, BadInput
from nfpde.parameters import ParameterSpace
from nfpde.sim import Device, MujocoSimulator, StateSpace, load_model
from nfpde.sim import make_simulator as on_device

if TYPE_CHECKING:
    from nfpde.sim.warp import WarpSimulator

DEVICE_HELP = "cpu, cuda (MuJoCo Warp), warp-cpu (its kernels without a GPU, for tests), or auto: cuda if there is one"
DIFFERENTIATE_HELP = "take the velocities from the positions, for recordings that have none"
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


def read_dataset(path: Path, resample: float | None, differentiate: bool, model: str) -> Dataset:
    """Load recordings; a folder made by `nfpde collect` stands for its data file, the only one in it.

    Which columns are unit quaternions, to be resampled and differentiated as such, is for the model to say.
    """
    found = [f for f in path.iterdir() if f.suffix.lower() in (".npz", ".csv", ".parquet")] if path.is_dir() else []
    made_here = [f.name for f in found] == ["data.npz"]
    source = found[0] if made_here else path
    if resample is None and not differentiate:
        return load_dataset(source)
    quaternions = _quaternions(source, load_model(model_file(model)), velocities=not differentiate)
    return load_dataset(source, resample=resample, quaternions=quaternions, differentiate=differentiate)


def _quaternions(source: Path, model: MjModel, *, velocities: bool) -> list[int]:
    """First qpos column of each unit quaternion of a model, where recordings have it: by name, or in the model's order.

    Raises:
        BadDataset: the columns have other names, or stand in an order in which no quaternion does.
    """
    ours = [q for q, _ in StateSpace.of_model(model).quaternions]
    theirs = read_column_names(source, velocities=velocities).qpos if ours else None
    if theirs is None:
        return ours
    widths = [QPOS_WIDTHS[int(k)] for k in model.jnt_type]
    names = tuple(expand_names(element_names(model, "joint"), widths))
    found = []
    for wanted in (names[q : q + 4] for q in ours):
        first = theirs.index(wanted[0]) if wanted[0] in theirs else 0
        if theirs[first : first + 4] != wanted:
            raise BadDataset(
                f"{source}: to be resampled or differentiated, the qpos columns {', '.join(wanted)} of the model must "
                "stand side by side in this order, as they are a quaternion (w, x, y, z); the data has "
                f"{', '.join(theirs)}. Rename or reorder them, or number all as qpos_0, qpos_1, ... in the "
                "model's order."
            )
        found.append(first)
    return found
