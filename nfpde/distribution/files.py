"""A distribution on the disk: `distribution.json` (what it is) and `flow.safetensors` (its numbers)."""

import hashlib
import json
from importlib import metadata
from pathlib import Path

from safetensors import SafetensorError
from safetensors import torch as safetensors
from torch import Tensor

from nfpde.errors import BadInput, NfpdeError, SpaceMismatch
from nfpde.flow import Density, make_density
from nfpde.parameters import ParameterSpace
from nfpde.storage import read_json, write_whole

SCHEMA_VERSION = 1
JSON_FILE = "distribution.json"
TENSOR_FILE = "flow.safetensors"


def save(folder: Path | str, space: ParameterSpace, density: Density) -> None:
    """Write both files; the JSON comes last and holds the hash of the tensors, so a pair always fits."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {k: t.detach().cpu().clone().contiguous() for k, t in density.state_dict().items()}
    data = safetensors.save(tensors)
    content = {
        "schema_version": SCHEMA_VERSION,
        "space": space.to_json(),
        "density": density.config(),
        "sha256": hashlib.sha256(data).hexdigest(),
        "versions": _versions(),
    }
    write_whole(folder / TENSOR_FILE, data)
    write_whole(folder / JSON_FILE, json.dumps(content, indent=1, ensure_ascii=False))


def remove(folder: Path | str) -> None:
    """Take away what `save` wrote, where there is any: the JSON first, without which nothing is there."""
    folder = Path(folder)
    for name in (JSON_FILE, TENSOR_FILE):
        (folder / name).unlink(missing_ok=True)
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def load(folder: Path | str, space: ParameterSpace | None = None) -> tuple[ParameterSpace, Density]:
    """Read both files; see `ParameterDistribution.load`."""
    path = Path(folder) / JSON_FILE
    content = read_json(
        path,
        SCHEMA_VERSION,
        missing="; is this the folder of a distribution?",
        outdated="; save the distribution again with this version",
    )
    try:
        saved = ParameterSpace.from_json(content["space"], source=str(path))
        config = content["density"]
        if not isinstance(config, dict):
            raise BadInput(f"the entry 'density' must be an object with a kind and sizes, got {config!r}")
        density = make_density(config)
    except KeyError as error:
        raise BadInput(f"{path}: the entry {error} is missing") from None
    except NfpdeError as error:
        raise BadInput(f"{path}: {error}") from None
    if space is not None:
        try:
            space.check_same(saved)
        except SpaceMismatch as error:
            raise SpaceMismatch(f"{path} (there) is for another space than the one asked for (here): {error}") from None
    if density.features != len(saved):
        raise BadInput(f"{path}: a density of {density.features} features for {len(saved)} parameters")
    _load_tensors(path.with_name(TENSOR_FILE), density, content.get("sha256"))
    return saved, density


def _load_tensors(path: Path, density: Density, sha256: object) -> None:
    try:
        data = path.read_bytes()
        tensors = safetensors.load(data)
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}); it belongs to {JSON_FILE} beside it") from None
    except SafetensorError as error:
        raise BadInput(f"{path} is damaged: {error}") from None
    expected: dict[str, Tensor] = dict(density.state_dict())
    for name in sorted(expected.keys() | tensors.keys()):
        if name not in tensors or name not in expected:
            state = "missing" if name not in tensors else "not part of this density"
            raise BadInput(f"{path}: the tensor {name} is {state}; {JSON_FILE} says {density.config()}")
        got, want = tensors[name], expected[name]
        if got.shape != want.shape or got.dtype != want.dtype:
            raise BadInput(
                f"{path}: the tensor {name} is {got.dtype} {tuple(got.shape)}, but {JSON_FILE} needs {want.dtype} "
                f"{tuple(want.shape)}"
            )
        if bool(got.isnan().any()):
            raise BadInput(f"{path}: the tensor {name} holds NaN")
    if hashlib.sha256(data).hexdigest() != sha256:
        raise BadInput(f"{path} is not the file that {JSON_FILE} was written for: their hashes differ; save both again")
    density.load_state_dict(tensors)


def _versions() -> dict[str, str]:
    """Versions of the packages the numbers depend on, for whoever reads the file later."""
    versions = {}
    for name in ("nfpde", "numpy", "torch", "zuko"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:  # used from a source tree
            versions[name] = "not installed"
    return versions
