"""Which experiment would tell two explanations apart: simulate both on candidate excitations, compare with noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.gap.fit import Fit
from nfpde.sim import StateSpace

Array = NDArray[np.float64]

_DURATION = 1.0
"""Length of a proposed experiment [s]."""

_MOST_STEPS = 200


def separating_experiment(a: Fit, b: Fit, windows: Windows, sigma: Array, names: tuple[str, str]) -> str:
    """The excitation on which two fitted explanations differ most, in words.

    Args:
        a: One explanation.
        b: The other.
        windows: Recorded windows: starts, commands and their ranges come from here.
        sigma: Noise of the sensors (2 nv,).
        names: What to call the two.
    """
    model, states = a.replay.sim.model, a.replay.sim.states
    steps = int(np.clip(round(_DURATION / windows.control_dt), 10, _MOST_STEPS))
    if model.nu == 0:
        return "Release the robot from other positions and speeds than those recorded."
    best: tuple[float, str, str] | None = None
    for text, proposal in _proposals(model, windows, steps):
        difference, channel = _difference(a, b, proposal, sigma, states)
        if best is None or difference > best[0]:
            best = difference, text, channel
    if best is None or best[0] < 3.0:
        return (
            f"No excitation tried tells {names[0]} from {names[1]} with these sensors: measure the other quantity "
            f"directly, or accept either."
        )
    span = steps * windows.control_dt
    return f"{best[1]}: within {span:.2g} s the two differ by {best[0]:.0f} times the noise in {best[2]}."


def _proposals(model: mujoco.MjModel, windows: Windows, steps: int) -> list[tuple[str, Windows]]:
    """Commands as texts and windows of `steps` control steps, from a start at rest near the recorded positions."""
    ctrl = windows.ctrl.reshape(-1, model.nu)
    middle, span = np.median(ctrl, axis=0), 0.5 * (ctrl.max(0) - ctrl.min(0))
    span = np.where(span > 0, span, 1.0)
    low, high = model.actuator_ctrlrange.T
    limited = model.actuator_ctrllimited.astype(bool)
    time = np.arange(float(steps))[:, None] * windows.control_dt
    shapes: list[tuple[str, Callable[[Array], NDArray[Any]]]] = [
        ("Hold the commands still", lambda t: 0.0 * t),
        ("Ramp the commands slowly, up and down once", lambda t: 1 - np.abs(2 * t / (t[-1] + 1e-12) - 1)),
        ("Step the commands to their recorded extreme", lambda t: np.where(t > 0.2 * t[-1], 1.0, 0.0)),
        ("Step the commands to twice their recorded extreme", lambda t: np.where(t > 0.2 * t[-1], 2.0, 0.0)),
        ("Drive with a small sine of 1 Hz, a tenth of the recorded amplitude", lambda t: 0.1 * np.sin(2 * np.pi * t)),
        ("Drive with a sine of 1 Hz, of the recorded amplitude", lambda t: np.sin(2 * np.pi * t)),
        ("Drive with a fast sine of 5 Hz, of the recorded amplitude", lambda t: np.sin(10 * np.pi * t)),
        ("Drive with a sine of 2 Hz, of twice the recorded amplitude", lambda t: 2.0 * np.sin(4 * np.pi * t)),
    ]
    rest = windows.state[:1, 0].copy()
    rest[:, model.nq :] = 0.0
    out = []
    for text, shape in shapes:
        command = middle + span * shape(time)
        command = np.where(limited, np.clip(command, low, high), command)
        out.append((text, _window(windows, rest, command)))
    return out


def _window(windows: Windows, start: Array, command: Array) -> Windows:
    """One window from a state (1, nx) under commands (steps, nu); what is measured there is unknown and not used."""
    state = np.broadcast_to(start[:, None], (1, len(command) + 1, start.shape[1]))
    history = np.broadcast_to(command[:1], (1, windows.nhistory, command.shape[1]))
    zero = np.zeros(1, int)
    past = np.empty((1, 0, start.shape[1]))
    return replace(windows, state=state, ctrl=command[None], history=history, past=past, episode=zero, row=zero)


def _difference(a: Fit, b: Fit, window: Windows, sigma: Array, states: StateSpace) -> tuple[float, str]:
    """Largest difference over all channels, in noise standard deviations, and its channel."""
    x, y = (fit.replay.predict(fit.xi[None], window)[0, 0] for fit in (a, b))
    apart = np.abs(states.difference(x, y))
    size = np.abs(states.difference(x, np.broadcast_to(window.state[0, :1], x.shape))).max(0)
    unit = np.maximum(sigma, 1e-3 * size + 1e-9)
    ratio = np.nan_to_num(apart / unit, nan=0.0, posinf=0.0).max(0)
    worst = int(ratio.argmax())
    return float(ratio[worst]), states.channels[worst]
