"""Windows of a few control steps, cut out of episodes for comparison with a simulation."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nfpde.dataset.arrays import frozen_floats
from nfpde.dataset.episode import Episode
from nfpde.errors import BadDataset, BadInput

_NOTHING = np.empty((0, 0, 0))
_NOTHING.setflags(write=False)


@dataclass(frozen=True, eq=False)
class Windows:
    """N windows of H control steps each; no window crosses the end of an episode.

    Attributes:
        state: Measured states, qpos then qvel; row 0 is the start. Shape (N, H+1, nq+nv).
        ctrl: Commands; row h acts from state h to state h+1. Shape (N, H, nu).
        history: The K commands before the start, oldest first; before an episode's first row, where no
            command is known, its first command is repeated. Shape (N, K, nu).
        past: Measured states of the P rows before the start, oldest first; NaN before an episode's first row, none if
            not given. Shape (N, P, nq+nv).
        control_dt: Control step [s].
        nq: Number of position columns of `state`.
        nv: Number of velocity columns of `state`.
        episode: Index of each window's episode in `Dataset.episodes`. Shape (N,).
        row: Row of each window's start in its episode. Shape (N,).
        skipped_episodes: Indices of the episodes that are too short for one window.
    """

    state: NDArray[np.float64]
    ctrl: NDArray[np.float64]
    history: NDArray[np.float64]
    control_dt: float
    nq: int
    nv: int
    episode: NDArray[np.int64]
    row: NDArray[np.int64]
    skipped_episodes: tuple[int, ...] = ()
    past: NDArray[np.float64] = field(default_factory=lambda: _NOTHING)

    if TYPE_CHECKING:  # what the generated constructor takes: anything that makes an array

        def __init__(
            self,
            state: ArrayLike,
            ctrl: ArrayLike,
            history: ArrayLike,
            control_dt: float,
            nq: int,
            nv: int,
            episode: ArrayLike,
            row: ArrayLike,
            skipped_episodes: tuple[int, ...] = (),
            past: ArrayLike = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        for name in ("state", "ctrl", "history"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), f"windows: {name}", 3))
        past = np.empty((len(self.state), 0, self.state.shape[2])) if self.past is _NOTHING else self.past
        object.__setattr__(self, "past", frozen_floats(past, "windows: past", 3))
        for name in ("episode", "row"):
            object.__setattr__(self, name, _frozen_integers(getattr(self, name), name))
        n, rows, nx = self.state.shape
        nu = self.ctrl.shape[2]
        rules = {
            "state": (self.state.shape, (n, max(rows, 2), self.nq + self.nv)),
            "ctrl": (self.ctrl.shape, (n, rows - 1, nu)),
            "history": (self.history.shape, (n, self.history.shape[1], nu)),
            "past": (self.past.shape, (n, self.past.shape[1], nx)),
            "episode": (self.episode.shape, (n,)),
            "row": (self.row.shape, (n,)),
        }
        for name, (shape, expected) in rules.items():
            if shape != expected:
                raise BadInput(
                    f"windows: {name} has shape {shape}, expected {expected} beside {n} windows of {rows} "
                    f"states with nq={self.nq}, nv={self.nv} (state has {nx} columns)."
                )
        for name in ("state", "ctrl", "history"):
            if not np.isfinite(getattr(self, name)).all():
                window = int(np.argwhere(~np.isfinite(getattr(self, name)))[0, 0])
                raise BadInput(f"windows: {name} of window {window} is not finite.")
        if not (np.isfinite(self.control_dt) and self.control_dt > 0):
            raise BadInput(f"windows: control_dt is {self.control_dt}; it must be a positive number of seconds.")

    def __len__(self) -> int:
        """Number of windows N."""
        return len(self.state)

    def __getitem__(self, index: int | slice | NDArray[Any] | Sequence[int]) -> "Windows":
        """The windows at `index`: an index, a slice, an index array or a mask; always a `Windows`."""
        if isinstance(index, int | np.integer):
            if not -len(self) <= index < len(self):
                raise IndexError(f"window {index} of {len(self)}")
            index = np.array([index])
        return Windows(
            state=_read_only(self.state[index]),
            ctrl=_read_only(self.ctrl[index]),
            history=_read_only(self.history[index]),
            control_dt=self.control_dt,
            nq=self.nq,
            nv=self.nv,
            episode=self.episode[index],
            row=self.row[index],
            skipped_episodes=self.skipped_episodes,
            past=_read_only(self.past[index]),
        )

    @property
    def horizon(self) -> int:
        """Number of control steps H of a window."""
        return self.ctrl.shape[1]

    @property
    def nu(self) -> int:
        """Number of commands."""
        return self.ctrl.shape[2]

    @property
    def nhistory(self) -> int:
        """Number of commands K before the start."""
        return self.history.shape[1]

    @property
    def start(self) -> NDArray[np.float64]:
        """Measured states at the start. Shape (N, nq+nv)."""
        return self.state[:, 0]

    @property
    def target(self) -> NDArray[np.float64]:
        """Measured states after each control step. Shape (N, H, nq+nv)."""
        return self.state[:, 1:]

    def batches(self, size: int, *, seed: int | None = None) -> Iterator[NDArray[np.int64]]:
        """Indices of minibatches that together hold every window once; use as `windows[index]`.

        Args:
            size: Windows in a batch; the last batch may hold fewer.
            seed: Seed of the order; None keeps the order of the windows.

        Yields:
            Index arrays. Shape (size,) or shorter.
        """
        check_count(size, "size", 1)
        order = np.arange(len(self)) if seed is None else np.random.default_rng(seed).permutation(len(self))
        for first in range(0, len(self), size):
            yield order[first : first + size]

    def __repr__(self) -> str:
        return (
            f"Windows({len(self)} of {self.horizon} steps, nq={self.nq}, nv={self.nv}, nu={self.nu}, "
            f"control_dt={self.control_dt:.6g} s)"
        )


def cut_windows(
    episodes: Sequence[Episode],
    control_dt: float,
    *,
    horizon: int,
    stride: int | None,
    history: int,
    past: int = 0,
    at: NDArray[np.intp] | None = None,
    first: int = 0,
) -> Windows:
    """Cut every window that fits, episode by episode, or some of them.

    Args:
        episodes: Recordings of equal nq, nv and nu.
        control_dt: Their control step [s].
        horizon: Control steps H in a window.
        stride: Rows from one start to the next; None means `horizon` (no overlap).
        history: Commands K to give from before the start.
        past: States P to give from before the start.
        at: Indices of the windows wanted, among all that fit; None: all.
        first: Row at which the first window of every episode starts.

    Returns:
        The windows, ordered by episode, then by row.

    Raises:
        BadInput: A count is not a whole number, or too small.
        BadDataset: Not one episode is long enough.
    """
    check_count(horizon, "horizon", 1)
    stride = horizon if stride is None else stride
    check_count(stride, "stride", 1)
    check_count(history, "history", 0)
    check_count(past, "past", 0)
    check_count(first, "first", 0)

    lengths = np.array([len(e) for e in episodes])
    counts = np.maximum((lengths - 1 - first - horizon) // stride + 1, 0)
    if not counts.any():
        raise BadDataset(
            f"no episode is long enough for a window of horizon {horizon}: that takes {horizon + 1 + first} rows, and "
            f"the longest episode has {lengths.max()}. Use a horizon of at most {lengths.max() - 1 - first}."
        )
    episode = np.repeat(np.arange(len(episodes)), counts)
    row = (np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)) * stride + first
    if at is not None:
        episode, row = episode[at], row[at]
    begin = (np.cumsum(lengths) - lengths)[episode, None]  # where the window's episode begins in the joined rows

    state = np.concatenate([np.hstack([e.qpos, e.qvel]) for e in episodes])
    ctrl = np.concatenate([e.ctrl for e in episodes])
    before = np.maximum(row[:, None] + np.arange(-history, 0), 0)
    earlier = row[:, None] + np.arange(-past, 0)
    states_before = np.where(earlier[..., None] >= 0, state[begin + np.maximum(earlier, 0)], np.nan)
    return Windows(
        state=_read_only(state[begin + row[:, None] + np.arange(horizon + 1)]),
        ctrl=_read_only(ctrl[begin + row[:, None] + np.arange(horizon)]),
        history=_read_only(ctrl[begin + before]),
        control_dt=control_dt,
        nq=episodes[0].nq,
        nv=episodes[0].nv,
        episode=episode,
        row=row,
        skipped_episodes=tuple(np.flatnonzero(counts == 0).tolist()),
        past=_read_only(states_before),
    )


def check_count(value: int, name: str, least: int) -> None:
    """Refuse anything but a whole number of at least `least`.

    Args:
        value: The argument.
        name: Its name, for the error text.
        least: Smallest value allowed.

    Raises:
        BadInput: It is no whole number, or too small.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise BadInput(f"{name} is {value!r}; it must be a whole number, at least {least}.")


def _read_only(array: NDArray[np.float64]) -> NDArray[np.float64]:
    array.setflags(write=False)
    return array


def _frozen_integers(value: Any, field: str) -> NDArray[np.int64]:
    array = np.array(value)
    if array.dtype.kind not in "iu" and array.size:
        raise BadInput(f"windows: {field} must hold whole numbers, not {array.dtype}.")
    array = array.astype(np.int64)
    array.setflags(write=False)
    return array
