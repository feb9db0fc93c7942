"""The diagnosis on recordings of real robots; skipped where they are not at hand."""

from pathlib import Path

import pytest

from nfpde.bench.real.pendulums import double_pendulum
from nfpde.bench.real.quadruped import quadruped
from nfpde.bench.real.servo import servo
from nfpde.errors import BadDataset
from nfpde.gap import diagnose_gap

REAL = Path(__file__).parents[2] / "shared" / "realdata"


def here(name):
    return pytest.mark.skipif(not (REAL / name).exists(), reason="the recordings are not here")


@pytest.mark.slow
@here("bam_xl330")
def test_a_hobby_servo_rubs_with_its_load():
    """Who published the recordings found friction that grows with the load, beyond Coulomb's: so does the diagnosis.

    Much of the gap is left, and it says so: of the servo's constants only rough values are known.
    """
    model, data = servo(REAL / "bam_xl330", 400)
    found = diagnose_gap(model, data, windows=60)
    assert found.effects
    assert found.effects[0].effect == "load_friction"
    assert found.effects[0].parameters["share"].low > 0.1
    assert found.gap.after_effects < 0.6 * found.gap.before


@pytest.mark.slow
@here("double_pendulum")
def test_a_real_double_pendulum_has_rotors_and_friction():
    """A rigid model without rotors and friction lacks both; found near what was published for the hardware.

    Published: friction of 0.08 to 0.09 Nm in the joints, and a rotor of 7.66e-5 kg m2 behind a gear of 6.
    """
    model, data = double_pendulum(REAL / "double_pendulum", "A.0")
    found = diagnose_gap(model, data.subset(range(0, len(data), 3)), windows=60)
    causes = {(c.effect, c.target): c for c in found.effects}
    rotor = causes["armature", "elbow"].parameters["inertia"].value
    assert 0.5 < rotor / (36 * 7.66e-5) < 3  # link inertias, with which it is confounded, are published to 10 %
    assert any("friction" in effect for effect, _ in causes)
    assert found.gap.after_effects < 0.15 * found.gap.before
    assert found.distance.after_effects < 0.4 * found.distance.before


@here("go2_inair")
def test_a_quadruped_in_the_air_must_not_collide_with_itself():
    """Held in the air its trunk is part of the world, and its hips, which overlap with it, are pushed away."""
    model, data = quadruped(REAL / "go2_inair", contacts=True)
    with pytest.raises(BadDataset, match="FL_hip and base"):
        diagnose_gap(model, data)
