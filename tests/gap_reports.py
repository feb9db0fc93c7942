"""Made-up but realistic answers of a diagnosis, of all three verdicts, for tests of what is drawn and written."""

from pathlib import Path

import gymnasium
import mujoco
import numpy as np

from nfpde.elements import element_names
from nfpde.gap import Cause, Distance, Fitted, GapMap, GapReport, Level, Place, ResidualForce, Rival, Trace

TWO_LINKS = """
<mujoco>
  <worldbody>
    <geom type="plane" size="3 3 1"/>
    <body name="upper" pos="0 0 1.3">
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.5 0 -0.3" size="0.045"/>
      <body name="lower" pos="0.5 0 -0.3">
        <joint name="{elbow}" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.45 0 0.1" size="0.035"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

SIX_AXES = """
<mujoco>
  <worldbody>
    <geom type="plane" size="3 3 1"/>
    <body name="base"><geom type="cylinder" size="0.12 0.08" pos="0 0 0.08"/>
    <body name="link1" pos="0 0 0.16"><joint name="axis1" axis="0 0 1"/>
      <geom type="cylinder" size="0.08 0.11" pos="0 0 0.11"/>
    <body name="link2" pos="0 0 0.24"><joint name="axis2" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0.07 0 0.16 0.07 0.4" size="0.05"/>
    <body name="link3" pos="0.16 0 0.4"><joint name="axis3" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.22 0 0.03" size="0.045"/>
    <body name="link4" pos="0.22 0 0.03"><joint name="axis4" axis="1 0 0"/>
      <geom type="capsule" fromto="0 0 0 0.16 0 0" size="0.038"/>
    <body name="link5" pos="0.16 0 0"><joint name="axis5" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.09 0 -0.06" size="0.033"/>
    <body name="link6" pos="0.09 0 -0.06"><joint name="axis6" axis="0.8 0 -0.6"/>
      <geom type="box" size="0.04 0.03 0.01" pos="0.02 0 -0.02"/>
    </body></body></body></body></body></body></body>
  </worldbody>
</mujoco>
"""

NASTY = "<b>\"el&bow'</b>"
"""A joint's name full of markup."""


def gym_model(name):
    """A model that comes with gymnasium."""
    return mujoco.MjModel.from_xml_path(str(Path(gymnasium.__file__).parent / "envs/mujoco/assets" / f"{name}.xml"))


def arm(elbow="elbow"):
    """A planar arm of two links."""
    escaped = elbow.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    return mujoco.MjModel.from_xml_string(TWO_LINKS.format(elbow=escaped))


def cause(effect, target, shrink, quantity="torque", value=0.5462, unit="Nm", **more):
    """A cause with one fitted value."""
    fitted = Fitted(value, 0.97 * value, 1.03 * value, unit, at_bound=more.pop("at_bound", False))
    return Cause(
        effect,
        target,
        f"What {effect} means to a roboticist, in one sentence that takes a line or so to read.",
        {quantity: fitted},
        shrink,
        shrink - 0.014,
        min(shrink + 0.012, 1.0),
        40.0 * shrink,
        2.0,
        **more,
    )


