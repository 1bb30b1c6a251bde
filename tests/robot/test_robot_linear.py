"""Operating point, linearisation and FRF of the robot against MuJoCo, NumPy, SciPy, closed forms and
published modes."""

import dataclasses
import tomllib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from marks import slow
from mujoco_reference import MuJoCoRobot, paper_frequencies, random_positions, second_order_frf
from puma560 import puma560
from two_axes import ROBOT

import jaxfrf.robot as jr

POSITIONS = random_positions(49)
FEW = POSITIONS[:3]
LINES = paper_frequencies()


def linear_r3x() -> jr.Robot:
    """R3X with the linear springs for which its modes are published."""
    robot = jr.r3x()
    values = {name: 1.0 for name in jr.parameters(robot, ["stiffness_ratio"])}
    values |= {"joint1.stiffness": 4.74e5, "joint2.stiffness": 3.53e5, "joint3.stiffness": 2.09e5}
    return jr.with_parameters(robot, values)


def linear_model(robot, arm_angles, friction=None):
    return jr.linearise(robot, jr.operating_point(robot, arm_angles), friction)


def one(model):
    """The first operating point alone."""
    return dataclasses.replace(model, **{k: getattr(model, k)[0] for k in ("mass", "damping", "stiffness")})


@pytest.fixture(scope="module")
def robot():
    return linear_r3x()


@pytest.fixture(scope="module")
def friction():
    return jr.effective_friction(jr.r3x().drives.friction, 30.0)


@pytest.fixture(scope="module")
def model(robot, friction):
    return linear_model(robot, POSITIONS, friction)


def sorted_poles(model, i):
    """Poles of the flexible modes of one operating point by SciPy, lowest first."""
    mass, damping, stiffness = (np.asarray(x[i]) for x in (model.mass, model.damping, model.stiffness))
    n = len(mass)
    right = -np.linalg.solve(mass, np.concatenate([stiffness, damping], axis=1))
    poles = scipy.linalg.eigvals(np.concatenate([np.eye(n, 2 * n, n), right]))
    poles = poles[poles.imag > 2 * np.pi * 5]
    return poles[np.argsort(np.abs(poles))]


def medians_of_49(values):
    """The range in which 99 % of the medians of 49 rows lie, by resampling."""
    draws = np.random.default_rng(0).choice(len(values), (1000, 49))
    return np.quantile(np.median(values[draws], axis=1), [0.005, 0.995], axis=0)


def relative(a, b):
    """Largest difference of any element over the largest element, line by line."""
    a, b = np.asarray(a), np.asarray(b)
    return np.max(np.abs(a - b), axis=(-1, -2)) / np.max(np.abs(b), axis=(-1, -2))


class TestOperatingPoint:
    def test_is_an_equilibrium(self):
        robot = jr.r3x()
        robot = jr.with_parameters(robot, {f"{j}.coulomb_friction": 0.0 for j in robot.axis_names})
        point = jr.operating_point(robot, POSITIONS)
        assert bool(jnp.all(point.converged))
        np.testing.assert_array_equal(point.z[:, 6:12], POSITIONS)
        forces = jr.generalised_forces(robot, point.z, 0 * point.z, point.torque)
        np.testing.assert_allclose(forces, 0.0, atol=1e-8)

    def test_static_torque(self):
        """Motor torque of axes 2 and 3 with the 10 kg payload: at most 2.9 and 3.5 N m."""
        torque = np.abs(np.asarray(jr.operating_point(jr.r3x(), POSITIONS).torque)).max(axis=0)
        assert torque[0] < 1e-12  # a vertical axis
        assert 2.0 < torque[1] <= 2.9
        assert 2.5 < torque[2] <= 3.5

    @pytest.mark.slow
    def test_derivative_is_that_of_the_solution(self):
        robot, names = (
            jr.r3x(),
            ["bearing2.stiffness", "joint2.stiffness_ratio", "joint6.mass", "joint3.stiffness_knee"],
        )
        nominal = {name: jr.parameters(robot, [name.split(".")[1]])[name] for name in names}
        at = lambda values: jr.operating_point(jr.with_parameters(robot, values), FEW)
        forward = jax.jit(jax.jacfwd(lambda v: at(v).z))(nominal)
        backward = jax.jit(jax.jacrev(lambda v: at(v).torque))(nominal)
        for name in names:
            h = 1e-3 * nominal[name]
            high, low = at(nominal | {name: nominal[name] + h}), at(nominal | {name: nominal[name] - h})
            for ours, theirs in ((forward, high.z - low.z), (backward, high.torque - low.torque)):
                expected = np.asarray(theirs) / (2 * h)
                np.testing.assert_allclose(ours[name], expected, rtol=0, atol=2e-6 * np.abs(expected).max() + 1e-14)

    def test_says_which_positions_failed(self):
        """Per position: one without a number leaves the others as they are."""
        angles = np.array([POSITIONS[0], np.full(6, np.nan), POSITIONS[1]])
        point = jr.operating_point(jr.r3x(), angles)
        np.testing.assert_array_equal(point.converged, [True, False, True])
        np.testing.assert_allclose(point.z[2], jr.operating_point(jr.r3x(), POSITIONS[1]).z, rtol=1e-12, atol=1e-14)


