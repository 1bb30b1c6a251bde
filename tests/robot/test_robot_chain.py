"""Chain dynamics against MuJoCo, published numbers, closed forms and the laws of mechanics."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from marks import slow
from mujoco_reference import MuJoCoRobot, random_positions
from puma560 import puma560
from scipy.spatial.transform import Rotation

import jaxfrf.robot as jr
from jaxfrf.robot.regressor import link_parameters, link_regressor

N = 1000
# MuJoCo's own error: it works with inertias in principal axes, a quaternion of 1e-16 each.
CLOSE = dict(rtol=1e-8, atol=1e-8)


@pytest.fixture(scope="module")
def r3x():
    robot = jr.r3x()
    return jr.with_parameters(robot, {name: 1.0 for name in jr.parameters(robot, ["stiffness_ratio"])})


def random_motion(n_joints, seed=0):
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(-np.pi, np.pi, (N, n_joints)),
        rng.normal(size=(N, n_joints)),
        rng.normal(size=(N, n_joints)),
    )


def random_chain(n, seed=0) -> jr.Chain:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(n, 3))
    tensors = np.einsum("nij,nkj->nik", *[rng.normal(size=(n, 3, 3)) * 0.2] * 2) + 0.05 * np.eye(3)
    inertia = np.stack([tensors[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))], axis=1)
    return jr.Chain(
        axis=jnp.array(axis / np.linalg.norm(axis, axis=1, keepdims=True)),
        offset=jnp.array(rng.normal(size=(n, 3)) * 0.4),
        mass=jnp.array(rng.uniform(0.5, 5.0, n)),
        com=jnp.array(rng.normal(size=(n, 3)) * 0.2),
        inertia=jnp.array(inertia),
        gravity=jnp.array([0.3, -0.5, -9.6]),
    )


@pytest.fixture(scope="module")
def case(r3x):
    return r3x, MuJoCoRobot(r3x), *random_motion(r3x.dof)


class TestMuJoCo:
    """M, c, g and inverse dynamics of the whole flexible robot on 1000 random motions."""

    def test_mass_matrix(self, case):
        robot, reference, z, _, _ = case
        expected = np.array([reference.mass_matrix(x) for x in z])
        np.testing.assert_allclose(jr.inertia(robot, z), expected, **CLOSE)

    def test_bias_and_gravity(self, case):
        robot, reference, z, rate, _ = case
        arm = z[:, robot.n_motors :]
        for v in (rate, 0 * rate):
            expected = np.array([reference.bias(x, y) for x, y in zip(z, v, strict=True)])
            _, bias = jr.arm_inertia_and_bias(robot, arm, v[:, robot.n_motors :])
            np.testing.assert_allclose(expected[:, : robot.n_motors], 0.0, atol=1e-12)
            np.testing.assert_allclose(bias, expected[:, robot.n_motors :], **CLOSE)
        gravity = jr.gravity_forces(robot.chain, jr.chain_angles(robot, arm))[:, np.array(robot.arm_joints)]
        np.testing.assert_allclose(gravity, expected[:, robot.n_motors :], **CLOSE)

    def test_inverse_dynamics(self, case):
        robot, reference, z, rate, acceleration = case
        z = 1e-2 * z  # springs of 1e5 N m/rad: forces of the size that occur
        z[:, robot.n_motors :] *= 100.0
        z[:, : robot.n_motors] += z[:, robot.n_motors :][:, : robot.n_motors] * np.asarray(robot.drives.gear_ratio)
        expected = np.array([reference.inverse(*x) for x in zip(z, rate, acceleration, strict=True)])
        free = jr.with_parameters(
            robot, {f"{j}.{k}_friction": 0.0 for j in robot.axis_names for k in ("viscous", "coulomb")}
        )
        forces = jr.generalised_forces(free, z, rate, np.zeros((N, 6)))
        ours = np.einsum("nij,nj->ni", jr.inertia(robot, z), acceleration) - forces
        np.testing.assert_allclose(ours, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())

    def test_chain_alone(self, case):
        robot, reference, z, rate, acceleration = case
        arm, motors = slice(robot.n_motors, None), robot.n_motors
        order = np.argsort(robot.arm_joints)
        q, v, a = (x[:, arm][:, order] for x in (z, rate, acceleration))
        ours = np.asarray(jr.inverse_dynamics(robot.chain, q, v, a))
        moves = np.concatenate([np.zeros((N, motors)), acceleration[:, arm]], axis=1)
        expected = [reference.mass_matrix(x) @ w + reference.bias(x, y) for x, y, w in zip(z, rate, moves, strict=True)]
        np.testing.assert_allclose(ours, np.array(expected)[:, arm][:, order], **CLOSE)


class TestSlidingJoints:
    """Chains that turn and slide about every axis, against MuJoCo and the links' regressor."""

    @pytest.fixture(scope="class")
    @staticmethod
    def robot():
        chain, n = random_chain(6, 3), 6
        # A body's largest moment of inertia is at most the sum of the others.
        lawful = chain.inertia.at[:, :3].add(0.5)
        chain = dataclasses.replace(chain, inertia=lawful, slides=(True, False, True, False, False, True))
        drives = jr.Drives(
            motor_inertia=jnp.full(n, 1e-3),
            gear_ratio=jnp.linspace(40.0, 90.0, n),
            torque_limit=jnp.full(n, jnp.inf),
            friction=jr.Friction(jnp.zeros(n), jnp.zeros(n), jnp.asarray(0.2)),
        )
        springs = jr.Spring(*(jnp.full(n, x) for x in (1e5, 10.0, 1.0, 2.9e-4)))
        names = tuple(f"joint{i + 1}" for i in range(n))
        return jr.Robot(chain, drives, springs, names, (True,) * n, (False,) * n)

    def test_mujoco(self, robot):
        reference = MuJoCoRobot(robot)
        z, rate, acceleration = random_motion(robot.dof)
        z[:, : robot.n_motors] = z[:, robot.n_motors :] * np.asarray(robot.drives.gear_ratio)
        expected = np.array([reference.inverse(*x) for x in zip(z, rate, acceleration, strict=True)])
        forces = jr.generalised_forces(robot, z, rate, np.zeros((N, robot.n_axes)))
        ours = np.einsum("nij,nj->ni", jr.inertia(robot, z), acceleration) - forces
        np.testing.assert_allclose(ours, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())

    def test_regressor(self, robot):
        chain = robot.chain
        q, v, a = random_motion(chain.n_joints)
        Y = link_regressor(chain, q.T, v.T, a.T)
        pi = np.stack([link_parameters(*rows) for rows in zip(chain.mass, chain.com, chain.inertia, strict=True)])
        wanted = np.asarray(jr.inverse_dynamics(chain, q, v, a)).T
        np.testing.assert_allclose(np.einsum("ijpt,jp->it", Y, pi), wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())

    def test_gravity_is_the_slope_of_the_energy(self, robot):
        q = random_motion(robot.chain.n_joints)[0][:20]
        slope = jax.vmap(jax.grad(lambda x: jr.potential_energy(robot.chain, x)))(jnp.asarray(q))
        np.testing.assert_allclose(jr.gravity_forces(robot.chain, q), slope, rtol=1e-9, atol=1e-9)


