"""The sampled controller in plain NumPy, and the closed loop of a robot in MuJoCo: references without jaxfrf."""

import mujoco
import numpy as np
from mujoco_reference import MuJoCoRobot


class NumPyController:
    """The cascade as the robot's file states it, for one run."""

    def __init__(self, robot, rest, torque):
        c = robot.controller
        self.kp, self.ti, self.kv = float(c.position_gain), float(c.integral_time), np.asarray(c.velocity_gain)
        self.feedforward, self.limit = c.feedforward, np.asarray(robot.drives.torque_limit)
        self.fs, self.last = robot.sampling_frequency, np.array(rest)
        self.integral = np.zeros_like(rest) if np.isinf(self.ti) else np.asarray(torque) / self.kv * self.ti

    def __call__(self, reading, position, velocity):
        error = self.kp * (position - reading) + self.feedforward * velocity - (reading - self.last) * self.fs
        self.last = reading
        self.integral = self.integral + error / self.fs
        return np.clip(self.kv * (error + self.integral / self.ti), -self.limit, self.limit)


def mujoco_loop(robot, point, velocity, position, steps=5, integrator=mujoco.mjtIntegrator.mjINT_RK4):
    """Motor positions and torques, (time, axis), of one run from the equilibrium `point` (no batch axis)."""
    twin = MuJoCoRobot(robot)
    model, data = twin.model, twin.data
    model.opt.timestep, model.opt.integrator = 1.0 / (robot.sampling_frequency * steps), integrator
    model.actuator_ctrllimited[:] = 0  # the controller limits
    data.qpos[twin.order] = point.z
    flexible = list(robot.flexible_axes)
    gear = np.asarray(robot.drives.gear_ratio)

    def motors():
        z = data.qpos[twin.order]
        angle = gear * z[len(flexible) : len(flexible) + robot.n_axes]
        angle[flexible] = z[: len(flexible)]
        return angle

    rest = motors()
    controller = NumPyController(robot, rest, point.torque)
    angles, torques = [], []
    for v, p in zip(velocity, position, strict=True):
        angles.append(motors())
        torques.append(controller(angles[-1], rest + p, v))
        data.ctrl[:] = torques[-1]
        for _ in range(steps):
            mujoco.mj_step(model, data)
    return np.array(angles), np.array(torques)