class TestLinearisation:
    def test_is_the_derivative_of_the_dynamics(self, robot):
        """Against plain forward differentiation of the whole nonlinear right-hand side."""
        robot = eqx.tree_at(lambda r: r.drives.friction, robot, jr.ViscousFrictionLaw(robot.drives.friction.viscous))
        point = jr.operating_point(robot, FEW)
        system = jr.state_space(jr.linearise(robot, point))
        state = jnp.concatenate([point.z, 0 * point.z], axis=1)
        slopes = jax.jacfwd(lambda x, u: jr.forward_dynamics(robot, x, u), argnums=(0, 1))
        A, B = jax.jit(jax.vmap(slopes))(state, point.torque)
        np.testing.assert_allclose(system.A, A, rtol=1e-8, atol=1e-8 * np.abs(A).max())
        np.testing.assert_allclose(system.B, B, rtol=1e-10, atol=1e-10)

    def test_mujoco(self, robot, friction):
        """G against matrices that MuJoCo's inverse dynamics give by finite differences: 1e-6."""
        point = jr.operating_point(robot, FEW)
        reference = MuJoCoRobot(robot)
        motor = np.asarray(jr.motor_directions(robot))
        ours = jr.frf(jr.linearise(robot, point, friction), LINES[::7])
        for i in range(len(FEW)):
            mass, damping, stiffness = reference.matrices(np.asarray(point.z[i]))
            damping = damping + motor @ np.diag(friction) @ motor.T
            expected = second_order_frf(mass, damping, stiffness, motor, LINES[::7])
            assert relative(ours[i], expected).max() < 1e-6
            diagonal = [np.diagonal(x, axis1=1, axis2=2) for x in (ours[i], expected)]
            np.testing.assert_allclose(*diagonal, rtol=1e-6)

    def test_numpy_assembly(self, robot, model, friction):
        """G against an assembly of springs, dampers and rotors written out with NumPy; elastic deflections
        included."""
        gear, jm = np.asarray(robot.drives.gear_ratio), np.asarray(robot.drives.motor_inertia)
        k, d = np.asarray(robot.springs.stiffness), np.asarray(robot.springs.damping)
        point = jr.operating_point(robot, FEW)
        arm = np.asarray(point.z)[:, 6:]
        gravity = lambda a: np.asarray(jr.gravity_forces(robot.chain, a[[0, 1, 6, 7, 2, 3, 4, 5]]))[
            [0, 1, 4, 5, 6, 7, 2, 3]
        ]
        for i in range(len(FEW)):
            mass = np.zeros((14, 14))
            mass[:6, :6] = np.diag(jm)
            mass[6:, 6:] = jr.mass_matrix(robot.chain, arm[i][[0, 1, 6, 7, 2, 3, 4, 5]])[
                np.ix_([0, 1, 4, 5, 6, 7, 2, 3], [0, 1, 4, 5, 6, 7, 2, 3])
            ]
            stiffness, damping = np.zeros((14, 14)), np.zeros((14, 14))
            for matrix, value in ((stiffness, k), (damping, d)):
                for a in range(6):
                    matrix[a, a] += value[a] / gear[a] ** 2
                    matrix[a, 6 + a] -= value[a] / gear[a]
                    matrix[6 + a, a] -= value[a] / gear[a]
                    matrix[6 + a, 6 + a] += value[a]
                for e in (6, 7):
                    matrix[6 + e, 6 + e] += value[e]
            damping[:6, :6] += np.diag(friction)
            h = 1e-5
            for a in range(8):
                stiffness[6:, 6 + a] += (gravity(arm[i] + h * np.eye(8)[a]) - gravity(arm[i] - h * np.eye(8)[a])) / (
                    2 * h
                )
            expected = second_order_frf(mass, damping, stiffness, np.eye(14)[:, :6], LINES[::7])
            assert relative(jr.frf(model, LINES[::7])[i], expected).max() < 1e-6

    @pytest.mark.slow
    def test_published_modes(self):
        """Mode frequencies and damping ratios against the published medians of 49 random positions.

        Another draw of 49 positions moves a median by a few per cent: the published one must be a likely
        draw.
        """
        model = linear_model(linear_r3x(), random_positions(1000, seed=1))
        poles = np.array([sorted_poles(model, i) for i in range(1000)])
        frequency, ratio = np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)
        low, high = medians_of_49(frequency)
        published = np.array([22, 24, 34, 40, 49, 58, 91, 103])  # to the nearest Hz
        assert np.all((published + 0.5 >= low) & (published - 0.5 <= high))
        in_band = ratio[:49][frequency[:49] < 80]
        np.testing.assert_allclose([in_band.min(), in_band.max()], [0.018, 0.073], rtol=0.1)

    def test_published_antiresonances(self):
        """Deepest antiresonance and highest peak of G_ii (motor acceleration), axes 1-6, against the
        published medians."""
        f = np.linspace(4, 80, 381)
        model = linear_model(linear_r3x(), random_positions(300, seed=1))
        G = np.abs(np.diagonal(np.asarray(jr.frf(model, f, "acceleration")), axis1=2, axis2=3))
        for published, at in (
            ([18.9, 18.2, 16.8, 34.3, 34.8, 37.9], f[np.argmin(G, axis=1)]),
            ([29.0, 22.3, 40.0, 54.2, 45.4, 48.2], f[np.argmax(G, axis=1)]),
        ):
            low, high = medians_of_49(at)
            assert np.all((np.array(published) + 0.2 >= low) & (np.array(published) - 0.2 <= high))

    def test_deflections_average_the_local_stiffness(self):
        robot = jr.r3x()
        point = jr.operating_point(robot, FEW)
        deflection = 4e-4 * np.random.default_rng(0).normal(size=(50, 8))
        model, wide = jr.linearise(robot, point), jr.linearise(robot, point, deflections=deflection)
        rho, knee, k = (
            np.asarray(x)[:6]
            for x in (robot.springs.stiffness_ratio, robot.springs.stiffness_knee, robot.springs.stiffness)
        )
        x = np.asarray(point.deflection)[:, None, :6] + np.concatenate([deflection, 0 * deflection])[:, :6]
        local = k * (1 - (1 - rho) / np.cosh(x / knee) ** 2)
        change = local[:, :50].mean(axis=1) - local[:, 50:].mean(axis=1)
        for a in range(6):
            np.testing.assert_allclose(
                (wide.stiffness - model.stiffness)[:, 6 + a, 6 + a], change[:, a], atol=1e-8 * k[a]
            )


