"""What encoders err by at rest.

An encoder errs by up to half its step: at random while a joint moves, by the same in every row while it rests at one
place. On a floor that is no small matter: a reading that is too high by a tenth of a millimetre looks exactly like a
floor that lies so much higher, in every row and beyond all noise that differs from row to row.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.dataset import Dataset
from nfpde.effects.joint_offset import JointOffset
from nfpde.gap.brief import brief
from nfpde.gap.recall import Recall
from nfpde.gap.recordings import Recordings
from nfpde.gap.replay import Replay
from nfpde.gap.stage import first_fit
from nfpde.parameters import ParameterSpace

Array = NDArray[np.float64]


_LOOKS, _SWEEPS = 16, 2
"""Offsets of each encoder that are looked at, and how often: a floor that is not reached has no slope to follow."""


_SOUND = 0.5
"""Share of the windows that the nominal model must at least get through, to say anything of offsets."""


class ReadingOffset(JointOffset):
    """A reading that is off, of which servos know nothing; no effect of the library."""

    name = "reading_offset"
    sentence: ClassVar[str] = "The recorded position is the true one plus a constant."

    def write_model(self, model: mujoco.MjModel, values: Array) -> None:
        """Leave the servos alone: less than a step of their encoder makes no difference to them."""


def resting_error(
    model: mujoco.MjModel,
    space: ParameterSpace | None,
    recordings: Recordings,
    guesses: Array,
    nthread: int = 0,
    *,
    capped: bool,
    recall: Recall | None = None,
) -> Array:
    """By how much joints that rest at one reading read too high, at most half a step of their encoders (nv,).

    The offsets that fit best beside the free parameters, over short windows; none where the nominal model diverges
    from most recorded states, which `check_fit` refuses.

    Args:
        model: The nominal model.
        space: Parameters that are free.
        recordings: The windows; short ones are cut from them.
        guesses: Free parameters to start from, the nominal ones first (G, D).
        nthread: Threads; 0 takes all cores this process may use.
        capped: See `first_fit`.
        recall: Keeps predictions.
    """
    encoders = recordings.encoders
    grain = np.where(encoders.resting(model), encoders.grain(model)[: model.nv], 0.0)
    dofs = np.flatnonzero(grain)
    error = np.zeros(model.nv)
    if not len(dofs):
        return error
    nominal = Replay(model, space, [], nthread, recall=recall).predict(guesses[:1], recordings.fit)[0]
    if np.isfinite(nominal).all((1, 2)).mean() < _SOUND:
        return error
    halves = 0.5 * grain[dofs]
    effects = [ReadingOffset(int(model.dof_jntid[d]), offset=(-h, h)) for d, h in zip(dofs, halves, strict=True)]
    replay = Replay(model, space, effects, nthread, recall=recall)
    starts = np.hstack([guesses, np.zeros((len(guesses), len(dofs)))])
    base, court = first_fit(replay, (brief(recordings) or [recordings])[0], starts, capped=capped)
    fit = base.fit
    for _ in range(_SWEEPS):
        for column, half in enumerate(halves, replay.nbase):
            guesses = np.repeat(fit.xi[None], _LOOKS + 1, axis=0)
            guesses[1:, column] = np.linspace(-half, half, _LOOKS)
            fit = court.fitter.start(replay, guesses, fit.scatter)
        fit = court.settle(fit)
    error[dofs] = fit.xi[replay.nbase :]
    return error


def without_error(model: mujoco.MjModel, dataset: Dataset, error: Array) -> Dataset:
    """The recordings with the positions of hinges and slides moved by what they read too high (nv,)."""
    dofs = np.flatnonzero(error)
    if not len(dofs):
        return dataset
    shift = np.zeros(model.nq)
    shift[model.jnt_qposadr[model.dof_jntid[dofs]]] = error[dofs]
    return replace(dataset, episodes=[replace(e, qpos=e.qpos - shift) for e in dataset])
