"""What nfpde asks of a simulator: set a state, step, compare. Nothing above this file knows which one runs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nfpde.dataset import Dataset, Windows
from nfpde.errors import BadDataset, BadInput
from nfpde.parameters import ParameterSpace
from nfpde.sim.states import StateSpace
from nfpde.sim.whitening import Whitening

Array = NDArray[np.float64]

LOSS_LIMIT = 1e12
"""Loss of a simulation that diverged, and the most any loss can be."""

CHUNK_ROWS = 4096
"""Simulations that run side by side, at most: enough to keep every core busy."""

CHUNK_NUMBERS = 1 << 23
"""Numbers of their states that are held at once, at most (64 MiB): long windows run in smaller groups."""


class OnDevice(Protocol):
    """An array in some device's memory, which `torch.from_dlpack` and `numpy.from_dlpack` read without a copy."""

    def __dlpack__(self, *args: Any, **kwargs: Any) -> Any:
        """The array as a DLPack capsule."""
        ...

    def __dlpack_device__(self) -> Any:
        """Kind and number of the device."""
        ...


class Simulator(ABC):
    """A black box that predicts what a robot with parameters xi does under recorded commands.

    To use your own, subclass and write `rollout`, or wrap a function in `CallableSimulator`.

    Attributes:
        space: the parameters, D of them, those of effects last.
        states: the layout of a state and of the difference of two.
        memory_time: how far back [s] commands matter; windows must hold that much history.
        recall_time: how far back [s] effects follow the recorded motion, where windows hold it.
        forgets: whether commands from before `memory_time` never matter; else all that windows hold are simulated.
        jumps: columns of parameters along which predictions jump, such as the choice of a model; a fit that follows
            slopes refuses them.
        simulated_steps: physics steps taken so far, the unit in which estimators are compared.
        rounding: relative rounding error of the numbers that it computes with; tells what differences can resolve.
    """

    space: ParameterSpace
    states: StateSpace
    memory_time: float = 0.0
    recall_time: float = 0.0
    forgets: bool = True
    jumps: tuple[int, ...] = ()
    simulated_steps: int = 0
    rounding: float = float(np.finfo(np.float64).eps)

    @abstractmethod
    def rollout(self, xi: Array, windows: Windows, vector: NDArray[np.intp], window: NDArray[np.intp]) -> Array:
        """Simulate R pairs open loop from the measured start of their window.

        Args:
            xi: parameter vectors, (M, D).
            windows: N windows of H control steps.
            vector: which parameter vector each row has, (R,); sorted order is fastest.
            window: which window each row replays, (R,).

        Returns:
            Predicted measurements (qpos, qvel) at the end of control steps 1 to H, (R, H, nq+nv). From the step on
            in which a simulation diverged, its row is NaN.
        """

    def predict(self, xi: ArrayLike, windows: Windows) -> Array:
        """Predicted states of all pairs: parameter vectors (M, D), N windows, to (M, N, H, nq+nv).

        Raises:
            BadParameter: parameter vectors of the wrong shape or outside their bounds.
            BadInput: windows of another robot, or without enough history.
        """
        xi = self._check(xi, windows)
        m, n = len(xi), len(windows)
        out = np.empty((m * n, windows.horizon, self.states.nx))
        for rows, vectors in _chunks(m, n, rows_at_once(windows.horizon * self.states.nx)):
            vector, window = np.divmod(np.arange(rows.start, rows.stop), n)
            out[rows] = self.rollout(xi[vectors], windows, vector - vectors.start, window)
        return out.reshape(m, n, windows.horizon, self.states.nx)

    def losses(self, xi: ArrayLike, windows: Windows, scale: ArrayLike) -> Array:
        """Squared prediction errors of all pairs, without keeping the states.

        The loss of a pair is the sum over its H steps and all channels of (difference / scale)^2; with scale 1 and
        H = 1 it is Eq. 9 of Takano et al., IROS 2024. A simulation that diverged costs `LOSS_LIMIT`, and nothing
        costs more.

        Args:
            xi: parameter vectors, (M, D).
            windows: N windows of H control steps.
            scale: what counts as one unit of error in each channel, (ndiff,), positive.

        Returns:
            Losses, (M, N), finite.

        Raises:
            BadParameter: parameter vectors of the wrong shape or outside their bounds.
            BadInput: windows of another robot or without enough history, or a scale that is not positive.
        """
        xi = self._check(xi, windows)
        scale = np.asarray(scale, dtype=np.float64)
        if scale.shape != (self.states.ndiff,) or not (scale > 0).all():
            raise BadInput(f"scale must be {self.states.ndiff} positive numbers, one per channel, got {scale}")
        m, n = len(xi), len(windows)
        out = np.empty(m * n)
        for rows, vectors in _chunks(m, n, rows_at_once(windows.horizon * self.states.nx)):
            vector, window = np.divmod(np.arange(rows.start, rows.stop), n)
            predicted = self.rollout(xi[vectors], windows, vector - vectors.start, window)
            out[rows] = squared_error(self.states, predicted, windows.target[window], scale)
        return out.reshape(m, n)

    def residuals(
        self, xi: Array, windows: Windows, vector: NDArray[np.intp], window: NDArray[np.intp], scale: ArrayLike
    ) -> Array:
        """Predicted minus measured at the end of every control step, in units of `scale`, of any pairs.

        Args:
            xi: parameter vectors, (M, D).
            windows: N windows of H control steps.
            vector: which parameter vector each row has, (R,); sorted order is fastest.
            window: which window each row replays, (R,).
            scale: what counts as one, in each channel of each step, (H ndiff,), positive.

        Returns:
            Residuals, (R, H ndiff); NaN from the step on in which a simulation diverged.

        Raises:
            BadInput: a scale that is not positive or of another shape, or windows that do not fit.
        """
        unit = self._check_unit(windows, scale)
        predicted = self.rollout(xi, windows, vector, window)
        difference = self.states.difference(predicted, windows.target[window])
        return difference.reshape(len(vector), len(unit)) / unit

    def costs(
        self,
        xi: Array,
        windows: Windows,
        vector: NDArray[np.intp],
        window: NDArray[np.intp],
        scale: ArrayLike,
        whitening: Whitening,
    ) -> Array:
        """What whole recordings cost: the rows of `residuals`, whitened along the recordings and added up by vector.

        Args:
            xi: parameter vectors, (M, D).
            windows: N windows of H control steps.
            vector: which parameter vector each row has, sorted, (R,).
            window: which window each row replays, in recorded order for each vector, (R,).
            scale: as in `residuals`.
            whitening: of the N windows.

        Returns:
            Twice the negative log likelihood of every vector, up to a constant, (M,). A simulation that diverged
            counts as a window with a squared white innovation of 1e30.

        Raises:
            BadInput: vectors that are not sorted, a whitening of other windows, or what `residuals` refuses.
        """
        self._check_unit(windows, scale)
        check_rows(vector, windows, whitening)
        out = np.zeros(len(xi))
        for rows in whole_vectors(vector, rows_at_once(windows.horizon * self.states.nx)):
            own = slice(int(vector[rows.start]), int(vector[rows.stop - 1]) + 1)
            v = vector[rows] - own.start
            residuals = self.residuals(xi[own], windows, v, window[rows], scale)
            out[own] = whitening.costs(residuals, v, window[rows], own.stop - own.start)
        return out

    def losses_on_device(self, xi: ArrayLike, windows: Windows, scale: ArrayLike) -> OnDevice:
        """`losses` (M, N) where they were computed; the next call of the simulator may write over them."""
        return self.losses(xi, windows, scale)

    def release(self) -> None:
        """Give back the memory that is held for the next call, which takes it anew."""
        return

    def prepare(self, dataset: Dataset) -> Dataset:
        """Check that recordings fit this simulator; returns them, in its order where it and they name columns.

        Raises:
            BadDataset: they do not fit; the text says what the simulator has.
        """
        if (dataset.nq, dataset.nv) != (self.states.nq, self.states.nv):
            raise BadDataset(
                f"the data has nq={dataset.nq}, nv={dataset.nv}, the simulator nq={self.states.nq}, "
                f"nv={self.states.nv}: {', '.join(self.states.channels)}"
            )
        return dataset

    def identity(self) -> dict[str, Any]:
        """What tells this simulator from another one, as JSON; a resumed run must find the same."""
        return {"class": type(self).__name__}

    def history_steps(self, control_dt: float) -> int:
        """Commands before a window's start that its simulation makes use of, at a control step of control_dt [s]."""
        return steps_back(self.memory_time, control_dt) + self.past_steps(control_dt)

    def known_steps(self, windows: Windows) -> int:
        """Commands before the windows' starts that are simulated: those that matter, or all there are."""
        return min(self.history_steps(windows.control_dt), windows.nhistory) if self.forgets else windows.nhistory

    def past_steps(self, control_dt: float) -> int:
        """States before a window's start that its simulation makes use of, at a control step of control_dt [s]."""
        return int(np.ceil(self.recall_time / control_dt - 1e-9))

    def recalled_steps(self, windows: Windows, recall_time: float | None = None) -> int:
        """Control steps before the windows that effects are taken through: as many as they want and windows hold.

        Args:
            windows: the windows.
            recall_time: how far back [s]; None: what any effect wants.
        """
        wanted = (self.recall_time if recall_time is None else recall_time) / windows.control_dt
        spare = windows.nhistory - steps_back(self.memory_time, windows.control_dt)
        return max(0, min(int(np.ceil(wanted - 1e-9)), windows.past.shape[1], spare))

    def _check_unit(self, windows: Windows, scale: ArrayLike) -> Array:
        unit = np.asarray(scale, dtype=np.float64)
        if unit.shape != (windows.horizon * self.states.ndiff,) or not (unit > 0).all():
            raise BadInput(
                f"scale must be {windows.horizon * self.states.ndiff} positive numbers, one per channel of each of "
                f"the {windows.horizon} control step(s), got {unit}"
            )
        return unit

    def _check(self, xi: ArrayLike, windows: Windows) -> Array:
        checked = self.space.check(xi)
        if (windows.nq, windows.nv) != (self.states.nq, self.states.nv):
            raise BadInput(
                f"the windows have nq={windows.nq}, nv={windows.nv}, the simulator nq={self.states.nq}, "
                f"nv={self.states.nv}"
            )
        needed = steps_back(self.memory_time, windows.control_dt)
        if windows.history.shape[1] < needed:
            raise BadInput(
                f"effects of this simulator look {self.memory_time:g} s back: cut the windows with history={needed}, "
                f"they have {windows.history.shape[1]}"
            )
        return checked