class TestResponse:
    def test_zeros_and_poles(self, robot):
        """Undamped, G_ii vanishes where the robot with motor i locked resonates and grows where the free one
        does."""
        values = {name: 0.0 for name in jr.parameters(robot, ["damping"])}
        model = one(linear_model(jr.with_parameters(robot, values), FEW, jnp.zeros(6)))
        mass, stiffness = np.asarray(model.mass), np.asarray(model.stiffness)

        def modes(keep):
            values = scipy.linalg.eigh(stiffness[np.ix_(keep, keep)], mass[np.ix_(keep, keep)], eigvals_only=True)
            frequency = np.sqrt(np.maximum(values, 0)) / (2 * np.pi)
            return frequency[(frequency > 5) & (frequency < 80)]

        free = modes(np.arange(14))
        for axis in range(6):
            locked = modes(np.delete(np.arange(14), axis))
            G = lambda f, axis=axis: np.imag(np.asarray(jr.frf(model, f)))[:, axis, axis]
            assert np.all(G(locked * (1 - 1e-7)) * G(locked * (1 + 1e-7)) < 0)
            assert np.all(np.abs(G(free * (1 + 1e-9))) > 1e2 * np.abs(G(free * 1.001)))

    def test_symmetric(self, model):
        G = np.asarray(jr.frf(model, LINES[::10]))
        np.testing.assert_allclose(G, G.swapaxes(-1, -2), rtol=1e-7, atol=1e-12 * np.abs(G).max())

    @pytest.mark.slow
    def test_rigid_limit(self, robot, friction):
        """Springs of growing stiffness tend to the robot with rigid transmissions, at the rate 1/k."""
        table = jr.table_from_robot(robot)
        for joint in table["joint"]:
            joint["stiffness"] = np.inf
        rigid = jr.robot_from_table(table)
        assert (rigid.dof, rigid.n_motors, rigid.n_elastic) == (6, 0, 0)
        limit = jr.frf(linear_model(rigid, FEW, friction), LINES[::20])
        errors = []
        for factor in (1e3, 1e4, 1e5):
            stiff = {name: factor * k for name, k in jr.parameters(robot, ["stiffness"]).items()}
            stiff |= {name: 0.0 for name in jr.parameters(robot, ["damping"])}
            G = jr.frf(linear_model(jr.with_parameters(robot, stiff), FEW, friction), LINES[::20])
            errors.append(relative(G, limit).max())
        np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 10.0, rtol=0.05)

    @pytest.mark.slow
    def test_some_transmissions_rigid(self, robot, friction):
        table = jr.table_from_robot(robot)
        names = ("joint1", "joint4", "upper_arm_torsion")
        for joint in table["joint"]:
            if joint["name"] in names:
                joint["stiffness"] = np.inf
        mixed = jr.robot_from_table(table)
        stiff = jr.with_parameters(robot, {f"{n}.stiffness": 1e13 for n in names})
        ours = jr.frf(linear_model(mixed, FEW, friction), LINES[::20])
        assert relative(ours, jr.frf(linear_model(stiff, FEW, friction), LINES[::20])).max() < 1e-5

    def test_high_frequency(self, robot, model):
        """|G_ii| -> 1/(w J_m) (velocity): the motor alone."""
        G = np.asarray(jr.frf(model, np.array([1e5])))[:, 0]
        expected = 1 / (2 * np.pi * 1e5 * np.asarray(robot.drives.motor_inertia))
        np.testing.assert_allclose(np.abs(np.diagonal(G, axis1=1, axis2=2)), np.tile(expected, (49, 1)), rtol=1e-4)

    def test_two_masses(self):
        """One joint is a two-mass system: motor speed over torque in closed form."""
        table = {
            "gravity": [0.0, 0.0, 0.0],
            "joint": [
                dict(
                    type="driven",
                    axis=[0.0, 0.0, 1.0],
                    offset=[0.0] * 3,
                    mass=0.0,
                    com=[0.0] * 3,
                    inertia=[0.0, 0.0, 3.0, 0.0, 0.0, 0.0],
                    gear_ratio=50.0,
                    motor_inertia=1e-3,
                    stiffness=2e4,
                    damping=8.0,
                    viscous_friction=1e-3,
                )
            ],
        }
        robot = jr.robot_from_table(table)
        s = 2j * np.pi * LINES
        spring = (2e4 + 8.0 * s) / 50**2
        load = 3.0 / 50**2
        expected = s / ((1e-3 * s**2 + 1e-3 * s + spring) - spring**2 / (load * s**2 + spring))
        ours = jr.frf(linear_model(robot, np.zeros(1)), LINES)
        np.testing.assert_allclose(ours[:, 0, 0], expected, rtol=1e-10)
        for n, quantity in enumerate(("position", "velocity", "acceleration")):
            ours = jr.frf(linear_model(robot, np.zeros(1)), LINES, quantity)
            np.testing.assert_allclose(ours[:, 0, 0], expected * s ** (n - 1), rtol=1e-10)

    @pytest.mark.slow
    def test_rigid_puma_swings_under_gravity(self):
        """K of a rigid robot is gravity alone; its FRF against MuJoCo's matrices."""
        robot = puma560(complete_first_link=True)
        robot = jr.with_parameters(robot, {"joint3.inertia": jnp.array([0.1, 0.1, 0.1, 0, 0, 0])})
        q = np.array([0.3, -1.2, 0.4, 0.2, 0.5, -0.1])
        matrices = MuJoCoRobot(robot).matrices(q)
        motor = np.diag(np.asarray(robot.drives.gear_ratio))
        expected = second_order_frf(*matrices, motor, LINES[::20])
        assert relative(jr.frf(linear_model(robot, q), LINES[::20]), expected).max() < 1e-6


