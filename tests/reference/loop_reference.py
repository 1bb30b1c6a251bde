"""The sampled controller in plain NumPy, and the closed loop of a robot in MuJoCo: references without jaxfrf."""

import mujoco
import numpy as np
from mujoco_reference import MuJoCoRobot


class NumPyController:
    """The cascade as the robot's file states it, for one run."""

    def __init__(self, robot, rest, torque):
        c = robot.controller
        self.kp, self.ti, self.kv = (np.asarray(x) for x in (c.position_gain, c.integral_time, c.velocity_gain))
        self.corner, self.anti_windup, self.speed = c.speed_filter, c.anti_windup, 0.0
        self.speed_sensor = c.speed_sensor
        self.feedforward, self.limit = c.feedforward, np.asarray(robot.drives.torque_limit)
        self.fs, self.last = robot.sampling_frequency, np.array(rest)
        self.integral = np.zeros_like(rest) if np.any(np.isinf(self.ti)) else np.asarray(torque) / self.kv * self.ti

    def __call__(self, reading, position, velocity, sensed=None):
        speed = sensed if self.speed_sensor else (reading - self.last) * self.fs
        if self.corner is not None:
            part = 1.0 - np.exp(-2 * np.pi * np.asarray(self.corner) / self.fs)
            speed = self.speed + part * (speed - self.speed)
        self.last, self.speed = reading, speed
        error = self.kp * (position - reading) + self.feedforward * velocity - speed
        before, self.integral = self.integral, self.integral + error / self.fs
        torque = self.kv * (error + self.integral / self.ti)
        if self.anti_windup:
            for i in np.flatnonzero(np.abs(torque) > self.limit):
                if np.sign(error[i]) == np.sign(torque[i]):
                    self.integral[i] = before[i]
        return np.clip(torque, -self.limit, self.limit)


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
