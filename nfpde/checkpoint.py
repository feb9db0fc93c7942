"""Save a long job so that it can go on after a kill at any moment, exactly where it stood.

A folder holds two files. `state.safetensors` is the whole state: tensors, and everything else as JSON in its
header; it is replaced by one atomic rename, so either the old or the new state is there, never a mixture.
`state.json` is a copy of that JSON for people to read; nothing reads it back.

Optimizers, schedulers, modules and random generators give nested states; `flatten_state` turns one into
tensors and JSON, `restore_state` turns them back:

    tensors, layout = flatten_state("optimizer", optimizer.state_dict())
    save_state(folder, tensors, {"run": run, "step": 7, "optimizer": layout})

    tensors, info = load_state(folder, run)
    optimizer.load_state_dict(restore_state(info["optimizer"], tensors))

For generators the states are `torch.Generator.get_state()` (a tensor as it is) and
`numpy.random.Generator.bit_generator.state` (nested).
"""

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from nfpde.errors import BadInput, CheckpointMismatch
from nfpde.storage import write_whole

STATE_FILE = "state.safetensors"
COPY_FILE = "state.json"
MOST_LINES = 20
"""Entries that the message of another run names."""

_MISSING = object()


def save_state(folder: Path | str, tensors: Mapping[str, Tensor], info: Mapping[str, Any]) -> None:
    """Replace the state in `folder` by a new one, atomically; makes the folder where it is missing.

    One process may write to a folder at a time.

    Args:
        folder: The run's folder.
        tensors: Tensors by name, any shape, dtype and device; saved bit for bit.
        info: Anything JSON can hold without NaN or infinity. `info["run"]` identifies the run, see `load_state`.

    Raises:
        BadInput: `info` is not JSON.
    """
    text = _to_json(info)
    data = save({k: t.detach().cpu().clone().contiguous() for k, t in tensors.items()}, {"info": text})
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / STATE_FILE, data)
    write_whole(folder / COPY_FILE, text)
    for leftover in folder.glob("state.*.tmp"):  # of a process that was killed while it wrote
        leftover.unlink(missing_ok=True)


def load_state(
    folder: Path | str, run: Mapping[str, Any] | None = None
) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """Read the last whole state of `folder`, or None where nothing was saved yet.

    Args:
        folder: The run's folder.
        run: What must be the same for the run to go on (settings, data hash ...), JSON; compared with the saved
            `info["run"]`. None compares nothing.

    Returns:
        Tensors by name (on the CPU) and `info`.

    Raises:
        BadInput: The file is damaged.
        CheckpointMismatch: The state was saved by another run; names the entries that differ.
    """
    path = Path(folder) / STATE_FILE
    if not path.exists():
        return None
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
            info = json.loads((file.metadata() or {})["info"])
    except (SafetensorError, KeyError, json.JSONDecodeError) as error:
        raise BadInput(
            f"{path} is not a saved state or is damaged ({error}). Delete it to start the run afresh."
        ) from error
    if run is not None:
        _check_run(path, info.get("run"), json.loads(_to_json(run)))
    return tensors, info


def flatten_state(name: str, state: Any) -> tuple[dict[str, Tensor], Any]:
    """Split a nested state (dicts, lists, tuples) into tensors and a JSON layout of all the rest.

    Args:
        name: Start of the tensors' names; different for every state that is saved together.
        state: For example `optimizer.state_dict()`. Leaves: tensors, NumPy arrays, None, bool, int, float, str.

    Returns:
        Tensors, named `name.0`, `name.1` ..., and the layout that `restore_state` needs.

    Raises:
        BadInput: A leaf of another type.
    """
    tensors: dict[str, Tensor] = {}

    def flatten(node: Any) -> Any:
        if isinstance(node, Tensor | np.ndarray):
            key = f"{name}.{len(tensors)}"
            array = isinstance(node, np.ndarray)
            tensors[key] = torch.from_numpy(node.copy()) if array else node.detach().clone()
            return {"array" if array else "tensor": key}
        if isinstance(node, Mapping):
            return {"dict": [[flatten(k), flatten(v)] for k, v in node.items()]}
        if isinstance(node, list | tuple):
            return {"list" if isinstance(node, list) else "tuple": [flatten(v) for v in node]}
        if isinstance(node, np.generic):
            node = node.item()
        if isinstance(node, float) and not math.isfinite(node):
            return {"float": repr(node)}
        if node is None or isinstance(node, bool | int | float | str):
            return node
        raise BadInput(f"state {name!r} holds a {type(node).__name__}, which cannot be saved: {node!r:.80}")

    layout = flatten(state)
    return tensors, layout


def restore_state(layout: Any, tensors: Mapping[str, Tensor]) -> Any:
    """Put together again what `flatten_state` split: equal values, equal types (NumPy scalars become Python's).

    Args:
        layout: The layout, as it was or after a trip through JSON.
        tensors: Tensors by name; may hold others too.
    """
    if not isinstance(layout, dict):
        return layout
    ((kind, value),) = layout.items()
    if kind == "tensor":
        return tensors[value].clone()
    if kind == "array":
        return tensors[value].cpu().numpy().copy()
    if kind == "dict":
        return {restore_state(k, tensors): restore_state(v, tensors) for k, v in value}
    if kind == "float":
        return float(value)
    items = [restore_state(v, tensors) for v in value]
    return tuple(items) if kind == "tuple" else items


def _to_json(info: Mapping[str, Any]) -> str:
    try:
        return json.dumps(info, allow_nan=False, indent=1)
    except (TypeError, ValueError) as error:
        raise BadInput(
            f"what is saved with a run must be JSON (no NaN, no infinity): {error}. flatten_state takes the rest."
        ) from error


def _entries(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from _entries(inner, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list) and value:
        for i, inner in enumerate(value):
            yield from _entries(inner, f"{name}[{i}]")
    else:
        yield name, value


def _check_run(path: Path, saved: Any, wanted: Any) -> None:
    if saved == wanted:
        return
    old, new = dict(_entries(saved or {})), dict(_entries(wanted))
    lines = []
    for key in sorted(old.keys() | new.keys()):
        before, now = old.get(key, _MISSING), new.get(key, _MISSING)
        if before != now:
            texts = ["nothing" if v is _MISSING else f"{json.dumps(v):.100}" for v in (before, now)]
            lines.append(f"  {key or 'run'}: saved {texts[0]}, now {texts[1]}")
    if len(lines) > MOST_LINES:
        lines[MOST_LINES:] = [f"  and {len(lines) - MOST_LINES} entries more"]
    raise CheckpointMismatch(
        f"{path} was saved by another run:\n" + "\n".join(lines) + "\n"
        "Use the same settings and data to go on, or another folder to start afresh."
    )