class TestSampling:
    @pytest.mark.parametrize("measured", ["position", "velocity"])
    @pytest.mark.parametrize("samples", [0.0, 0.3, 1.0, 2.6])
    def test_hold_and_delay_in_time(self, friction, measured, samples):
        """Simulate the held, delayed torque exactly (matrix exponentials over the parts of a sample) and
        compare the response to a complex exponential sequence."""
        model = one(linear_model(linear_r3x(), FEW, friction))
        fs, frequency = 2000.0, np.array([7.0, 33.0, 79.0])
        system = jr.state_space(model, measured)
        A, B, C = (np.asarray(x) for x in (system.A, system.B, system.C))
        whole = int(np.floor(samples))
        rest = samples - whole
        older, newer = held_step(A, B, rest / fs), held_step(A, B, (1 - rest) / fs)
        step = newer[0] @ older[0]
        late = newer[0] @ older[1]  # the older torque acts first
        hold = jr.ZeroOrderHold(fs, measured)
        ours = np.asarray(jr.frf(model, frequency, measured, hold, samples / fs))
        for line, f in enumerate(frequency):
            z = np.exp(2j * np.pi * f / fs)
            drive = (newer[1] + late / z) * z**-whole
            expected = C @ np.linalg.solve(z * np.eye(len(A)) - step, drive)
            assert relative(ours[line], expected) < 2e-8  # of the 28 x 28 solve at z near 1

    def test_each_torque_has_its_delay(self, model):
        delay = np.array([0, 1e-4, 2e-4, 3e-4, 4e-4, 5e-4])
        plain = jr.frf(model, LINES[::50])
        late = jr.frf(model, LINES[::50], delay=delay)
        np.testing.assert_allclose(late, plain * np.exp(-2j * np.pi * LINES[::50, None, None] * delay), rtol=1e-12)

    def test_sum_over_aliases(self, friction):
        """The definition: the continuous FRF at every alias, behind the hold; a thousand of them."""
        model = one(linear_model(linear_r3x(), FEW, friction))
        fs, frequency = 2000.0, np.array([4.1, 30.0, 79.0])
        ours = np.asarray(jr.frf(model, frequency, "position", jr.ZeroOrderHold(fs, "position")))
        for f, G in zip(frequency, ours, strict=True):
            aliases = f + fs * np.arange(-500, 501)
            s = 2j * np.pi * aliases
            everywhere = (
                np.asarray(jr.frf(model, aliases, "position")) * ((1 - np.exp(-s / fs)) / (s / fs))[:, None, None]
            )
            assert relative(G, everywhere.sum(axis=0)) < 1e-9

    @pytest.mark.parametrize("fs", [slow(8000.0), 2000.0, slow(500.0), 250.0])
    def test_remainder_tells_the_error(self, friction, fs):
        """The terms left out, against the exact discretisation by SciPy, from safe to useless sampling
        frequencies."""
        model = one(linear_model(linear_r3x(), FEW, friction))
        frequency, hold = np.array([30.0, 79.0]), jr.ZeroOrderHold(fs, order=3)
        system = jr.state_space(model)
        A, B = held_step(np.asarray(system.A), np.asarray(system.B), 1 / fs)
        exact = [system.C @ np.linalg.solve(np.exp(2j * np.pi * f / fs) * np.eye(len(A)) - A, B) for f in frequency]
        error = relative(jr.frf(model, frequency, hold=hold), exact)
        remainder = np.asarray(jr.hold_remainder(model, frequency, hold))
        assert np.all(error < 2 * remainder + 2e-8)
        assert np.all(remainder < 20 * error + 2e-8)

    def test_quantity_is_checked(self, model):
        with pytest.raises(ValueError, match="position, velocity or acceleration"):
            jr.frf(model, LINES, "speed")
        with pytest.raises(ValueError, match="position or velocity"):
            jr.ZeroOrderHold(2000.0, "acceleration")


