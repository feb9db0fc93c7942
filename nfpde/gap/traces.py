"""Single windows in detail: what was measured, and what is predicted without and with effects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nfpde.dataset import Windows
from nfpde.gap.fit import Fit
from nfpde.gap.report import Trace
from nfpde.gap.written import channel_unit

TRACES = 6


def traces(chosen: Windows, before: Fit, after: Fit, names: Sequence[str]) -> list[Trace]:
    """Windows, each in the channel that is predicted worst without effects.

    Args:
        chosen: The windows.
        before: The parameters fitted, without effects.
        after: With effects.
        names: Of the data set's episodes.
    """
    states, out = before.replay.sim.states, list[Trace]()
    predicted = [fit.replay.predict(fit.xi[None], chosen)[0] for fit in (before, after)]
    scale = np.sqrt(np.nanmean(states.difference(chosen.target, chosen.state[:, :1]) ** 2, axis=(0, 1))) + 1e-12
    for i in range(len(chosen)):
        error = np.abs(np.nan_to_num(states.difference(predicted[0][i], chosen.target[i]))).max(0) / scale
        channel = int(error.argmax())
        reference = chosen.state[i, 0]
        moved = [
            states.difference(x, np.broadcast_to(reference, x.shape))[:, channel]
            for x in (chosen.target[i], predicted[0][i], predicted[1][i])
        ]
        measured, simulated, repaired = (np.concatenate([[0.0], m]) for m in moved)
        time = (chosen.row[i] + np.arange(chosen.horizon + 1)) * chosen.control_dt
        label = states.channels[channel]
        episode = names[int(chosen.episode[i])]
        text = f"{channel_unit(before.replay.sim.model, label)}, from the window's start"
        out.append(Trace(episode, label, text, time, measured, simulated, repaired))
    return out
