"""Settings of the estimators; the command line is made from them."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from nfpde.errors import BadInput


def setting(default: Any, text: str, least: float | None = None) -> Any:
    """A dataclass field with its help text and smallest allowed value."""
    return field(default=default, metadata={"help": text, "least": least})


@dataclass(frozen=True)
class NfpdeConfig:
    """Settings of NFPDE (Takano et al., IROS 2024, Algorithm 1).

    Raises:
        BadInput: a value below its least, no such choice, or values that exclude each other.
    """

    iterations: int = setting(60, "times that samples are drawn, simulated and learned from", 1)
    samples: int = setting(1000, "parameter vectors drawn in an iteration (the paper's M)", 2)
    transitions: int = setting(32, "transitions compared in an iteration (a minibatch of the paper's N)", 1)
    horizon: int = setting(1, "control steps predicted open loop before comparing", 1)
    beta: float | None = setting(None, "temperature of the softmax candidate; by default found from the data", 1e-300)
    least_effective: float = setting(5.0, "effective samples that the temperature leaves, where it is found", 1.0)
    scale: Literal["increment", "unit"] = setting(
        "increment", "errors counted in root-mean-square changes of each channel, or in the model's units (Eq. 9)"
    )
    clip: float = setting(0.5, "of CAI: clipping range of the probability ratio, as in PPO; 0: the plain ratio", 0.0)
    gradient_steps: int = setting(20, "Adam steps on the samples of an iteration", 1)
    learning_rate: float = setting(1e-3, "of Adam, at the start; it falls linearly to a tenth", 0.0)
    flow: Literal["auto", "realnvp", "nsf", "maf"] = setting("auto", "kind of normalizing flow (auto: Real NVP)")
    transforms: int = setting(6, "layers of the flow", 1)
    hidden: int = setting(64, "width of the two hidden layers of every transform", 1)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.beta is None and self.least_effective > self.samples:
            raise BadInput(
                f"least_effective is {self.least_effective:g}; it can be at most samples, which is {self.samples}"
            )


@dataclass(frozen=True)
class TrajectoryConfig:
    """Settings of the episode-level estimator.

    Raises:
        BadInput: a value below its least.
    """

    horizon: int = setting(1, "control steps predicted open loop before comparing", 1)
    starts: int = setting(4, "quasi-random starting points for every robot", 1)
    steps: int = setting(8, "steps of Levenberg-Marquardt in a round", 1)
    rounds: int = setting(12, "at most so many rounds; each learns the noise anew", 1)
    draws: int = setting(
        100,
        "parameter vectors drawn for every robot in a round of the population: at least 30 and 4 for every parameter, "
        "fewer where 20000 for all robots together are enough",
        4,
    )
    population_rounds: int = setting(4, "at most so many rounds of the population; it stops where it gains no more", 1)

    def __post_init__(self) -> None:
        check_settings(self)


def check_settings(config: Any) -> None:
    """Refuse values of a settings dataclass below their least, and names that are no choice.

    NumPy's numbers become plain ones, which JSON can hold.

    Raises:
        BadInput: naming the setting, the value and the least or the choices.
    """
    types = get_type_hints(type(config))
    for f in fields(config):
        value, least = getattr(config, f.name), f.metadata.get("least")
        if get_origin(types[f.name]) is Literal and value not in get_args(types[f.name]):
            choices = ", ".join(map(repr, get_args(types[f.name])))
            raise BadInput(f"{f.name} is {value!r}; it must be one of {choices} ({f.metadata['help']})")
        if least is None or (value is None and type(None) in get_args(types[f.name])):
            continue
        number = int | np.integer if f.type == "int" else int | float | np.integer | np.floating
        if isinstance(value, bool) or not isinstance(value, number) or not least <= value < float("inf"):
            raise BadInput(
                f"{f.name} is {value!r}; it must be a{'n integer' if f.type == 'int' else ' number'} of at "
                f"least {least:g} ({f.metadata['help']})"
            )
        if isinstance(value, np.generic):
            object.__setattr__(config, f.name, value.item())