def held_step(A, B, time):
    """exp(A t) and the integral of exp(A s) B, by SciPy."""
    n, m = B.shape
    step = scipy.linalg.expm(np.block([[A, B], [np.zeros((m, n + m))]]) * time)
    return step[:n, :n], step[:n, n:]


class TestStateSpace:
    def test_frf(self, model):
        for quantity in ("position", "velocity", "acceleration"):
            system = jr.state_space(jax.tree.map(lambda x: x[:2] if x.ndim == 3 else x, model), quantity)
            ours = jr.state_space_frf(system, LINES[::30])
            assert relative(ours, jr.frf(model, LINES[::30], quantity)[:2]).max() < 1e-8

    def test_discretise(self, model):
        system = jr.state_space(one(model))
        sampled = jr.discretise(system, 2000.0)
        A, B, *_ = scipy.signal.cont2discrete(
            tuple(np.asarray(x) for x in (system.A, system.B, system.C, system.D)), 5e-4
        )
        np.testing.assert_allclose(sampled.A, A, rtol=1e-9, atol=1e-9 * np.abs(A).max())
        np.testing.assert_allclose(sampled.B, B, rtol=1e-9, atol=1e-9 * np.abs(B).max())

    def test_control(self, model):
        control = pytest.importorskip("control")
        first = one(model)
        system = jr.state_space(first)
        response = control.frequency_response(jr.to_control(system), 2 * np.pi * LINES[::50])
        theirs = np.moveaxis(response.frdata, -1, 0)
        assert relative(jr.frf(first, LINES[::50]), theirs).max() < 1e-8
        assert jr.to_control(jr.discretise(system, 2000.0)).dt == 1 / 2000.0
        with pytest.raises(ValueError, match="operating points"):
            jr.to_control(jr.state_space(model))


