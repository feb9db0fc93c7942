"""What a fit left beside its distribution: whether an environment simulates the model that was fitted."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import mujoco

from nfpde.errors import BadInput, BadModel
from nfpde.estimation.result import SCHEMA_VERSION
from nfpde.parameters import ParameterSpace
from nfpde.sim import load_model, model_hash
from nfpde.storage import read_json

FIT_FILE = "fit.json"
OF_A_FIT = ("distribution", "initial", "episodes")
"""Folders of distributions beside it."""


def find_distribution(folder: Path) -> tuple[Path, Path | None]:
    """Where a distribution lies, and the fit.json beside it, None where there is none.

    Args:
        folder: of a fit, or of a saved distribution, which may be the one within a fit's.
    """
    inner = folder / "distribution"
    if inner.is_dir():
        return inner, _existing(folder / FIT_FILE)
    whole = folder.resolve()
    return folder, _existing(whole.parent / FIT_FILE) if whole.name in OF_A_FIT else None


def check_model(fit: Path, env: str, model: Path | None, space: ParameterSpace) -> None:
    """Refuse an environment that simulates another model than the one that was fitted.

    Models are told apart by their fingerprints, which are comparable within one version of MuJoCo only. The file that
    the environment read counts as well as its model, because `load_model` compiles a file in a way of its own.

    Args:
        fit: what `nfpde fit` wrote beside the distribution.
        env: short name or Gymnasium id of the environment.
        model: MJCF file in place of the environment's own.
        space: the distribution's parameters.

    Raises:
        BadInput: the models differ, or the file is no JSON object of a fit.
        BadParameter, BadEffect, BadModel: an environment that the distribution cannot be used in.
    """
    from nfpde.rl import RandomizedParameters, make_environment  # stable-baselines3 takes seconds to import

    made = RandomizedParameters(make_environment(env, model), None, space)
    try:
        simulator = read_json(fit, SCHEMA_VERSION).get("simulator")
        facts = simulator if isinstance(simulator, dict) else {}
        fitted = facts.get("model")  # simulators other than MuJoCo's have none
        if fitted is None or facts.get("mujoco") != mujoco.__version__:
            return
        here = _prints(made)
    finally:
        made.close()
    if here.isdisjoint(fitted if isinstance(fitted, list) else [fitted]):
        what = f"the model {model}" if model is not None else f"environment {made.label}'s own model"
        raise BadInput(
            f"{what} is not the one that {fit} was fitted to: its parameters would be put into another robot; give the "
            "fitted file with --model FILE, or, where the environment has it within a larger scene, --another-model"
        )


def _prints(env: Any) -> set[str]:
    """Fingerprints of an environment's model and of the file that it was read from."""
    found = {model_hash(env.nominal_model)}
    with contextlib.suppress(AttributeError, BadModel):  # of a model that was made in code there is no file
        found.add(model_hash(load_model(env.unwrapped.fullpath)))
    return found


def _existing(path: Path) -> Path | None:
    return path if path.is_file() else None
