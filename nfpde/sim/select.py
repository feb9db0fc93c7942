"""Which simulator runs a model: the GPU's where there is one, plain MuJoCo elsewhere."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, get_args

import mujoco

from nfpde.effects import Effect
from nfpde.errors import BadInput
from nfpde.parameters import ParameterSpace
from nfpde.sim.alike import ModelSource
from nfpde.sim.cpu import MujocoSimulator

if TYPE_CHECKING:
    from nfpde.sim.warp import WarpSimulator

Device = Literal["auto", "cpu", "cuda", "warp-cpu"]
"""`cpu`: MuJoCo in double precision; `cuda`: MuJoCo Warp; `warp-cpu`: its kernels without a GPU, for tests."""


def make_simulator(
    model: ModelSource | Sequence[ModelSource],
    space: ParameterSpace | None = None,
    effects: Sequence[Effect] = (),
    *,
    device: Device = "auto",
    nworld: int = 0,
    check_influence: bool = True,
) -> MujocoSimulator | WarpSimulator:
    """The simulator of a model on a device.

    Args:
        model: see `MujocoSimulator`; several in a list run in one batch on every device.
        space: see `MujocoSimulator`.
        effects: see `MujocoSimulator`.
        device: `auto` is `cuda` if Warp finds a CUDA device, else `cpu`. What a device cannot run is an error, never
            run on another one.
        nworld: simulations at once on a GPU, at most; 0 takes as many as fit into its free memory.
        check_influence: see `MujocoSimulator`.

    Raises:
        BadInput: no such device, or no CUDA device.
        BadModel, BadEffect: what MuJoCo Warp does not support; the text says what to change.
        BadParameter: see `MujocoSimulator`.

    Example:
        Two builds of an arm, and recordings that do not say which of them made them:
        `make_simulator(["arm_a.xml", "arm_b.xml"], ParameterSpace([Parameter("model", low=0, high=2), ...]))`
    """
    device = found_device(device)
    if device == "cpu" or device == "auto":
        return MujocoSimulator(model, space, effects, check_influence=check_influence)
    from nfpde.sim.warp import WarpSimulator  # a second of imports, where it is used

    return WarpSimulator(model, space, effects, device=device, nworld=nworld, check_influence=check_influence)


def found_device(device: Device) -> Device:
    """The device that a name stands for: `auto` is `cuda` if Warp finds a CUDA device, else `cpu`.

    Raises:
        BadInput: no such device.
    """
    if device not in get_args(Device):
        raise BadInput(f"no device is called {device!r}; there are: {', '.join(get_args(Device))}")
    if device != "auto":
        return device
    return "cuda" if _finds_cuda() else "cpu"


def runs_on(simulator: MujocoSimulator | WarpSimulator) -> str:
    """The device a simulator runs on, for people: its name and what it is."""
    if isinstance(simulator, MujocoSimulator):
        return f"cpu: MuJoCo {mujoco.__version__}, double precision, {simulator.nthread} thread(s)"
    kind = "cuda" if simulator.device.is_cuda else "warp-cpu"
    return f"{kind}: MuJoCo Warp, single precision, {simulator.device.name or 'CPU'}"


def _finds_cuda() -> bool:
    """Whether Warp finds a CUDA device; Warp is not even loaded where there is no driver."""
    try:
        ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return False
    from nfpde.sim.warp_device import has_cuda

    return has_cuda()
