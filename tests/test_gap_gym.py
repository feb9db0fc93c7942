"""A robot of Gymnasium that falls: two seconds of recordings, among contacts and with ten free parameters or so."""

import pytest

from nfpde.benchmarks import collect, hide, robot
from nfpde.gap import diagnose_gap


@pytest.mark.parametrize("torque", [0.0, 4.0])
def test_friction_of_a_hopper_that_falls_is_found(torque):
    """Beside unknown masses, dampings and friction of the floor, by sensors that err by a percent of what moves."""
    hopper = robot("hopper")
    effects = [hide(hopper.model, "coulomb_friction", "leg_joint", torque=torque)] if torque else []
    data, _ = collect(hopper, "gaussian", episodes=10, robots=1, seed=4, noise=0.01, effects=effects)
    found = diagnose_gap(hopper.path, data, hopper.space, device="cpu")
    if not torque:
        assert found.verdict == "no_gap", found.summary
        return
    assert found.verdict == "effects", found.summary
    (cause,) = found.effects
    others = {(r.effect, r.target) for r in cause.indistinguishable}
    assert ("coulomb_friction", "leg_joint") in others | {(cause.effect, cause.target)}, found.summary
    if cause.effect == "coulomb_friction":
        value = cause.parameters["torque"]
        assert value.low < torque < value.high
