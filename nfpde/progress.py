"""Show how a long job stands: a bar on a terminal, one plain line now and then in a log."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol, TextIO

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class Report(Protocol):
    """What the job calls after each step: the number of steps done and its current figures."""

    def __call__(self, step: int, **figures: float | str) -> None:
        """Say that `step` steps are done."""
        ...


@contextmanager
def progress(
    description: str,
    total: int,
    *,
    start: int = 0,
    quiet: bool = False,
    interval: float = 10.0,
    stream: TextIO | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Report]:
    """Report the steps of a job on the error stream.

    On a terminal: a bar, the time left and the current figures. Elsewhere: one plain line at most every
    `interval` seconds, and nothing for a job that is shorter than that.

        with progress("Fitting", 200) as report:
            for step in range(200):
                report(step + 1, loss=0.25)

    Args:
        description: What is being done.
        total: Number of steps.
        start: Steps done before (a job that goes on); the time left counts from there.
        quiet: Show nothing.
        interval: Least time between plain lines [s].
        stream: Where to write; None is `sys.stderr`.
        clock: Monotonic time [s].
    """
    out = stream or sys.stderr
    if quiet:
        yield _nothing
    elif out.isatty():
        with _bar(out) as bar:
            task = bar.add_task(escape(description), total=total, completed=start, figures="")

            def draw(step: int, **figures: float | str) -> None:
                bar.update(task, completed=step, figures=escape(_text(figures)))

            yield draw
    else:
        yield _lines(description, total, start, interval, out, clock)


def _nothing(step: int, **figures: float | str) -> None:
    pass


def _bar(stream: TextIO) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[figures]}"),
        console=Console(file=stream),
    )


def _lines(
    description: str, total: int, start: int, interval: float, stream: TextIO, clock: Callable[[], float]
) -> Report:
    begun = last = clock()

    def write(step: int, **figures: float | str) -> None:
        nonlocal last
        now = clock()
        if now - last < interval:
            return
        last = now
        done = step - start
        left = f", {_duration((now - begun) * (total - step) / done)} left" if done > 0 else ""
        print(f"{description}: {step}/{total}{left}  {_text(figures)}".rstrip(), file=stream, flush=True)

    return write


def _text(figures: dict[str, float | str]) -> str:
    return "  ".join(f"{k} {v}" if isinstance(v, str | int) else f"{k} {v:.4g}" for k, v in figures.items())


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(max(seconds, 0.0)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
