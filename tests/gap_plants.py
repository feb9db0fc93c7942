"""Small machines with analytic motion, and runs of them with a fault, for the tests of the hidden faults."""

import numpy as np

from nfpde.bench.gap.plant import Plant

DT = 0.001
CONTROL = 0.01
MASS = 2.0
GEAR = 3.0

SLIDER = f"""
<mujoco>
  <option timestep="{DT}" integrator="implicitfast"/>
  <worldbody><body name="cart">
    <joint name="rail" type="slide" axis="1 0 0"/>
    <geom type="box" size=".1 .1 .1" mass="{MASS}"/>
  </body></worldbody>
  <actuator><motor name="motor" joint="rail" gear="{GEAR}" ctrlrange="-100 100"/></actuator>
</mujoco>"""

SERVO = f"""
<mujoco>
  <option timestep="{DT}" integrator="implicitfast"/>
  <worldbody><body name="arm">
    <joint name="elbow" axis="0 1 0" damping=".2" armature=".02"/>
    <geom name="bob" type="sphere" pos=".3 0 0" size=".02" mass=".5"/>
  </body></worldbody>
  <actuator><position name="servo" joint="elbow" kp="40" kv="3" ctrlrange="-3 3"/></actuator>
</mujoco>"""

HINGE = SERVO.replace(
    '<position name="servo" joint="elbow" kp="40" kv="3" ctrlrange="-3 3"/>', '<motor name="motor" joint="elbow"/>'
)
FLOOR = f"""
<mujoco>
  <option timestep="{DT}" cone="elliptic" impratio="10"/>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 .1" friction=".5" solref=".01 1"/>
    <body name="block" pos="0 0 .1">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
      <geom name="box" type="box" size=".1 .1 .1" mass="1" friction=".5" solref=".01 1"/>
    </body>
  </worldbody>
</mujoco>"""


def moved(xml, fault, ctrl, steps, qpos=0.0, qvel=0.0):
    """Position and velocity of the first coordinate at each control step, the start included."""
    plant = Plant(xml, CONTROL, faults=[fault] if fault else [])
    nu = plant.model.nu
    ctrl = np.zeros((steps, nu)) if ctrl is None else np.broadcast_to(np.reshape(ctrl, (-1, nu)), (steps, nu))
    start, speed = np.zeros(plant.model.nq), np.zeros(plant.model.nv)
    start[0], speed[0] = qpos, qvel
    plant.begin(start, speed, ctrl[0])
    seen = [[x[0] for x in plant.reading()]]
    for u in ctrl:
        plant.advance(u)
        seen.append([x[0] for x in plant.reading()])
    return np.array(seen)
