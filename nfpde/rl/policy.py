"""A trained policy without its training: a small network in NumPy, saved as safetensors and JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from nfpde.errors import BadInput
from nfpde.rl.actor import check_finite
from nfpde.rl.numbers import whole_number
from nfpde.storage import write_whole

Float32 = NDArray[np.float32]

SCHEMA_VERSION = 1
WEIGHTS_FILE = "policy.safetensors"
CONFIG_FILE = "policy.json"

_LOG_STD = (-20.0, 2.0)


@dataclass(frozen=True, eq=False)
class Policy:
    """The actor of SAC: action = low + (high - low) (tanh(mean(h)) + 1) / 2 with h a ReLU network of the observation.

    Args:
        weights: float32 arrays: `hidden.<i>.weight` (out, in), `hidden.<i>.bias` (out,), the same for `mean` and
            `log_std`.
        low: smallest action, (nu,).
        high: largest action, (nu,).
        environment: what it was trained in, a Gymnasium id or a label.
        past_commands: how many of its own last actions end the observation, oldest first (see `PastCommands`);
            `Controller` keeps them.

    Raises:
        BadInput: weights that are missing or do not fit together, or are not finite.
    """

    weights: Mapping[str, Float32]
    low: Float32
    high: Float32
    environment: str = ""
    past_commands: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "past_commands", whole_number("past_commands", self.past_commands, 0))
        for name in ("low", "high"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float32))
        if self.low.ndim != 1 or self.low.shape != self.high.shape or not (self.low < self.high).all():
            raise BadInput(f"a policy needs action bounds low < high of one shape (nu,), got {self.low}, {self.high}")
        weights = {k: np.ascontiguousarray(v, dtype=np.float32) for k, v in self.weights.items()}
        object.__setattr__(self, "weights", weights)
        layers = [*(f"hidden.{i}" for i in range(self.nhidden)), "mean", "log_std"]
        expected = {f"{layer}.{part}" for layer in layers for part in ("weight", "bias")}
        if set(weights) != expected:
            raise BadInput(f"the policy's weights must be {sorted(expected)}, got {sorted(weights)}")
        width = self.nobservation
        for layer in layers:
            weight, bias = weights[f"{layer}.weight"], weights[f"{layer}.bias"]
            outputs = len(self.low) if layer in ("mean", "log_std") else len(bias)
            if weight.shape != (outputs, width) or bias.shape != (outputs,):
                raise BadInput(
                    f"the policy's {layer} has weight {weight.shape} and bias {bias.shape}, expected "
                    f"{(outputs, width)} and {(outputs,)}"
                )
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise BadInput(f"the policy's {layer} holds a number that is not finite")
            width = outputs if layer.startswith("hidden") else width

        if self.past_commands * len(self.low) > self.nobservation:
            raise BadInput(
                f"the policy sees {self.nobservation} numbers, which cannot end with {self.past_commands} past "
                f"commands of {len(self.low)} numbers each"
            )

    @property
    def nhidden(self) -> int:
        """Number of hidden layers."""
        return sum(k.startswith("hidden.") and k.endswith(".weight") for k in self.weights)

    @property
    def nobservation(self) -> int:
        """Numbers in an observation."""
        first = self.weights.get("hidden.0.weight", self.weights.get("mean.weight"))
        return first.shape[1] if first is not None and first.ndim == 2 else 0

    def predict(self, observation: ArrayLike, rng: np.random.Generator | None = None) -> Float32:
        """Action for an observation, (n,) to (nu,), or for many, (B, n) to (B, nu).

        Args:
            observation: what the environment returned.
            rng: draws from the policy's own distribution, as in training; None gives its mode.

        Raises:
            BadInput: an observation of another size, or one that is not finite; or weights so large that the action
                is not.
        """
        x = np.asarray(observation, dtype=np.float32)
        if x.ndim not in (1, 2) or x.shape[-1] != self.nobservation:
            last = f", the last of them its own last {self.past_commands} commands (see nfpde.rl.Controller)"
            raise BadInput(
                f"this policy takes observations of {self.nobservation} numbers{last if self.past_commands else ''}, "
                f"got an array of shape {x.shape}"
            )
        if not np.isfinite(x).all():
            raise BadInput(f"the observation holds a number that is not finite: {x}")
        with np.errstate(over="ignore", invalid="ignore"):  # what comes of it is checked
            for i in range(self.nhidden):
                x = np.maximum(self._layer(f"hidden.{i}", x), 0.0)
            raw = self._layer("mean", x)
            if rng is not None:
                std = np.exp(np.clip(self._layer("log_std", x), *_LOG_STD))
                raw = raw + std * rng.standard_normal(raw.shape, dtype=np.float32)
            share = np.float32(0.5) * (np.tanh(raw) + np.float32(1.0))
        action = (self.low + share * (self.high - self.low)).astype(np.float32)
        check_finite(action)
        return action

    def save(self, folder: Path | str) -> None:
        """Write `policy.safetensors` and `policy.json` into a folder, made where it is missing."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        config: dict[str, Any] = {
            "schema_version": SCHEMA_VERSION,
            "kind": "squashed_gaussian",
            "activation": "relu",
            "environment": self.environment,
            "observation": self.nobservation,
            "past_commands": self.past_commands,
            "hidden": [len(self.weights[f"hidden.{i}.bias"]) for i in range(self.nhidden)],
            "action_low": self.low.tolist(),
            "action_high": self.high.tolist(),
        }
        write_whole(folder / CONFIG_FILE, json.dumps(config, indent=1))
        write_whole(folder / WEIGHTS_FILE, save(dict(self.weights)))

    def _layer(self, name: str, x: Float32) -> Float32:
        return x @ self.weights[f"{name}.weight"].T + self.weights[f"{name}.bias"]


def load_policy(folder: Path | str) -> Policy:
    """Read what `Policy.save` wrote, or what `train_sac` left in its output folder.

    Raises:
        BadInput: a file is missing, damaged or of another schema, or the two files do not belong together.
    """
    config_path, weights_path = Path(folder) / CONFIG_FILE, Path(folder) / WEIGHTS_FILE
    try:
        config = json.loads(config_path.read_text(encoding="utf-8"))
        weights = load_file(weights_path)
    except OSError as error:
        raise BadInput(f"{folder} holds no policy ({error}); give the output folder of a training") from None
    except (ValueError, SafetensorError) as error:
        raise BadInput(f"{folder}: the saved policy is damaged: {error}") from None
    version = config.get("schema_version") if isinstance(config, dict) else None
    if version != SCHEMA_VERSION or (config.get("kind"), config.get("activation")) != ("squashed_gaussian", "relu"):
        raise BadInput(
            f"{config_path}: not a policy that this version of nfpde reads (schema_version {version!r}, wanted "
            f"{SCHEMA_VERSION}, kind squashed_gaussian, activation relu)"
        )
    try:
        past = config.get("past_commands", 0)  # which policies of earlier versions do not know
        policy = Policy(weights, config["action_low"], config["action_high"], config["environment"], past)
        sizes = [len(policy.weights[f"hidden.{i}.bias"]) for i in range(policy.nhidden)]
        same = (config["observation"], config["hidden"]) == (policy.nobservation, sizes)
    except KeyError as error:
        raise BadInput(f"{config_path}: the entry {error} is missing") from None
    except (TypeError, ValueError, BadInput) as error:
        raise BadInput(f"{folder}: {error}") from None
    if not same:
        raise BadInput(f"{folder}: {CONFIG_FILE} and {WEIGHTS_FILE} do not belong together (layer sizes differ)")
    return policy
