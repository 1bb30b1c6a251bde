"""EMPS: a driven screw axis, what is published of it, and its records."""

import jaxfrf as jf

# A driven screw axis as a joint that turns about the vertical, so that gravity does nothing: N and m in the place of
# N m and rad. Inertia and viscous friction are guesses, 15 and 50 % off; nothing else is known.
EMPS = """
name = "EMPS"
gravity = [0.0, 0.0, -9.81]
sampling_frequency = 1000.0
[[joint]]
name = "axis"
type = "driven"
axis = [0.0, 0.0, 1.0]
offset = [0.0, 0.0, 0.0]
mass = 0.0
com = [0.0, 0.0, 0.0]
inertia = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
gear_ratio = 1.0
motor_inertia = 80.0
stiffness = inf
damping = 0.0
viscous_friction = 300.0
[friction]
smoothing = 1e-4
"""

# Janot, Gautier & Brunot 2019: force = M dv/dt + Fv v + Fc sign(v) + offset; the other variant, by direction.
NEWTON_PER_VOLT, MASS, VISCOUS, COULOMB, OFFSET = 35.15, 95.11, 203.5, 20.39, -3.16

FORWARD, BACKWARD = 166.7, 240.4


def emps_record(measured, name):
    """`vir` holds the pulses already (see the data's notes): nothing is added to it."""
    return jf.io.read(
        measured / "emps" / f"{name}.mat",
        names={"u": "vir", "y": "qm"},
        values={"y_quantity": "position"},
        factor={"u": NEWTON_PER_VOLT},
    )
