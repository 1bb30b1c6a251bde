"""A small robot for tests: two parallel axes that carry each other, with everything that a loop needs."""

ROBOT = """
name = "two axes"
gravity = [0.0, 0.0, -9.81]
sampling_frequency = 500.0

[[joint]]
name = "shoulder"
type = "driven"
axis = [0.0, 1.0, 0.0]
offset = [0.0, 0.0, 0.3]
mass = 8.0
com = [0.25, 0.0, 0.0]
inertia = [0.02, 0.2, 0.2, 0.0, 0.0, 0.0]
gear_ratio = 100.0
motor_inertia = 2.0e-4
stiffness = 2.0e4
damping = 25.0
viscous_friction = 2.0e-3
coulomb_friction = 0.05
torque_limit = 50.0
velocity_gain = 0.02

[[joint]]
name = "elbow"
type = "driven"
axis = [0.0, 1.0, 0.0]
offset = [0.5, 0.0, 0.0]
mass = 4.0
com = [0.2, 0.0, 0.0]
inertia = [0.01, 0.1, 0.1, 0.0, 0.0, 0.0]
gear_ratio = 80.0
motor_inertia = 1.0e-4
stiffness = 8.0e3
damping = 8.0
viscous_friction = 1.0e-3
coulomb_friction = 0.03
torque_limit = 50.0
velocity_gain = 0.01

[controller]
position_gain = 8.0
integral_time = 0.2
"""
