"""The robots of the tests in MuJoCo, and in plain NumPy: references that share no dynamics with jaxfrf."""

import mujoco
import numpy as np

from jaxfrf.io.mjcf import mjcf


class MuJoCoRobot:
    """The exported MJCF of a robot, evaluated in the coordinates z = [q_m, q_a, q_e] of jaxfrf."""

    def __init__(self, robot):
        self.model = mujoco.MjModel.from_xml_string(mjcf(robot, friction=False))
        self.data = mujoco.MjData(self.model)
        motors = [f"motor:{robot.axis_names[axis]}" for axis in robot.flexible_axes]
        arm = [robot.joint_names[i] for i in robot.arm_joints]
        self.order = np.array([self.model.joint(name).dofadr[0] for name in motors + arm])

    def set_inertia(self, name, tensor):
        """Give a body an inertia that MuJoCo's compiler refuses (published numbers that no body can have)."""
        body = self.model.body(name).id
        moments, axes = np.linalg.eigh(tensor)
        axes = axes * np.sign(np.linalg.det(axes))
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, axes.ravel())
        self.model.body_inertia[body], self.model.body_iquat[body] = moments, quaternion
        self.model.body_sameframe[body] = 0  # the compiler had found the inertia's axes to be the body's

    def _place(self, z, rate=None, acceleration=None):
        for name, value in (("qpos", z), ("qvel", rate), ("qacc", acceleration)):
            getattr(self.data, name)[:] = 0.0
            if value is not None:
                getattr(self.data, name)[self.order] = value

    def mass_matrix(self, z):
        self._place(z)
        mujoco.mj_forward(self.model, self.data)
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        return full[np.ix_(self.order, self.order)]

    def bias(self, z, rate):
        """c + g."""
        self._place(z, rate)
        mujoco.mj_forward(self.model, self.data)
        return self.data.qfrc_bias[self.order].copy()

    def inverse(self, z, rate, acceleration):
        """Forces of a motion beyond springs and dampers: M z'' + c + g - passive."""
        self._place(z, rate, acceleration)
        mujoco.mj_inverse(self.model, self.data)
        return self.data.qfrc_inverse[self.order].copy()

    def matrices(self, z, step=1e-5):
        """M, D, K of small motions about z by central differences of `inverse`."""
        n = len(z)
        rest, eye = np.zeros(n), np.eye(n)
        stiffness = [
            (self.inverse(z + step * e, rest, rest) - self.inverse(z - step * e, rest, rest)) / (2 * step) for e in eye
        ]
        damping = [(self.inverse(z, step * e, rest) - self.inverse(z, -step * e, rest)) / (2 * step) for e in eye]
        return self.mass_matrix(z), np.array(damping).T, np.array(stiffness).T


def second_order_frf(mass, damping, stiffness, motor, frequency):
    """j w B^T (K + j w D - w^2 M)^{-1} B, line by line."""
    out = []
    for w in 2 * np.pi * np.asarray(frequency):
        dynamic = stiffness + 1j * w * damping - w**2 * mass
        out.append(1j * w * motor.T @ np.linalg.solve(dynamic, motor.astype(complex)))
    return np.array(out)


def random_positions(count, seed=0):
    """Arm angles of R3X as its experiments draw them, (count, 6), rad."""
    rng = np.random.default_rng(seed)
    low, high = np.array([-150, -60, 20, -150, 25, -150]), np.array([150, 60, 150, 150, 100, 150])
    q = rng.uniform(low, high, (count, 6))
    q[:, 4] *= rng.choice([-1, 1], count)
    return np.deg2rad(q)


def paper_frequencies():
    """The paper's 336 lines, 4-80 Hz."""
    lines = np.unique(2 * np.floor(np.geomspace(112, 2240, 366) / 2) + 1)[:-1]
    return lines * 2000.0 / 56000.0
