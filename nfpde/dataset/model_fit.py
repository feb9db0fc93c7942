"""Whether a data set fits a model, given as plain numbers and names."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from nfpde.dataset.columns import GROUPS, ColumnNames
from nfpde.dataset.dataset import Dataset
from nfpde.dataset.naming import naming
from nfpde.dataset.timing import same_step
from nfpde.errors import BadDataset

QUATERNION_EXACT = 1e-6
"""A quaternion whose length differs from 1 by less is taken as recorded."""

QUATERNION_ROUNDED = 1e-3
"""One that differs by less than this was rounded by the logger and is scaled to length 1; beyond, it is refused."""


def check_against_model(
    dataset: Dataset,
    *,
    nq: int,
    nv: int,
    nu: int,
    timestep: float,
    quaternions: Sequence[int] = (),
    names: Mapping[str, Sequence[str]] | None = None,
) -> Dataset:
    """Check that a data set fits a model, and put its columns in the model's order.

    A clock that is off by up to 0.1 % is let pass: one control step is simulated as the nearest whole number of
    timesteps, and the effect `time_scale` says by how much longer it lasts.

    Args:
        dataset: The recordings.
        nq: The model's number of positions.
        nv: The model's number of velocities.
        nu: The model's number of actuators.
        timestep: The model's physics step [s].
        quaternions: First qpos column of each unit quaternion, in the model's order.
        names: The model's column names for "qpos", "qvel" and "ctrl" (see `expand_names`); needed where the data set
            has names.

    Returns:
        The data set itself where nothing had to change; else one with columns reordered by name, and with quaternions
        whose length is off by between 1e-6 and 1e-3 scaled to length 1.

    Raises:
        BadDataset: The columns are not the model's, the control step is no multiple of the timestep (within 0.1 %), or
            a quaternion is far from unit length.
    """
    with naming(dataset.source):
        _check_sizes(dataset, {"qpos": nq, "qvel": nv, "ctrl": nu}, names or {})
        dataset = in_order_of_names(dataset, names or {})
        _check_step(dataset.control_dt, timestep)
        return _with_unit_quaternions(dataset, quaternions)


def _check_sizes(dataset: Dataset, model: Mapping[str, int], names: Mapping[str, Sequence[str]]) -> None:
    data = {"qpos": dataset.nq, "qvel": dataset.nv, "ctrl": dataset.nu}
    wrong = [group for group in GROUPS if data[group] != model[group]]
    if wrong:
        group = wrong[0]
        own, theirs = (
            f" ({', '.join(n)})" if n else "" for n in (getattr(dataset.column_names, group), names.get(group))
        )
        raise BadDataset(
            f"the data has {data[group]} {group} column(s){own} and the model has {model[group]}{theirs}; "
            f"data: nq={data['qpos']}, nv={data['qvel']}, nu={data['ctrl']}, model: "
            f"nq={model['qpos']}, nv={model['qvel']}, nu={model['ctrl']}. Load the model that was recorded, or add the "
            "missing columns."
        )


def in_order_of_names(dataset: Dataset, names: Mapping[str, Sequence[str]]) -> Dataset:
    """The data set with the columns that it names in the order of the simulator's names; numbered ones stay.

    Args:
        dataset: The recordings.
        names: The simulator's column names for "qpos", "qvel" and "ctrl".

    Raises:
        BadDataset: Names that the simulator does not have.
    """
    order: dict[str, list[int]] = {}
    for group in GROUPS:
        own = getattr(dataset.column_names, group)
        if own is None:
            continue
        theirs = list(names.get(group, ()))
        unknown, unfilled = [n for n in own if n not in theirs], [n for n in theirs if n not in own]
        if unknown or unfilled:
            raise BadDataset(
                f"the data names {group} column(s) {', '.join(unknown) or '(none)'} that the model does not have, and "
                f"lacks {', '.join(unfilled) or '(none)'}; the model has {', '.join(theirs) or 'no names'}. Rename the "
                f"columns, or number them {group}_0, {group}_1, ... in the model's order."
            )
        order[group] = [own.index(name) for name in theirs]
    if all(indices == sorted(indices) for indices in order.values()):
        return dataset
    episodes = [replace(e, **{g: getattr(e, g)[:, indices] for g, indices in order.items()}) for e in dataset.episodes]
    return replace(dataset, episodes=episodes, column_names=ColumnNames(**{g: tuple(names[g]) for g in order}))


def _check_step(control_dt: float, timestep: float) -> None:
    ratio = control_dt / timestep
    if same_step(round(ratio) * timestep, control_dt):
        return
    multiples = [n * timestep for n in (int(ratio), int(ratio) + 1) if n > 0]
    raise BadDataset(
        f"the control step of the data, {control_dt:.6g} s, is no multiple of the model's timestep, {timestep:.6g} s; "
        f"the nearest multiple(s): {' and '.join(f'{m:.6g} s' for m in multiples)}. Resample the data to one of them "
        f"(Dataset.resample, load_dataset(..., resample={multiples[-1]:.6g})), or set the model's timestep to "
        f"{control_dt / max(int(ratio), 1):.6g} s."
    )


def _with_unit_quaternions(dataset: Dataset, quaternions: Sequence[int]) -> Dataset:
    episodes = []
    for e in dataset.episodes:
        qpos = e.qpos
        for first in quaternions:
            norms = np.linalg.norm(e.qpos[:, first : first + 4], axis=1)
            far = np.abs(norms - 1)
            if far.max() > QUATERNION_ROUNDED:
                row = int(np.argmax(far > QUATERNION_ROUNDED))
                raise BadDataset(
                    f"episode {e.name!r}, row {row}, columns qpos_{first} to qpos_{first + 3}: the quaternion has "
                    f"length {norms[row]:.6g}; it must be 1 within {QUATERNION_ROUNDED:g}. Look whether the columns "
                    "are in the model's order (w, x, y, z after a free joint's position), or normalise the recording."
                )
            if far.max() > QUATERNION_EXACT:
                qpos = qpos.copy() if qpos is e.qpos else qpos
                qpos[:, first : first + 4] /= np.where(far > QUATERNION_EXACT, norms, 1.0)[:, None]
        episodes.append(e if qpos is e.qpos else replace(e, qpos=qpos))
    return dataset if episodes == list(dataset.episodes) else replace(dataset, episodes=episodes)