def gap_report(model, verdict, *, seed=3):
    """An answer for a model: the last joints carry most of the gap."""
    rng = np.random.default_rng(seed)
    joints = element_names(model, "joint")
    worst = joints[-1]
    share = rng.dirichlet(np.full(4 * len(joints), 0.3)).reshape(len(joints), 4) * 0.3
    share[-1] += 0.7 * np.array([0.05, 0.7, 0.15, 0.1])
    share /= share.sum()
    regimes = ("rest", "reversal", "slow", "fast")
    where = [Place(j, float(s.sum()), regimes[int(s.argmax())]) for j, s in zip(joints, share, strict=True)]
    where.sort(key=lambda p: -p.share)
    friction = cause(
        "coulomb_friction",
        worst,
        0.913,
        indistinguishable=[Rival("stribeck_friction", worst), Rival("load_friction", worst)],
        separating_experiment=f"Move {worst} slowly, at 0.02 to 0.1 rad/s, and compare with fast moves <1 min>.",
    )
    delay = cause("actuation_delay", "", 0.62, "delay", 0.016, "s", at_bound=True)
    effects = [friction, delay] if verdict == "effects" else []
    left = {"effects": 0.021, "no_gap": 0.0107, "unexplained": 0.64}[verdict]
    fitted = 0.0107 if verdict == "no_gap" else 0.83
    ladder = [("nominal model", 1.0), ("+ parameters", fitted)]
    ladder += [(f"+ coulomb_friction at {worst}", 0.11), ("+ actuation_delay", left)] if effects else []
    ladder += [("noise floor", 0.0102)]
    horizons = {
        h: Level(1.0, fitted, left * (1 + 3 / h) if effects else fitted, 0.0102 * (1 + 8 / h))
        for h in (1, 2, 5, 10, 20)
    }
    summary = {
        "effects": ["The gap is explained: 2.10% of it is left; sensor noise alone gives 1.02%."],
        "no_gap": ["The model predicts the recordings as well as their noise allows: there is no gap to explain."],
        "unexplained": ["The gap is not explained by any known effect: 64.0% of it is left."],
    }[verdict]
    ranking = [friction, cause("stribeck_friction", worst, 0.911), cause("load_friction", worst, 0.907), delay]
    ranking += [cause("viscous_damping", j, 0.04 / (i + 1), "damping", 0.031, "Nms/rad") for i, j in enumerate(joints)]
    return GapReport(
        verdict=verdict,
        effects=effects,
        ranking=ranking if verdict != "no_gap" else ranking[3:],
        where=where,
        gap=Level(1.0, fitted, left, 0.0102),
        horizons=horizons,
        distance=Distance(0.4321, 0.3456, 0.0567, 0.0123, 160),
        base={
            f"body_mass[{worst}]": Fitted(1.234, 1.2, 1.27, "kg"),
            "dof_damping[*]": Fitted(0.5, 0.41, 0.5, "Nms/rad", at_bound=True),
        },
        ladder=ladder,
        summary=[*summary, f"{where[0].share:.0%} of the gap lies at {where[0].joint}."],
        gap_map=_map(joints, regimes, share),
        traces=[_trace(rng, i, worst) for i in range(6)],
        residual_force=_force(rng, worst) if verdict == "unexplained" else None,
        held_out_episodes=["1", "4", "walk & turn"],
        sensor_noise={f"{kind} {j}": 1e-3 * (1 + i) for kind in ("qpos", "qvel") for i, j in enumerate(joints)},
        encoder_error={},
        control_dt=0.02,
        seconds=12.34,
        simulated_steps=12_345_678,
        candidates=61,
        seed=17,
        device="cpu: MuJoCo, double precision, 2 thread(s)",
        model=model,
    )


def _map(joints, motion, share):
    """Beside motion, half of the gap lies in contact, a third early."""
    whole = share.sum(1, keepdims=True)
    split = np.hstack([share, 0.5 * whole, 0.3 * whole, 0.2 * whole, whole / 3, 2 * whole / 3])
    regimes = (*motion, "in contact", "contact changes", "in flight", "early", "late")
    windows = np.tile([31, 57, 80, 212, 190, 100, 90, 190, 190], (len(joints), 1))
    return GapMap(joints, regimes, split, windows, {"motion": 4, "contact": 3, "time": 2})


def _trace(rng, i, joint):
    time = 0.02 * (np.arange(21) + 40 * i)
    measured = 0.4 * np.sin(3 * time + i)
    after = measured + 0.004 * rng.normal(size=21)
    before = measured + 0.5 * (time - time[0]) ** 2 + 0.01 * rng.normal(size=21)
    return Trace(f"{i} <fast>", f"qpos {joint}", "rad, from the window's start", time, measured, before, after)


def _force(rng, joint):
    position = rng.uniform(-1.5, 1.5, 150)
    force = 0.4 * np.sin(6 * position) + 0.08 * rng.normal(size=150)
    errors = rng.uniform(0.05, 0.12, 150)
    return ResidualForce(joint, "Nm", 0.77, position, rng.normal(size=150), rng.normal(size=150), force, errors)