def steps_back(memory_time: float, control_dt: float) -> int:
    """Commands before a window's start on which those within it depend."""
    return int(np.ceil(memory_time / control_dt - 1e-9)) + 1 if memory_time > 0 else 0


def squared_error(states: StateSpace, predicted: Array, measured: Array, scale: Array) -> Array:
    """Sum over steps and channels of (difference / scale)^2, at most `LOSS_LIMIT`: (R, H, nx) twice to (R,)."""
    with np.errstate(over="ignore", invalid="ignore"):
        error = states.difference(predicted, measured) / scale
        loss = np.einsum("rhc,rhc->r", error, error)
    return np.where(loss < LOSS_LIMIT, loss, LOSS_LIMIT)


def check_rows(vector: NDArray[np.intp], windows: Windows, whitening: Whitening) -> None:
    """Refuse rows and a whitening that `Simulator.costs` cannot use.

    Raises:
        BadInput: vectors that are not sorted, or a whitening of other windows.
    """
    if (np.diff(vector) < 0).any():
        raise BadInput("vector must be sorted: costs are added up along the rows of one vector after the other")
    if len(whitening.linked) != len(windows):
        raise BadInput(f"the whitening is of {len(whitening.linked)} windows, got {len(windows)}")


def whole_vectors(vector: NDArray[np.intp], most: int) -> list[slice]:
    """Cut sorted rows into runs of about `most` rows, none of which splits the rows of a vector."""
    first = np.flatnonzero(np.diff(vector, prepend=-1))
    starts = first[np.flatnonzero(np.diff(first // most, prepend=-1))]
    return [slice(int(a), int(b)) for a, b in pairwise([*starts, len(vector)])]


def rows_at_once(numbers: int) -> int:
    """How many simulations may run side by side when each keeps that many numbers."""
    return max(1, min(CHUNK_ROWS, CHUNK_NUMBERS // numbers))


def _chunks(m: int, n: int, size: int) -> list[tuple[slice, slice]]:
    """Cut the m x n pairs, vector by vector, into runs of `size` rows with the parameter vectors they touch."""
    total = m * n
    starts = range(0, total, size)
    ends = [min(s + size, total) for s in starts]
    return [(slice(s, e), slice(s // n, (e - 1) // n + 1)) for s, e in zip(starts, ends, strict=True)]