class TestPuma:
    def test_published_numbers(self):
        """Inertia with the rotors, and gravity load, at the nominal pose: Corke, Robotics, Vision and
        Control, ch. 9."""
        robot = puma560()
        q = np.array([0, np.pi / 4, np.pi, 0, np.pi / 4, 0])
        inertia = np.diag([3.6594, 4.4137, 0.9378, 0.1925, 0.1713, 0.1941])
        inertia[0, 1:4] = [-0.4044, 0.1006, -0.0025]
        inertia[1, 2:5] = [0.3509, 0.0, 0.0024]
        inertia[2, 4] = 0.0015
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        np.testing.assert_allclose(jr.arm_inertia(robot, q), inertia, atol=6e-5)
        np.testing.assert_allclose(jr.gravity_forces(robot.chain, q), [0, 31.6399, 6.0351, 0, 0.0283, 0], atol=6e-5)

    def test_mujoco(self):
        robot = puma560(complete_first_link=True)
        # The third link's published inertia is 10 % larger about one axis than about the other two together.
        third = np.asarray(robot.chain.inertia[2])
        lawful = jr.with_parameters(robot, {"joint3.inertia": jnp.array([0.1, 0.1, 0.1, 0, 0, 0])})
        reference = MuJoCoRobot(lawful)
        xx, yy, zz, xy, xz, yz = third
        reference.set_inertia("joint3", np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        q, rate, acceleration = random_motion(6)
        expected = np.array([reference.inverse(*x) for x in zip(q, rate, acceleration, strict=True)])
        matrix, bias = jr.arm_inertia_and_bias(robot, q, rate)
        np.testing.assert_allclose(jnp.einsum("nij,nj->ni", matrix, acceleration) + bias, expected, **CLOSE)


class TestClosedForms:
    def test_pendulum(self):
        mass, length, own = 2.0, 0.7, 0.03
        chain = jr.Chain(
            *(
                jnp.array(x)
                for x in ([[0.0, 0, 1]], [[0.0, 0, 0]], [mass], [[0.0, -length, 0]], [[0.0, 0, own, 0, 0, 0]])
            ),
            jnp.array([0.0, -9.81, 0]),
        )
        q = np.linspace(-3, 3, 7)[:, None]
        np.testing.assert_allclose(jr.mass_matrix(chain, q)[:, 0, 0], own + mass * length**2, rtol=1e-14)
        np.testing.assert_allclose(jr.gravity_forces(chain, q), mass * 9.81 * length * np.sin(q), atol=1e-13)

    def test_two_links(self):
        """The planar two-link arm of the textbooks (Spong, Hutchinson & Vidyasagar, Robot Modeling and
        Control, sect. 7.4)."""
        m1, m2, l1, c1, c2, i1, i2, g = 3.0, 2.0, 0.6, 0.25, 0.2, 0.05, 0.04, 9.81
        chain = jr.Chain(
            axis=jnp.array([[0.0, 0, 1]] * 2),
            offset=jnp.array([[0.0, 0, 0], [l1, 0, 0]]),
            mass=jnp.array([m1, m2]),
            com=jnp.array([[c1, 0, 0], [c2, 0, 0]]),
            inertia=jnp.array([[0.0, 0, i1, 0, 0, 0], [0.0, 0, i2, 0, 0, 0]]),
            gravity=jnp.array([0.0, -g, 0]),
        )
        (q, v, a) = (x[:, :2] for x in random_motion(2))
        (q1, q2), (v1, v2) = q.T, v.T
        d11 = m1 * c1**2 + m2 * (l1**2 + c2**2 + 2 * l1 * c2 * np.cos(q2)) + i1 + i2
        d12 = m2 * (c2**2 + l1 * c2 * np.cos(q2)) + i2
        h = -m2 * l1 * c2 * np.sin(q2)
        g2 = m2 * c2 * g * np.cos(q1 + q2)
        first = (
            d11 * a[:, 0] + d12 * a[:, 1] + h * v2 * v1 + h * (v1 + v2) * v2 + (m1 * c1 + m2 * l1) * g * np.cos(q1) + g2
        )
        second = d12 * a[:, 0] + (m2 * c2**2 + i2) * a[:, 1] - h * v1**2 + g2
        np.testing.assert_allclose(
            jr.inverse_dynamics(chain, q, v, a), np.stack([first, second], 1), rtol=1e-12, atol=1e-11
        )

    def test_forward_kinematics(self):
        chain, q = random_chain(5), random_motion(5)[0][:20]
        frames = jr.forward_kinematics(chain, q)
        for b in range(20):
            rotation, place = Rotation.identity(), np.zeros(3)
            for i in range(5):
                place = place + rotation.apply(np.array(chain.offset[i]))
                rotation = rotation * Rotation.from_rotvec(q[b, i] * np.asarray(chain.axis[i]))
                np.testing.assert_allclose(frames.rotation[b, i], rotation.as_matrix(), atol=1e-13)
                np.testing.assert_allclose(frames.position[b, i], place, atol=1e-13)


class TestMechanics:
    @pytest.mark.parametrize("n", [slow(1), 2, slow(4)])
    def test_power(self, n):
        """The power of the inverse dynamics is the rate of kinetic and potential energy, on random chains."""
        chain, (q, v, a) = random_chain(n, seed=n), random_motion(n)

        def total(q, v):
            return 0.5 * jnp.einsum("ni,nij,nj->n", v, jr.mass_matrix(chain, q), v) + jr.potential_energy(chain, q)

        _, rate = jax.jvp(total, (q, v), (v, a))
        power = np.sum(v * jr.inverse_dynamics(chain, q, v, a), axis=1)
        np.testing.assert_allclose(power, rate, rtol=1e-10, atol=1e-10)

    def test_mass_matrix_and_bias_agree_with_inverse_dynamics(self):
        chain, (q, v, a) = random_chain(6), random_motion(6)
        matrix, bias = jr.mass_and_bias(chain, q, v)
        np.testing.assert_allclose(
            jnp.einsum("nij,nj->ni", matrix, a) + bias,
            jr.inverse_dynamics(chain, q, v, a),
            rtol=1e-10,
            atol=1e-10,
        )

    def test_positive_definite(self, r3x):
        arm = np.concatenate([random_positions(10_000), np.zeros((10_000, 2))], axis=1)
        matrix = np.asarray(jax.jit(jr.arm_inertia)(r3x, arm))
        np.testing.assert_array_equal(matrix, matrix.swapaxes(1, 2))
        moments = np.linalg.eigvalsh(matrix)
        assert moments.min() > 0
        assert (moments[:, -1] / moments[:, 0]).max() < 4e3

    def test_composite_of_links_3_to_5(self):
        """Otter & Tuerk (1988): the upper arm's links together, about their centre of mass."""
        chain = jr.r3x().chain
        links = slice(4, 7)
        place = np.cumsum(np.asarray(chain.offset)[links], axis=0)
        mass, com = np.asarray(chain.mass)[links], place - place[0] + np.asarray(chain.com)[links]
        centre = mass @ com / mass.sum()
        xx, yy, zz, xy, xz, yz = np.asarray(chain.inertia)[links].T
        own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)
        shifts = com - centre
        total = sum(i + m * (c @ c * np.eye(3) - np.outer(c, c)) for i, m, c in zip(own, mass, shifts, strict=True))
        np.testing.assert_allclose(mass.sum(), 60.3)
        np.testing.assert_allclose(centre, [0.028, 0.202, 0.0], atol=5e-4)
        np.testing.assert_allclose(np.diag(total), [5.41, 0.39, 5.60], atol=1e-2)
        np.testing.assert_allclose(total[0, 1], 0.33, atol=5e-3)


