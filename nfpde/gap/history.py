"""What candidates need to know from before a window."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nfpde.effects import Effect
from nfpde.gap.recordings import LEAD, WINDOW_TIME
from nfpde.sim import Simulator


def rows_before(effects: Sequence[Effect], control_dt: float, known: Simulator, touches: bool) -> tuple[int, int, int]:
    """Commands and states from before a window that are needed, and commands that any one candidate may need.

    Any three candidates and the free effects may act by what was commanded before. States are needed as far back as any
    of them recalls, from where a window begins or, where contacts are, a longest window's time earlier (see `natural`).

    Args:
        effects: The candidates.
        control_dt: Control step [s].
        known: The nominal model's simulator, which has the free effects.
        touches: Whether anything may touch anything.
    """
    recall = _steps(max((e.recall_time() for e in effects), default=0.0), control_dt)
    recall = max(recall, known.past_steps(control_dt))
    times = sorted((e.memory_time() for e in effects), reverse=True)[:3]
    longest = known.memory_time + max(times, default=0.0)
    earlier = round(WINDOW_TIME / control_dt)
    if longest <= 0:
        rows = recall + (earlier if touches else 0)
        return rows, rows, 0
    history = _steps(known.memory_time + sum(times), control_dt) + 2 + recall
    lead = _steps(min(longest, max(LEAD, 25 * control_dt)), control_dt)
    return history, min(history, recall + earlier), lead


def _steps(seconds: float, control_dt: float) -> int:
    return int(np.ceil(seconds / control_dt - 1e-9))
