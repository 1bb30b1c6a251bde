"""Forward dynamics of the flexible robot: energy, MuJoCo, step halving, derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco_reference import MuJoCoRobot, random_positions

import jaxfrf.robot as jr

POSITIONS = random_positions(4)


@eqx.filter_jit
def hundred_steps(robot, state, torque, step):
    """Classical Runge-Kutta with a constant torque; every state, (time, *batch, state)."""

    def advance(x, _):
        f = lambda y: jr.forward_dynamics(robot, y, torque)
        k1 = f(x)
        k2 = f(x + 0.5 * step * k1)
        k3 = f(x + 0.5 * step * k2)
        k4 = f(x + step * k3)
        x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return x, x

    return jax.lax.scan(advance, state, None, length=100)[1]


def simulate(robot, state, torque, step, count):
    states = [state[None]]
    for _ in range(count // 100):
        states.append(hundred_steps(robot, states[-1][-1], torque, jnp.asarray(step, float)))
    return jnp.concatenate(states)


def without(robot, *kinds):
    return jr.with_parameters(robot, {name: 0.0 for name in jr.parameters(robot, kinds)})


def moving_state(robot):
    """At the equilibrium of POSITIONS, with the motors at speed."""
    point = jr.operating_point(robot, POSITIONS)
    speed = np.random.default_rng(0).normal(size=(len(POSITIONS), 6)) * 0.2
    rate = np.concatenate([speed * np.asarray(robot.drives.gear_ratio), speed, np.zeros((len(POSITIONS), 2))], axis=1)
    return jnp.concatenate([point.z, rate], axis=1), point


class TestEnergy:
    @pytest.mark.slow
    def test_kept_without_losses(self):
        """Nonlinear springs, gravity, coupled motion for .1 s: the drift is the integrator's and falls with
        its step."""
        robot = without(jr.r3x(), "damping", "viscous_friction", "coulomb_friction")
        state, _ = moving_state(robot)
        drift = []
        for step, count in ((2e-4, 500), (1e-4, 1000)):
            states = simulate(robot, state, jnp.zeros((4, 6)), step, count)
            energy = np.asarray(jr.energy(robot, states))
            drift.append(np.abs(energy - np.asarray(jr.energy(robot, state))).max())
        kinetic = np.ptp(np.asarray(jr.energy(robot, states * jnp.where(jnp.arange(28) < 14, 1.0, 0.0))))
        assert drift[1] < 1e-6 * kinetic
        assert drift[0] > 8 * drift[1]

    @pytest.mark.slow
    def test_never_gained_with_losses(self):
        robot = jr.r3x()
        state, _ = moving_state(robot)
        energy = np.asarray(jr.energy(robot, simulate(robot, state, jnp.zeros((4, 6)), 1e-4, 2000)))
        assert np.all(np.diff(energy, axis=0) < 0)

    def test_rate_is_the_power_of_torque_and_losses(self):
        robot = jr.r3x()
        state, point = moving_state(robot)
        torque = point.torque + 0.3
        _, rate = jax.jvp(lambda x: jr.energy(robot, x), (state,), (jr.forward_dynamics(robot, state, torque),))
        v = np.asarray(state)[:, 14:]
        friction = 0.2
        lost = np.asarray([8.1e-4, 7.7e-4, 1.5e-3, 2e-4, 2e-4, 8e-5]) * v[:, :6] + np.array(
            [0.4, 0.5, 0.7, 0.06, 0.07, 0.025]
        ) * np.tanh(v[:, :6] / friction)
        slip = np.concatenate([v[:, :6] / np.asarray(robot.drives.gear_ratio) - v[:, 6:12], v[:, 12:]], axis=1)
        damping = np.array([120, 250, 100, 8, 7, 2.5, 200, 100])
        power = np.sum((torque - lost) * v[:, :6], axis=1) - np.sum(damping * slip**2, axis=1)
        np.testing.assert_allclose(rate, power, rtol=1e-9, atol=1e-9 * np.abs(power).max())


class TestMotion:
    @pytest.fixture(scope="class")
    @staticmethod
    def frictionless():
        robot = without(jr.r3x(), "viscous_friction", "coulomb_friction")
        return jr.with_parameters(robot, {name: 1.0 for name in jr.parameters(robot, ["stiffness_ratio"])})

    def test_mujoco_acceleration(self, frictionless):
        state, point = moving_state(frictionless)
        reference = MuJoCoRobot(frictionless)
        torque = np.asarray(point.torque) + 0.2
        ours = np.asarray(jr.forward_dynamics(frictionless, state, torque))[:, 14:]
        for i, x in enumerate(np.asarray(state)):
            reference.data.qpos[reference.order], reference.data.qvel[reference.order] = x[:14], x[14:]
            reference.data.ctrl[:] = torque[i]
            mujoco.mj_forward(reference.model, reference.data)
            theirs = reference.data.qacc[reference.order]
            np.testing.assert_allclose(ours[i], theirs, rtol=1e-7, atol=1e-8 * np.abs(theirs).max())

    @pytest.mark.slow
    def test_mujoco_trajectory(self, frictionless):
        """A second of coupled motion, both by Runge-Kutta at .1 ms: motor speeds to 1e-6."""
        state, point = moving_state(frictionless)
        ours = np.asarray(simulate(frictionless, state, point.torque, 1e-4, 10_000))[-1, 0]
        reference = MuJoCoRobot(frictionless)
        reference.data.qpos[reference.order], reference.data.qvel[reference.order] = np.split(np.asarray(state[0]), 2)
        reference.data.ctrl[:] = np.asarray(point.torque[0])
        for _ in range(10_000):
            mujoco.mj_step(reference.model, reference.data)
        theirs = reference.data.qvel[reference.order][:6]
        np.testing.assert_allclose(ours[14:20], theirs, atol=1e-6 * np.abs(theirs).max())

    def test_step_halving(self):
        """Fourth order on the whole nonlinear robot, while no motor reverses (Coulomb friction is not smooth
        there)."""
        robot = jr.r3x()
        state, point = moving_state(robot)
        end = [np.asarray(simulate(robot, state, point.torque, h, round(0.02 / h)))[-1] for h in (2e-4, 1e-4, 5e-5)]
        coarse, fine = (np.abs(end[i] - end[i + 1])[:, 14:].max(axis=0) for i in (0, 1))
        order = np.log2(np.linalg.norm(coarse) / np.linalg.norm(fine))
        assert order > 3.5

    def test_rigid_and_flexible_agree_slowly(self):
        """A rigid transmission is the limit of a stiff one: the same acceleration from rest."""
        table = jr.table_from_robot(jr.r3x())
        for joint in table["joint"]:
            joint["stiffness"] = np.inf
        rigid = jr.robot_from_table(table)
        rest = jnp.concatenate([POSITIONS, 0 * POSITIONS], axis=1)
        torque = 0.3 * np.ones(6)
        acceleration = np.asarray(jr.forward_dynamics(rigid, rest, torque))[:, 6:]
        arm = np.concatenate([POSITIONS, np.zeros((4, 0))], axis=1)
        gear, rotor = np.asarray(rigid.drives.gear_ratio), np.asarray(rigid.drives.motor_inertia)
        chain = jr.r3x().chain
        driven = np.array([0, 1, 4, 5, 6, 7])
        q = np.zeros((4, 8))
        q[:, driven] = arm
        mass = np.asarray(jr.mass_matrix(chain, q))[:, driven[:, None], driven] + np.diag(gear**2 * rotor)
        expected = np.linalg.solve(
            mass, (gear * torque - np.asarray(jr.gravity_forces(chain, q))[:, driven])[..., None]
        )
        np.testing.assert_allclose(acceleration, expected[..., 0], rtol=1e-10)


class TestCalculus:
    def test_gradient_through_the_dynamics(self):
        """Reverse differentiation of the acceleration in parameters of every kind, against central
        differences."""
        robot = jr.r3x()
        state, point = moving_state(robot)
        kinds = ("stiffness", "damping", "stiffness_ratio", "stiffness_knee", "motor_inertia", "gear_ratio")
        names = [f"joint2.{kind}" for kind in (*kinds, "viscous_friction", "coulomb_friction")]
        names += ["joint6.mass", "bearing2.stiffness"]
        nominal = {name: jr.parameters(robot, [name.split(".")[1]])[name] for name in names}
        state = state.at[:, 1].add(0.02).at[:, 15].add(0.5)  # joint 2 deflected, and slipping
        weight = np.random.default_rng(0).normal(size=state.shape)

        @jax.jit
        def value(values):
            changed = jr.with_parameters(robot, values)
            return jnp.sum(weight * jr.forward_dynamics(changed, state, point.torque))

        gradient = jax.grad(value)(nominal)
        for name in names:
            h = 1e-6 * float(nominal[name])
            expected = (value(nominal | {name: nominal[name] + h}) - value(nominal | {name: nominal[name] - h})) / (
                2 * h
            )
            np.testing.assert_allclose(gradient[name], expected, rtol=1e-5, err_msg=name)