class TestCalculus:
    @pytest.mark.slow
    def test_every_parameter_is_differentiable(self):
        """Derivative of the inverse dynamics in every number of the chain, against central differences."""
        chain, (q, v, a) = random_chain(4), (x[:3] for x in random_motion(4))
        fields = [f for f in dataclasses.fields(chain) if not f.metadata.get("static")]
        for k, field in enumerate(fields):
            value = getattr(chain, field.name)
            direction = np.random.default_rng(k).normal(size=value.shape)

            def torque(h, name=field.name, value=value, direction=direction):
                changed = dataclasses.replace(chain, **{name: value + h * direction})
                return jr.inverse_dynamics(changed, q, v, a)

            slope = jax.jvp(torque, (0.0,), (1.0,))[1]
            expected = (torque(1e-5) - torque(-1e-5)) / 2e-5
            np.testing.assert_allclose(slope, expected, rtol=1e-6, atol=1e-6)

    def test_batches(self):
        chain, (q, v, a) = random_chain(3), random_motion(3)
        whole = jr.inverse_dynamics(chain, q.reshape(10, 100, 3), v.reshape(10, 100, 3), a.reshape(10, 100, 3))
        np.testing.assert_allclose(
            whole[3, 7], jr.inverse_dynamics(chain, q[307], v[307], a[307]), rtol=1e-10, atol=1e-11
        )
        masses = jnp.linspace(0.5, 2.0, 5)[:, None] * chain.mass
        of_mass = lambda m: jr.mass_matrix(
            jr.Chain(chain.axis, chain.offset, m, chain.com, 0 * chain.inertia, chain.gravity), q
        )
        batch = jax.vmap(of_mass)(masses)
        expected = jnp.linspace(0.5, 2.0, 5)[:, None, None, None] * of_mass(chain.mass)
        np.testing.assert_allclose(batch, expected, rtol=1e-12, atol=1e-12)

    def test_wrong_shapes(self):
        chain = random_chain(3)
        with pytest.raises(ValueError, match=r"shape \(\*batch, joint\), joint = 3"):
            jr.mass_matrix(chain, np.zeros(4))
        with pytest.raises(ValueError, match="com: found an array of shape"):
            jr.Chain(chain.axis, chain.offset, chain.mass, chain.com[:2], chain.inertia, chain.gravity)