class TestJacobian:
    @pytest.mark.slow
    @pytest.mark.parametrize("hold", [None, jr.ZeroOrderHold(2000.0)])
    def test_jacfwd(self, friction, hold):
        """The outer products against forward differentiation through equilibrium, linearisation and solve."""
        robot, frequency = jr.r3x(), LINES[::60]
        deflection = 1e-4 * np.random.default_rng(0).normal(size=(5, 8))

        def response(theta):
            k, d, f = theta
            changed = eqx.tree_at(lambda r: (r.springs.stiffness, r.springs.damping), robot, (k, d))
            model = jr.linearise(changed, jr.operating_point(changed, FEW), f, deflection)
            return jr.frf(model, frequency, "acceleration", hold, 3e-4)

        theta = robot.springs.stiffness, robot.springs.damping, friction
        expected = np.concatenate(jax.jit(jax.jacfwd(response))(theta), axis=-1)
        ours = jr.frf_and_jacobian(robot, FEW, frequency, "acceleration", hold, 3e-4, friction, deflection)
        assert relative(ours.G, response(theta)).max() < 1e-12
        size = np.abs(expected).max(axis=(2, 3), keepdims=True)
        np.testing.assert_array_less(np.abs(ours.jacobian - expected), np.broadcast_to(1e-8 * size, expected.shape))
        assert ours.names == jr.parameter_names(robot) and len(ours.names) == 22

    @pytest.mark.slow
    def test_finite_differences(self, friction):
        robot, frequency = jr.r3x(), LINES[::60]
        ours = jr.frf_and_jacobian(robot, FEW, frequency, friction=friction)
        values = jr.parameters(robot)
        for p, name in enumerate(ours.names[:16]):
            h = (1e-4 if name.endswith("stiffness") else 1e-3) * values[name]
            G = [
                jr.frf(
                    linear_model(jr.with_parameters(robot, {name: values[name] + s * h}), FEW, friction),
                    frequency,
                )
                for s in (1, -1)
            ]
            expected = (G[0] - G[1]) / (2 * h)
            assert relative(ours.jacobian[..., p], expected).max() < 1e-5, name

    @pytest.mark.slow
    def test_parameter_sets(self, friction):
        """A batch of robots by vmap is each robot on its own: many starts of a fit at once."""
        robot, frequency = jr.robot_from_table(tomllib.loads(ROBOT)), LINES[::60]
        sets = jnp.array([0.8, 1.0, 1.3])[:, None] * robot.springs.stiffness

        def response(k):
            changed = eqx.tree_at(lambda r: r.springs.stiffness, robot, k)
            return jr.frf_and_jacobian(changed, FEW[:, :2], frequency, friction=friction[:2])

        batch, one = jax.jit(jax.vmap(response))(sets), jax.jit(response)
        for i in (0, 2):
            single = one(sets[i])
            assert relative(batch.G[i], single.G).max() < 1e-11
            assert relative(batch.jacobian[i, ..., 0], single.jacobian[..., 0]).max() < 1e-10

    @pytest.mark.slow
    def test_rigid_robot_has_friction_only(self):
        robot = puma560()
        ours = jr.frf_and_jacobian(robot, np.zeros(6), LINES[::60], friction=jnp.full(6, 1e-3))
        assert ours.jacobian.shape[-1] == 6
        response = lambda f: jr.frf(linear_model(robot, np.zeros(6), f), LINES[::60])
        expected = jax.jit(jax.jacfwd(response))(jnp.full(6, 1e-3))
        np.testing.assert_allclose(ours.jacobian, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


class TestFriction:
    def test_effective_friction_is_the_mean_slope(self):
        """Regression of the friction torque of a slow sine plus a small fast one on the fast speed."""
        law = jr.Friction(jnp.array([1e-3]), jnp.array([0.4]), jnp.array(0.05))
        phase = 2 * np.pi * np.arange(100_000) / 100_000
        fast = 0.05 * np.sin(997 * phase + np.linspace(0, 2 * np.pi, 20, endpoint=False)[:, None])
        torque = np.asarray(law.torque((30 * np.sin(phase) + fast)[..., None]))[..., 0]
        slope = np.sum(torque * fast) / np.sum(fast * fast)
        np.testing.assert_allclose(jr.effective_friction(law, 30.0), slope, rtol=1e-2)

    def test_a_law_without_coulomb_friction_has_its_viscous_slope(self):
        viscous = jnp.array([1e-3, 2e-3])
        np.testing.assert_array_equal(jr.effective_friction(jr.ViscousFrictionLaw(viscous), 30.0), viscous)
