"""What stands for a model with effects by its content, in another process, too."""

from __future__ import annotations

import inspect
import os
from collections.abc import Sequence
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from nfpde.effects import Effect
from nfpde.effects.effect import Quantity
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.sim.model import model_hash

_PLAIN = (str, bytes, bool, int, float, type(None), Parameter, Quantity)
"""What says all of itself when it is written down."""


def identity_of(model: mujoco.MjModel, space: ParameterSpace | None, effects: Sequence[Effect], device: str) -> bytes:
    """32 bytes that are the same where predictions are, and are others where anything differs.

    Args:
        model: The nominal model.
        space: Its free parameters.
        effects: What acts beside them. One that holds what cannot be compared is like no other.
        device: Where it is simulated.
    """
    digest = blake2b(digest_size=32)
    for part in (model_hash(model), None if space is None else space.parameters, *map(_content, effects), device):
        digest.update(_written(part))
    return digest.digest()


def _content(effect: Effect) -> tuple[Any, ...]:
    """All that an effect does hangs on: the text of its classes and what it holds."""
    kinds = tuple((c.__module__, c.__qualname__, _text(c)) for c in type(effect).__mro__ if c is not object)
    return kinds, tuple(sorted(vars(effect).items()))


@cache
def _text(kind: type) -> bytes:
    """The file that a class is written in; where there is none, what no other has."""
    try:
        path = inspect.getsourcefile(kind)
        return os.urandom(16) if path is None else blake2b(Path(path).read_bytes(), digest_size=16).digest()
    except (OSError, TypeError):
        return os.urandom(16)


def _written(value: Any) -> bytes:
    """A value written down so that unlike ones are unlike."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray) and value.dtype != object:
        inner = [f"{value.dtype}{value.shape}".encode(), value.tobytes()]
    elif isinstance(value, tuple | list):
        inner = [_written(v) for v in value]
    elif isinstance(value, dict):
        inner = [_written(item) for item in value.items()]
    elif isinstance(value, _PLAIN):
        inner = [repr(value).encode()]
    else:
        inner = [os.urandom(16)]
    text = b"".join(len(i).to_bytes(8, "little") + i for i in inner)
    return f"{type(value).__name__}:".encode() + text
