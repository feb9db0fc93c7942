"""Whether recordings fit a model, and their columns in the model's order."""

from __future__ import annotations

import mujoco

from nfpde.dataset import Dataset, expand_names
from nfpde.dataset import check_against_model as check
from nfpde.elements import DOF_WIDTHS, QPOS_WIDTHS, element_names
from nfpde.sim.clock import check_seconds_of_clock
from nfpde.sim.states import StateSpace


def match_dataset(model: mujoco.MjModel, states: StateSpace, dataset: Dataset) -> Dataset:
    """Check sizes, names, control step and quaternions of a data set against a model.

    Returns:
        The data set; with columns put in the model's order where it names them.

    Raises:
        BadDataset: what does not fit, and what the model has; or time that is not in seconds.
    """
    joints = element_names(model, "joint")
    kinds = [int(k) for k in model.jnt_type]
    matched = check(
        dataset,
        nq=model.nq,
        nv=model.nv,
        nu=model.nu,
        timestep=float(model.opt.timestep),
        quaternions=[q for q, _ in states.quaternions],
        names={
            "qpos": expand_names(joints, [QPOS_WIDTHS[k] for k in kinds]),
            "qvel": expand_names(joints, [DOF_WIDTHS[k] for k in kinds]),
            "ctrl": expand_names(element_names(model, "actuator"), [int(k) for k in model.actuator_ctrlnum]),
        },
    )
    check_seconds_of_clock(model, matched)
    return matched
