"""One recording: time, measured state and command, row by row."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nfpde.dataset.arrays import frozen_floats
from nfpde.errors import BadDataset


@dataclass(frozen=True, eq=False)
class Episode:
    """One recording of one robot, checked when it is made and never changed afterwards.

    Row r holds the state measured at `time[r]` and the command that acts from there to row r+1. The last
    row's command is never used, yet must be finite. Time only has to increase here: a `Dataset` asks for
    even steps, `resample_episode` makes them.

    Attributes:
        name: Label, unique within a data set.
        time: Times [s], strictly increasing. Shape (T,), T at least 2.
        qpos: Positions in MuJoCo's order and units ([rad], [m], unit quaternions w, x, y, z). Shape (T, nq).
        qvel: Velocities in MuJoCo's order and units ([rad/s], [m/s]). Shape (T, nv).
        ctrl: Commands, in the units of the model's actuators. Shape (T, nu); nu may be 0.
        robot: Label of the physical robot, where several were recorded.

    Example:
        >>> fall = Episode("fall", time=[0.0, 0.1], qpos=[[1.0], [0.9]], qvel=[[0.0], [-1.0]], ctrl=[[], []])
        >>> len(fall), fall.nq, fall.nv, fall.nu
        (2, 1, 1, 0)
    """

    name: str
    time: NDArray[np.float64]
    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    ctrl: NDArray[np.float64]
    robot: str | None = None

    if TYPE_CHECKING:  # what the generated constructor takes: anything that makes an array

        def __init__(
            self,
            name: str,
            time: ArrayLike,
            qpos: ArrayLike,
            qvel: ArrayLike,
            ctrl: ArrayLike,
            robot: str | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        check_label(self.name, "an episode's name")
        if self.robot is not None:
            check_label(self.robot, f"episode {self.name!r}: the robot label")
        for field, ndim in (("time", 1), ("qpos", 2), ("qvel", 2), ("ctrl", 2)):
            array = frozen_floats(getattr(self, field), f"episode {self.name!r}: {field}", ndim)
            object.__setattr__(self, field, array)
        self._check_lengths()
        for field in ("time", "qpos", "qvel", "ctrl"):
            self._check_finite(field)
        self._check_time_increases()

    def __len__(self) -> int:
        """Number of rows T."""
        return len(self.time)

    @property
    def nq(self) -> int:
        """Number of position columns."""
        return self.qpos.shape[1]

    @property
    def nv(self) -> int:
        """Number of velocity columns."""
        return self.qvel.shape[1]

    @property
    def nu(self) -> int:
        """Number of command columns."""
        return self.ctrl.shape[1]

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time[-1] - self.time[0])

    def __repr__(self) -> str:
        robot = "" if self.robot is None else f", robot {self.robot!r}"
        return f"Episode({self.name!r}, {len(self)} rows, {self.duration:.6g} s{robot})"

    def _check_lengths(self) -> None:
        rows = len(self.time)
        for field in ("qpos", "qvel", "ctrl"):
            if len(getattr(self, field)) != rows:
                raise BadDataset(
                    f"episode {self.name!r}: {field} has {len(getattr(self, field))} rows and time has {rows}; "
                    "every array needs one row for each time."
                )
        if rows < 2:
            raise BadDataset(
                f"episode {self.name!r} has {rows} row(s); at least 2 are needed (a state, and the state one "
                "control step later). Remove the episode."
            )
        if self.nq == 0:
            raise BadDataset(f"episode {self.name!r} has no position column (nq=0); at least 1 is needed.")
        if self.nv > self.nq:
            raise BadDataset(
                f"episode {self.name!r} has nq={self.nq} position columns and nv={self.nv} velocity columns; "
                "a MuJoCo model never has more velocities than positions. Look whether they are swapped."
            )

    def _check_finite(self, field: str) -> None:
        array = getattr(self, field)
        if np.isfinite(array).all():
            return
        first = np.argwhere(~np.isfinite(array))[0]
        column = field if field == "time" else f"{field}_{first[1]}"
        hint = " (the last row's command is not used; put 0 there)" if field == "ctrl" else ""
        raise BadDataset(
            f"episode {self.name!r}, row {first[0]}, column {column}: the value is {array[tuple(first)]}; every "
            f"value must be finite. Cut the episode there or fill in the measurement{hint}."
        )

    def _check_time_increases(self) -> None:
        steps = np.diff(self.time)
        if (steps > 0).all():
            return
        row = int(np.argmax(~(steps > 0))) + 1
        raise BadDataset(
            f"episode {self.name!r}, row {row}, column time: {float(self.time[row])!r} s follows "
            f"{float(self.time[row - 1])!r} s; time must increase from row to row. Remove the repeated row, or "
            "begin a new episode there."
        )


def check_label(label: str, what: str) -> None:
    """Refuse a label that some file format could not carry unchanged.

    Args:
        label: Name of an episode, a robot or a column.
        what: What the label is, for the error text.

    Raises:
        BadDataset: It is no text, is empty, or has control characters or spaces at its ends.
    """
    if not isinstance(label, str) or not label or not label.isprintable() or label != label.strip():
        raise BadDataset(f"{what} is {label!r}; it must be printable text, not empty, with no space at either end.")
