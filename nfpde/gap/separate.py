"""Which experiment would tell two explanations apart: simulate both on candidate excitations, compare with noise."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Windows
from nfpde.elements import actuator_ctrls, element_names
from nfpde.gap.fit import Fit
from nfpde.sim import StateSpace

Array = NDArray[np.float64]

_DURATION = 1.0
"""Length of a proposed experiment [s]."""

_FEWEST_STEPS = 10
"""Control steps of one, at least: where these are long it takes longer."""

_STEP_AT = 0.2
"""Share of an experiment after which commands step."""

_RESOLVED = 0.25
"""Share of the control rate up to which a sine is one: of fewer than four commands a period nothing like it is left."""


def separating_experiment(a: Fit, b: Fit, windows: Windows, sigma: Array, names: tuple[str, str]) -> str:
    """The excitation on which two fitted explanations differ most, in words that say what was simulated.

    Args:
        a: One explanation.
        b: The other.
        windows: Recorded windows: starts, commands and their ranges come from here.
        sigma: Noise of the sensors (2 nv,).
        names: What to call the two.
    """
    model, states = a.replay.sim.model, a.replay.sim.states
    steps = max(round(_DURATION / windows.control_dt), _FEWEST_STEPS)
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
    """Commands as texts and windows of `steps` control steps, from a start at rest near the recorded positions.

    Every command goes between two values, about the middle of its recorded range and inside its control range.
    """
    ctrl = windows.ctrl.reshape(-1, model.nu)
    middle, half = 0.5 * (ctrl.max(0) + ctrl.min(0)), 0.5 * (ctrl.max(0) - ctrl.min(0))
    half = np.where(half > 0, half, 1.0)
    limited = model.actuator_ctrllimited.astype(bool)
    low, high = np.where(limited, model.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
    middle = np.clip(_rounded(middle, half), low, high)
    end, dt = steps * windows.control_dt, windows.control_dt
    time = np.arange(float(steps)) * dt
    still, late = np.zeros(steps), time >= _STEP_AT * end
    ramp = 1.0 - np.abs(2.0 * time / max(float(time[-1]), 1e-12) - 1.0)

    def upward(size: float) -> tuple[Array, Array]:
        return middle, np.clip(middle + size * half, low, high)

    def both(size: float) -> tuple[Array, Array]:
        return np.clip(middle - size * half, low, high), np.clip(middle + size * half, low, high)

    half_way, after = f"in {0.5 * end:.2g} s and back in as long", f"after {_STEP_AT * end:.2g} s"
    tried = [
        ("Hold the commands still,", "", still, (middle, middle)),
        ("Ramp the commands slowly, up and down once,", f", {half_way}", ramp, upward(1.0)),
        ("Step the commands", f", {after}", late.astype(float), upward(1.0)),
        ("Step the commands beyond what was recorded,", f", {after}", late.astype(float), upward(2.0)),
    ]
    sines = [(1.0, 0.1, "Drive with a small sine"), (1.0, 1.0, "Drive with a sine"), (5.0, 1.0, "Drive with a sine")]
    for rate, size, text in [*sines, (2.0, 2.0, "Drive beyond what was recorded with a sine")]:
        if rate <= _RESOLVED / dt:
            wave = 0.5 + 0.5 * np.sin(2 * np.pi * rate * time)
            tried.append((f"{text} of {rate:.0f} Hz,", "", wave, both(size)))
    rest = windows.state[:1, 0].copy()
    rest[:, model.nq :] = 0.0
    names, out = _command_names(model), list[tuple[str, Windows]]()
    for text, more, shape, (first, last) in tried:
        command = first + shape[:, None] * (last - first)
        ranges = _ranges(names, first, last)
        said = f"{text.rstrip(',') if ranges.startswith('(') else text} {ranges}"
        out.append((f"{said}{more}, starting at rest", _window(windows, rest, command)))
    return out


def _command_names(model: mujoco.MjModel) -> list[str]:
    """Names of the commands (nu,): those of their actuators, with a number where one has several."""
    names = [f"#{i}" for i in range(model.nu)]
    for i, name in enumerate(element_names(model, "actuator")):
        columns = actuator_ctrls(model, np.array([i])).tolist()
        for k, column in enumerate(columns):
            names[column] = name if len(columns) == 1 else f"{name}[{k}]"
    return names


def _ranges(names: list[str], first: Array, last: Array) -> str:
    """Where commands go from and to, in words; in their own units."""
    said = [_range(float(a), float(b)) for a, b in zip(first, last, strict=True)]
    if len(set(said)) == 1:
        return said[0] if len(said) == 1 else f"all {said[0]}"
    return f"({', '.join(f'{name} {one}' for name, one in zip(names, said, strict=True))})"


def _range(first: float, last: float) -> str:
    """Two numbers to three digits of what lies between them."""
    width = abs(last - first)
    if width == 0:
        return f"at {first:.10g}"
    return "from {:.10g} to {:.10g}".format(*_rounded(np.array([first, last]), width))


def _rounded(values: Array, width: Array | float) -> Array:
    """Numbers to three digits of their widths, so that people can type them."""
    unit = 10.0 ** (np.floor(np.log10(width)) - 2)
    return np.round(values / unit) * unit + 0.0  # without the sign of a zero


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
