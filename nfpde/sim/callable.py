"""A simulator made of a plain Python function."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset, Windows
from nfpde.dataset.model_fit import in_order_of_names
from nfpde.dataset.naming import naming
from nfpde.errors import BadDataset, BadInput
from nfpde.parameters import ParameterSpace
from nfpde.sim.simulator import Array, Simulator
from nfpde.sim.states import StateSpace

Step = Callable[[Array, Array, Array], Array]


class CallableSimulator(Simulator):
    """Wraps `step(state, ctrl, xi) -> next state`: an ODE, another engine, a learned model.

    Args:
        step: advances R rows by one control step: state (R, nq+nv), ctrl (R, nu), xi (R, D) to (R, nq+nv). NaN in a
            row says that it diverged. What it raises is passed on as it is.
        space: the parameters.
        positions: names of the qpos columns.
        velocities: names of the qvel columns; may be empty.
        commands: names of the ctrl columns. Without them the number of commands is not checked: recordings of another
            robot, with as many positions and velocities, reach `step` as they are.

    Example:
        >>> from nfpde.parameters import Parameter
        >>> space = ParameterSpace([Parameter("rate", low=0.0, high=2.0, unit="1/s")])
        >>> decay = CallableSimulator(lambda x, u, xi: x * np.exp(-0.1 * xi), space, positions=["level"])
    """

    def __init__(
        self,
        step: Step,
        space: ParameterSpace,
        positions: list[str],
        velocities: list[str] | None = None,
        commands: list[str] | None = None,
    ) -> None:
        self.step = step
        self.space = space
        self.positions, self.velocities = list(positions), list(velocities or [])
        self.states = StateSpace.euclidean(self.positions, self.velocities)
        self.commands = None if commands is None else list(commands)

    def prepare(self, dataset: Dataset) -> Dataset:
        """Check the numbers of positions and velocities, and of commands where they have names; order named columns.

        Returns:
            The data set; where it names its columns, in the order of the names given here.

        Raises:
            BadDataset: they do not fit; the text says what the simulator has.
        """
        if self.commands is not None and dataset.nu != len(self.commands):
            raise BadDataset(
                f"the data has nu={dataset.nu}, the simulator {len(self.commands)} command(s): "
                f"{', '.join(self.commands) or '(none)'}"
            )
        dataset = super().prepare(dataset)
        own = dataset.column_names.ctrl or ()
        names = {
            "qpos": self.positions,
            "qvel": self.velocities,
            "ctrl": own if self.commands is None else self.commands,
        }
        with naming(dataset.source):
            return in_order_of_names(dataset, names)

    def identity(self) -> dict[str, Any]:
        """The names of channels and commands, and the function's module and name.

        Functions of one name in one module, as lambdas are, and a function that was edited, cannot be told apart.
        """
        function: Any = self.step
        while isinstance(function, functools.partial):
            function = function.func
        named = function if hasattr(function, "__qualname__") else type(function)
        return {
            **super().identity(),
            "channels": list(self.states.channels),
            "commands": self.commands,
            "step": f"{named.__module__}.{named.__qualname__}",
        }

    def rollout(self, xi: Array, windows: Windows, vector: NDArray[np.intp], window: NDArray[np.intp]) -> Array:
        """Call the function once per control step with all rows; see `Simulator.rollout`.

        Raises:
            BadInput: the function returned another shape.
        """
        state = windows.state[window, 0]
        rows = xi[vector]
        out = np.empty((len(vector), windows.horizon, self.states.nx))
        for h in range(windows.horizon):
            state = np.asarray(self.step(state, windows.ctrl[window, h], rows), dtype=np.float64)
            if state.shape != out[:, h].shape:
                raise BadInput(f"step must return next states of shape {out[:, h].shape}, it returned {state.shape}")
            out[:, h] = state
        self.simulated_steps += len(vector) * windows.horizon
        broken = ~np.isfinite(out).all(2)
        out[np.logical_or.accumulate(broken, axis=1)] = np.nan
        return out
