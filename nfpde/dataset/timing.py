"""When an episode's rows count as evenly spaced, and what is said when they do not."""

import numpy as np

from nfpde.dataset.episode import Episode
from nfpde.errors import BadDataset

STEP_TOLERANCE = 0.01
"""Largest deviation of one step from the episode's mean step, relative. Loggers jitter; a simulation does not."""

CONTROL_DT_TOLERANCE = 1e-3
"""Largest relative difference between two control steps that count as one (two episodes, data and model)."""

GAP = 1.5
"""A step longer than this many median steps means that rows are missing."""


def gap_rows(episode: Episode, max_gap: float | None = None) -> np.ndarray:
    """Rows before which time is missing.

    Args:
        episode: The recording.
        max_gap: Longest step that is no gap [s]; None means `GAP` median steps.

    Returns:
        Indices r with `time[r] - time[r-1] > max_gap`, increasing. Shape (n,).
    """
    steps = np.diff(episode.time)
    return np.flatnonzero(steps > (GAP * np.median(steps) if max_gap is None else max_gap)) + 1


def control_step(episode: Episode) -> float:
    """Mean control step of an evenly recorded episode.

    Args:
        episode: The recording.

    Returns:
        The mean step [s].

    Raises:
        BadDataset: Rows are missing (a step longer than `GAP` median steps), or a step differs from the
            mean by more than `STEP_TOLERANCE`.
    """
    steps = np.diff(episode.time)
    mean, median = episode.duration / len(steps), float(np.median(steps))
    gaps = gap_rows(episode)
    if len(gaps):
        row, step = int(gaps[0]), float(steps[gaps[0] - 1])
        lost = max(round(step / median) - 1, 1)
        raise BadDataset(
            f"episode {episode.name!r}, row {row}: {step:.6g} s passed since the row before, where the median step "
            f"is {median:.6g} s: about {lost} row(s) are missing there ({len(gaps)} such gap(s) in the episode). "
            "Split the episode there (load_dataset(..., split_gaps=True), split_episode_at_gaps), or bridge short "
            f"gaps by resampling (load_dataset(..., resample={round_step(median)}), resample_episode)."
        )
    worst = int(np.argmax(np.abs(steps - mean)))
    spread = abs(float(steps[worst]) - mean) / mean
    if spread > STEP_TOLERANCE:
        raise BadDataset(
            f"episode {episode.name!r}: the steps in time are uneven, from {steps.min():.6g} to {steps.max():.6g} s "
            f"around {mean:.6g} s (worst before row {worst + 1}: {100 * spread:.3g} % off, at most "
            f"{100 * STEP_TOLERANCE:g} % is allowed). Resample it: load_dataset(..., resample={round_step(median)}), "
            "or resample_episode on each Episode before the Dataset is made (an evenly spaced one has "
            "Dataset.resample)."
        )
    return mean


def same_step(a: float, b: float) -> bool:
    """Whether two control steps [s] count as one."""
    return abs(a - b) <= CONTROL_DT_TOLERANCE * max(a, b)


def round_step(step: float) -> str:
    """A step to resample to, written with two digits where that changes it by less than 1 %, else three."""
    short = f"{step:.2g}"
    return short if abs(float(short) - step) < 0.01 * step else f"{step:.3g}"
