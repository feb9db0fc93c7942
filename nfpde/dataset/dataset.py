"""A set of recordings of one kind of robot at one control step."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from nfpde.dataset.columns import GROUPS, ColumnNames, repeated
from nfpde.dataset.episode import Episode
from nfpde.dataset.metadata import Metadata
from nfpde.dataset.naming import naming
from nfpde.dataset.resample import resample_episode
from nfpde.dataset.split import held_out_episodes
from nfpde.dataset.timing import control_step, round_step, same_step
from nfpde.dataset.windows import Windows, cut_windows
from nfpde.elements import listed
from nfpde.errors import BadDataset, BadInput


@dataclass(frozen=True, eq=False, repr=False)
class Dataset:
    """Episodes of equal nq, nv, nu and one control step; checked when made, never changed afterwards.

    Attributes:
        episodes: The recordings, at least one, with unique names.
        metadata: What is known of their origin.
        column_names: Element names of the columns, where the file had them.
        extra_columns: Columns or arrays of the file that were not read.
        source: The file, for error texts.
        control_dt: Mean control step of all episodes [s], to 12 significant digits.

    Example:
        >>> swing = Episode("a", time=[0, 0.1, 0.2], qpos=[[0], [1], [2]], qvel=[[9], [8], [7]], ctrl=[[5], [6], [0]])
        >>> data = Dataset([swing])
        >>> data
        Dataset(1 episode, 3 rows, nq=1, nv=1, nu=1, control_dt=0.1 s)
        >>> data.transitions().target
        array([[[1., 8.]],
        <BLANKLINE>
               [[2., 7.]]])
    """

    episodes: Sequence[Episode]
    metadata: Metadata = field(default_factory=Metadata, kw_only=True)
    column_names: ColumnNames = field(default_factory=ColumnNames, kw_only=True)
    extra_columns: tuple[str, ...] = field(default=(), kw_only=True)
    source: str | None = field(default=None, kw_only=True)
    control_dt: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "episodes", tuple(self.episodes))
        object.__setattr__(self, "extra_columns", tuple(self.extra_columns))
        with naming(self.source):
            self._check_episodes()
            object.__setattr__(self, "control_dt", self._common_step())

    @property
    def nq(self) -> int:
        """Number of position columns."""
        return self.episodes[0].nq

    @property
    def nv(self) -> int:
        """Number of velocity columns."""
        return self.episodes[0].nv

    @property
    def nu(self) -> int:
        """Number of command columns."""
        return self.episodes[0].nu

    @property
    def nrow(self) -> int:
        """Number of rows of all episodes together."""
        return sum(len(e) for e in self.episodes)

    @property
    def names(self) -> list[str]:
        """Names of the episodes."""
        return [e.name for e in self.episodes]

    @property
    def robots(self) -> list[str]:
        """Labels of the robots, each once, in order of appearance; empty where none is labelled."""
        return list(dict.fromkeys(e.robot for e in self.episodes if e.robot is not None))

    def __len__(self) -> int:
        """Number of episodes."""
        return len(self.episodes)

    def __iter__(self) -> Iterator[Episode]:
        """The episodes, in order."""
        return iter(self.episodes)

    def __getitem__(self, index: int | str) -> Episode:
        """The episode at a position, or of a name."""
        if isinstance(index, str):
            if index not in self.names:
                raise BadInput(f"no episode is named {index!r}; there are {', '.join(self.names)}.")
            return self.episodes[self.names.index(index)]
        return self.episodes[index]

    def __repr__(self) -> str:
        robots = f", {len(self.robots)} robots" if self.robots else ""
        return (
            f"Dataset({len(self)} episode{'s'[: len(self) != 1]}{robots}, {self.nrow} rows, nq={self.nq}, "
            f"nv={self.nv}, nu={self.nu}, control_dt={self.control_dt:.6g} s)"
        )

    def transitions(self, history: int = 0) -> Windows:
        """Every single control step of every episode, as windows of horizon 1.

        Args:
            history: Number K of commands to give from before each start.

        Returns:
            One window for each row that has a next row.
        """
        return self.windows(1, history=history)

    def windows(
        self,
        horizon: int,
        *,
        stride: int | None = None,
        history: int = 0,
        past: int = 0,
        at: NDArray[np.intp] | None = None,
        first: int = 0,
    ) -> Windows:
        """Windows of `horizon` control steps; episodes too short for one are skipped and listed.

        Args:
            horizon: Number H of control steps in a window.
            stride: Rows from one start to the next; None means `horizon` (no overlap).
            history: Number K of commands to give from before each start.
            past: Number P of states to give from before each start.
            at: Indices of the windows wanted, among all that fit; None: all. What comes before them takes memory.
            first: Row at which the first window of every episode starts.

        Returns:
            The windows, ordered by episode, then by row; `Windows.skipped_episodes` lists what was skipped.

        Raises:
            BadDataset: Every episode is too short.
        """
        with naming(self.source):
            return cut_windows(
                self.episodes,
                self.control_dt,
                horizon=horizon,
                stride=stride,
                history=history,
                past=past,
                at=at,
                first=first,
            )

    def split(self, held_out: float | Sequence[str], *, seed: int = 0) -> tuple["Dataset", "Dataset"]:
        """Split into a data set to fit and one to test on, never inside an episode.

        Where two or more robots are labelled a share is one of robots (an episode without a label stands
        for itself); otherwise of episodes.

        Args:
            held_out: Share in (0, 1), rounded, at least one and never all; or names of episodes or robots.
            seed: Seed of the choice; without effect on names.

        Returns:
            The rest and the held-out episodes, each in the order of this data set.

        Raises:
            BadInput: The share or a name does not make sense.
            BadDataset: One side would be empty.
        """
        with naming(self.source):
            out = held_out_episodes(self.episodes, held_out, seed)
        rest = [i for i in range(len(self)) if i not in set(out)]
        return self.subset(rest), self.subset(out)

    def subset(self, index: Sequence[int]) -> "Dataset":
        """The episodes at the positions `index`, in that order, with everything else unchanged."""
        return replace(self, episodes=[self.episodes[i] for i in index])

    def of_robot(self, robot: str) -> "Dataset":
        """The recordings of one robot.

        Args:
            robot: Its label.

        Raises:
            BadInput: No episode has it.
        """
        chosen = [i for i, e in enumerate(self.episodes) if e.robot == robot]
        if not chosen:
            said = f"of {listed(self.robots)}" if self.robots else "that name no robot"
            raise BadInput(f"there is no robot {robot!r} in these recordings {said}")
        return self.subset(chosen)

    def resample(
        self, control_dt: float, *, quaternions: Sequence[int] = (), max_gap: float | None = None
    ) -> "Dataset":
        """The same recordings at another control step; see `resample_episode`.

        Args:
            control_dt: New control step [s].
            quaternions: First qpos column of each unit quaternion.
            max_gap: Longest step to bridge [s]; None means 5 median steps.

        Returns:
            The resampled data set.
        """
        with naming(self.source):
            episodes = [
                resample_episode(e, control_dt, quaternions=quaternions, max_gap=max_gap) for e in self.episodes
            ]
        return replace(self, episodes=episodes, metadata=replace(self.metadata, control_dt=float(control_dt)))

    def content_hash(self) -> str:
        """SHA-256 (hex) of names, robots, column names and every number, whatever file they came from.

        Metadata, extra columns and the file's name do not enter.
        """
        columns = {group: getattr(self.column_names, group) for group in GROUPS}
        digest = hashlib.sha256(json.dumps(["nfpde dataset 1", columns]).encode())
        for e in self.episodes:
            digest.update(json.dumps([e.name, e.robot, len(e), e.nq, e.nv, e.nu]).encode())
            for array in (e.time, e.qpos, e.qvel, e.ctrl):
                digest.update(array.astype("<f8", copy=False).tobytes())
        return digest.hexdigest()

    def _check_episodes(self) -> None:
        if not self.episodes:
            raise BadDataset("there are no episodes; a data set holds at least one.")
        twice = repeated(self.names)
        if twice:
            raise BadDataset(f"more than one episode is named {', '.join(twice)}; names must be unique.")
        first = self.episodes[0]
        for e in self.episodes:
            if (e.nq, e.nv, e.nu) != (first.nq, first.nv, first.nu):
                raise BadDataset(
                    f"episode {e.name!r} has nq={e.nq}, nv={e.nv}, nu={e.nu} and episode {first.name!r} has "
                    f"nq={first.nq}, nv={first.nv}, nu={first.nu}; all episodes of a data set have the same columns."
                )
        for group, n in (("qpos", first.nq), ("qvel", first.nv), ("ctrl", first.nu)):
            names = getattr(self.column_names, group)
            if names is not None and len(names) != n:
                raise BadDataset(f"{group} has {n} column(s) and {len(names)} name(s): {', '.join(names)}.")

    def _common_step(self) -> float:
        steps = [control_step(e) for e in self.episodes]
        median = float(np.median(steps))
        for e, step in zip(self.episodes, steps, strict=True):
            if not same_step(step, median):
                raise BadDataset(
                    f"episode {e.name!r} has a control step of {step:.6g} s where the median episode has "
                    f"{median:.6g} s; all must agree within 0.1 %. Resample: load_dataset(..., "
                    f"resample={round_step(median)}), or resample_episode on each episode."
                )
        rows = sum(len(e) - 1 for e in self.episodes)
        control_dt = float(f"{sum(e.duration for e in self.episodes) / rows:.12g}")
        stated = self.metadata.control_dt
        if stated is not None and not same_step(stated, control_dt):
            raise BadDataset(
                f"the metadata says control_dt={stated:.6g} s and the time column steps by {control_dt:.6g} s; "
                "correct one of them (time is in seconds)."
            )
        return control_dt
