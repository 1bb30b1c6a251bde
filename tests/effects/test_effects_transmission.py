"""Effects inside transmissions: the simulation against plain NumPy, laws against closed forms, the linearised robot."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy.optimize

import jaxfrf as jf
from jaxfrf import effects as ef
from jaxfrf.effects.transmission import ToothWaves

KEY = jr.key(2)
LINK = {"type": "driven", "axis": [0.0, 0.0, 1.0], "offset": [0.0, 0.0, 0.0], "com": [0.0, 0.0, 0.0], "mass": 1.0}
LINK |= {"viscous_friction": 1e-3, "coulomb_friction": 0.0, "torque_limit": 20.0}
ARM = {"inertia": [1.0, 1.0, 2.5, 0.0, 0.0, 0.0], "gear_ratio": 50.0, "motor_inertia": 1e-3, "velocity_gain": 0.2}
WRIST = {"inertia": [1.0, 1.0, 0.8, 0.0, 0.0, 0.0], "gear_ratio": 80.0, "motor_inertia": 2e-4, "velocity_gain": 0.05}
ELASTIC = {"name": "bearing", "type": "elastic", "axis": [1.0, 0.0, 0.0], "offset": [0.0, 0.0, 0.0], "mass": 1.0}
ELASTIC |= {"com": [0.0, 0.2, 0.1], "inertia": [0.5, 0.5, 0.5, 0.0, 0.0, 0.0], "stiffness": 3e4, "damping": 5.0}

# The laws once more, in plain numbers.
CORNERS, WEIGHTS = 2 * np.pi * np.array([3.0, 17.3, 100.0]), np.array([1.5, 1.0, 1.5])
SOFTER = np.sum(WEIGHTS * (40 * np.pi) ** 2 / ((40 * np.pi) ** 2 + CORNERS**2))


def robot_of(*joints, gravity=(0.0, 0.0, 0.0)):
    named = [joint if "name" in joint else LINK | {"name": f"joint{i}"} | joint for i, joint in enumerate(joints, 1)]
    controller = {"position_gain": 5.0, "integral_time": 0.05}
    return jf.robot.robot_from_table({"gravity": list(gravity), "joint": named, "controller": controller})


def arm(**options):
    return ARM | {"stiffness": 5e4, "damping": 20.0} | options


def wrist(**options):
    return WRIST | {"stiffness": 3e4, "damping": 10.0} | options


def record(robot, rms, steps=10):
    """From rest, the fade-in recorded too, no noise: torques and motor angles, (time, axis)."""
    slow = jf.SlowSine([1, 2][: len(rms)], [20.0, 12.0][: len(rms)])
    design = jf.Multisine(2000.0, 2000, np.arange(5, 80, 2), rms=rms, slow=slow, transient_periods=1, ramp=0.5)
    q = np.zeros((1, len(rms)))
    data = jf.simulate(robot, design, q, key=KEY, run_in=None, noise=0.0, steps=steps)
    return np.asarray(data.u[0, 0]), np.asarray(data.y[0, 0])


def integrate(slope, x, torque, n, sub, settled=lambda x: x):
    """Classical Runge-Kutta under torques held for a sample, states at the samples."""
    out, h = [], 1 / (2000 * sub)
    for u in torque[:n]:
        out.append(x)
        for _ in range(sub):
            a = slope(x, u)
            b = slope(x + h / 2 * a, u)
            c = slope(x + h / 2 * b, u)
            x = settled(x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c, u)))
    return np.array(out)


def close(y, angle, within):
    moved = np.abs(y[: len(angle)] - y[0]).max(axis=0)
    assert np.all(np.abs(y[: len(angle)] - angle).max(axis=0) < within * moved)


class TestInTheSimulation:
    @pytest.mark.slow
    def test_inside_a_gear(self):
        """Error, loss and hysteresis of one transmission under a static load: as ten more states of an ODE."""
        error = [4e-5, 2e-5], 101.0, (1, 3), [0.4, -1.0]
        robot = robot_of(arm()).with_effects(
            ef.TransmissionError(0, *error),
            ef.StructuralDamping(0, 0.06),
            ef.GearHysteresis("joint1", 8.0, 1e-4),
            ef.Counterbalance(0, 300.0, 0.5),
        )
        u, y = record(robot, [4.0])
        lead = lambda a: 4e-5 * np.sin(101.0 * a + 0.4) + 2e-5 * np.sin(303.0 * a - 1.0)
        slope = lambda a: 101.0 * (4e-5 * np.cos(101.0 * a + 0.4) + 6e-5 * np.cos(303.0 * a - 1.0))
        yields = 1e-4 * np.array([0.25, 0.75, 1.25, 1.75])

        def change(x, u):
            qm, qa, vm, va, let_go, stretch = x[0], x[1], x[2], x[3], x[4:7], x[7:]
            deflection, rate = qm / 50 + lead(qm / 50) - qa, vm / 50 * (1 + slope(qm / 50)) - va
            f = 5e4 * deflection
            tau = f * (1 - 0.06 * SOFTER) + 20.0 * rate + 0.06 * np.sum(WEIGHTS * (f - let_go)) + 2e4 * stretch.sum()
            slipping = (np.abs(stretch) >= yields) & (rate * stretch > 0)
            speed = (u[0] - 1e-3 * vm - tau * (1 + slope(qm / 50)) / 50) / 1e-3
            arm = (tau - 300.0 * (qa - 0.5)) / 2.5
            return np.array([vm, va, speed, arm, *CORNERS * (f - let_go), *np.where(slipping, 0.0, rate)])

        held = -150.0 / (1 - 0.06 * SOFTER)
        motor = 50 * scipy.optimize.brentq(lambda a: a + lead(a) - held / 5e4, -0.1, 0.1, xtol=1e-15)
        start = np.array([motor, 0, 0, 0, held, held, held, 0, 0, 0, 0])
        assert y[0, 0] == pytest.approx(motor, rel=1e-12)
        no_farther = lambda x: np.concatenate([x[:7], np.clip(x[7:], -yields, yields)])
        angle = integrate(change, start, u, 1000, 20, no_farther)
        deflection = angle[:, 0] / 50 + lead(angle[:, 0] / 50) - angle[:, 1]
        assert np.ptp(deflection) > 5e-4  # all elements slip
        close(y, angle[:, :1], 2e-5)

    @pytest.mark.slow
    def test_coupled_axes(self):
        """Two axes that turn about one line, the second gear turned by the first; bare, the motions differ by far."""
        robot = robot_of(arm(), wrist()).with_effects(ef.WristCoupling("joint2", 0.08))
        u, y = record(robot, [3.0, 3.0])
        mass = np.array([[3.3, 0.8], [0.8, 0.8]])

        def change_with(ratio):
            gear = np.array([[1.0, 0.0], [ratio, 1.0]])
            n, J = np.array([50.0, 80.0]), np.array([1e-3, 2e-4])

            def change(x, u):
                qm, qa, vm, va = x.reshape(4, 2)
                tau = [5e4, 3e4] * (qm / n - gear @ qa) + [20.0, 10.0] * (vm / n - gear @ va)
                return np.concatenate([vm, va, (u - 1e-3 * vm - tau / n) / J, np.linalg.solve(mass, gear.T @ tau)])

            return change

        angle = integrate(change_with(0.08), np.zeros(8), u, 1000, 10)[:, :2]
        close(y, angle, 1e-5)
        bare = integrate(change_with(0.0), np.zeros(8), u, 1000, 10)[:, :2]
        assert np.abs(y[:1000] - bare).max() > 0.05

    @pytest.mark.slow
    def test_at_rest_under_gravity(self):
        """Everything at once, some axes rigid, an elastic joint: nothing moves until the controller says so."""
        robot = robot_of(
            arm() | {"axis": [1.0, 0.0, 0.0]},
            ELASTIC,
            arm(stiffness=np.inf) | {"com": [0.3, 0.1, 0.2], "mass": 4.0},
            wrist() | {"axis": [0.0, 1.0, 0.0], "com": [0.1, 0.2, 0.3], "mass": 2.0},
            gravity=(0.0, -9.81, 0.0),
        ).with_effects(
            ef.TransmissionError(0, [4e-5, 2e-5], 101.0, phase=[0.4, 1.0]),
            ef.TransmissionError(2, [4e-5], 30.0, (2,), [0.4]),
            ef.StructuralDamping(2, 0.1),
            ef.GearHysteresis(0, 8.0, 1e-4),
            ef.WristCoupling("joint4", -0.1),
        )
        design = jf.Multisine(2000.0, 400, np.arange(1, 20, 2), rms=[1e-300] * 3)
        q = np.array([[0.5, 0.3, -0.4]])
        data = jf.simulate(robot, design, q, key=KEY, noise=0.0, run_in=0.2)
        point = jf.robot.operating_point(robot, q)
        assert np.abs(point.torque).min() > 1e-3
        np.testing.assert_allclose(data.u[0, 0], np.broadcast_to(point.torque, (400, 3)), rtol=1e-8)
        assert np.abs(data.y - data.y[0, 0, 0]).max() < 1e-9


class TestLaws:
    def test_loss(self):
        """The torque after a sine of deflection: the same loss from 4 to 80 Hz, and the spring's own at 20 Hz."""
        robot = robot_of(arm())
        effect, step = ef.StructuralDamping(0, 0.05), 1e-4
        frequency = np.array([4.0, 8.0, 20.0, 50.0, 80.0])
        time = step * np.arange(20000)[:, None]
        x = 1e-3 * np.sin(2 * np.pi * frequency * time)
        torque = np.asarray(effect.along(robot, x, None, None, step)) + 5e4 * x
        periodic = slice(10000, 20000)
        turn = np.exp(-2j * np.pi * frequency * time[periodic])
        k = np.mean(torque[periodic] * turn, axis=0) / np.mean(x[periodic] * turn, axis=0) / 5e4
        np.testing.assert_allclose(k.imag, 0.05, rtol=8e-3)
        assert k[2].real == pytest.approx(1.0, abs=1e-5)
        np.testing.assert_allclose(k - 1.0, effect.response(2j * np.pi * frequency), atol=2e-5)
        # Causality: the real part rises by the loss as 2/pi ln f.
        np.testing.assert_allclose(k.real - 1.0, 0.05 * 2 / np.pi * np.log(frequency / 20), atol=4e-3)

    def test_loss_of_a_nonlinear_spring(self):
        """About a deflection the loss is that of the local stiffness."""
        robot = robot_of(arm(stiffness_low=2e4, stiffness_knee=2.9e-4))
        effect, step, f = ef.StructuralDamping(0, 0.05), 1e-4, 20.0
        time = step * np.arange(20000)[:, None]
        offset = np.array([0.0, 2e-4, 5e-4])
        x = offset + 1e-6 * np.sin(2 * np.pi * f * time)
        torque = np.asarray(effect.along(robot, x, None, None, step))[10000:]
        turn = np.exp(-2j * np.pi * f * time[10000:])
        k = np.mean(torque * turn, axis=0) / np.mean(x[10000:] * turn, axis=0)
        np.testing.assert_allclose(k.imag / 0.05, 5e4 - 3e4 / np.cosh(offset / 2.9e-4) ** 2, rtol=8e-3)

    @pytest.mark.parametrize("amplitude", [5e-5, 1.3e-4, 6e-4])
    def test_hysteresis_loop(self, amplitude):
        """Area 4 F_j (A - x_j) of every element that slips, however fast; saturation, and slope at a reversal."""
        robot, effect = robot_of(arm()), ef.GearHysteresis(0, 8.0, 1e-4)
        yields = 1e-4 * np.array([0.25, 0.75, 1.25, 1.75])
        area = np.sum(4 * 2e4 * yields * np.maximum(amplitude - yields, 0.0))
        for n in (4000, 40000):
            x = 0.02 + amplitude * np.sin(2 * np.pi * np.arange(2 * n + 1) / n)
            torque = np.asarray(effect.along(robot, x, None, None, 1 / n))[n:]
            assert torque[0] != 0.0
            assert np.trapezoid(torque, x[n:]) == pytest.approx(area, rel=2e-4)
            assert np.abs(torque).max() == pytest.approx(2e4 * np.minimum(yields, amplitude).sum(), rel=1e-6)
        top = n // 4
        assert (torque[top + 50] - torque[top]) / (x[top + 50] - x[top]) == pytest.approx(8e4, rel=1e-3)

    def test_error_along_a_motion(self):
        robot, effect = robot_of(arm()), ef.TransmissionError(0, [4e-5, 2e-5], 101.0, (1, 3), [0.4, -1.0])
        time = 5e-4 * np.arange(2000)
        angle, rate = 0.3 * np.sin(time), 0.3 * np.cos(time)
        lead = 4e-5 * np.sin(101.0 * angle + 0.4) + 2e-5 * np.sin(303.0 * angle - 1.0)
        slope = 101.0 * (4e-5 * np.cos(101.0 * angle + 0.4) + 6e-5 * np.cos(303.0 * angle - 1.0))
        found = effect.along(robot, 1e-3 * angle, 1e-3 * rate, angle, 5e-4)
        np.testing.assert_allclose(found[1:-1], (5e4 * lead + 20.0 * slope * rate)[1:-1], atol=2e-4)
        np.testing.assert_allclose(effect.slope(jnp.asarray(angle)), slope, atol=1e-12)


def linear_robot():
    robot = robot_of(
        arm(stiffness_low=3e4, stiffness_knee=2.9e-4) | {"axis": [1.0, 0.0, 0.0]},
        ELASTIC,
        wrist() | {"axis": [0.0, 1.0, 0.0], "com": [0.1, 0.2, 0.3], "mass": 4.0},
        wrist() | {"com": [0.1, 0.05, 0.02], "inertia": [0.3, 0.3, 0.4, 0.0, 0.0, 0.0]},
        gravity=(0.0, -9.81, 0.0),
    )
    return robot.with_effects(
        ef.StructuralDamping(0, 0.08), ef.StructuralDamping("joint4", 0.05), ef.WristCoupling(2, 0.1)
    )

    @pytest.mark.parametrize("orders", [(1, 2), (1,), (2,)])
    def test_error_as_numbers(self, orders):
        """A fit moves sines and cosines of it; what is stated again is the same wave."""
        amplitude, phase = [4e-5, 1e-5][: len(orders)], [0.7, -2.1][: len(orders)]
        error = ef.TransmissionError("joint1", amplitude, 101.0, orders, phase)
        angle = np.linspace(-0.3, 0.2, 200)
        wave = sum(a * np.sin(h * 101.0 * angle + p) for a, h, p in zip(amplitude, orders, phase, strict=True))
        for same in (error.in_numbers(), error.in_numbers().stated()):
            assert np.allclose(same.lead(angle), wave, atol=1e-15)
        assert error.in_numbers().stated().order == ((1,) if orders == (2,) else (1, 2))  # twice as many teeth
        assert ef.TransmissionError("joint1", [1e-5], 101.0, (3,)).in_numbers().order == (3,)

    def test_values_of_an_error_that_was_fitted(self):
        """Against draws; the order that stands out first."""
        names = ["teeth", "cosine_2", "sine_1", "cosine_1", "sine_2"]
        mean = dict(zip(names, [101.0, 4e-5, 5e-6, 1e-5, -3e-5], strict=True))
        std = np.array([0.02, 1e-6, 4e-6, 2e-6, 3e-6])
        told = ToothWaves("joint1", **mean).stated_values(names, np.diag(std**2))
        draws = dict(zip(names, np.random.default_rng(0).normal(list(mean.values()), std, (100_000, 5)).T, strict=True))
        for order, name in ((1, "amplitude_1"), (2, "amplitude_2")):
            amplitude = np.hypot(draws[f"sine_{order}"], draws[f"cosine_{order}"])
            assert told[name][0] == pytest.approx(np.hypot(mean[f"sine_{order}"], mean[f"cosine_{order}"]))
            assert told[name][1] == pytest.approx(amplitude.std(), rel=0.05)
        assert next(iter(told)) == "amplitude_2" and told["order_2"] == (2.0, 0.0)
        assert told["teeth"] == pytest.approx((101.0, 0.02))


class TestInTheLinearisation:
    q = np.array([[0.5, 0.3, -0.4], [-0.2, 1.0, 0.6]])

    def test_against_matrices(self):
        """K (1 + j loss) and the coupling written out: two axes about one line."""
        robot = robot_of(arm(), wrist()).with_effects(ef.WristCoupling(1, 0.08), ef.StructuralDamping(1, 0.1))
        frequency = np.geomspace(1.0, 150.0, 40)
        model = jf.robot.linearise(robot, jf.robot.operating_point(robot, np.zeros((1, 2))))
        W = np.array([[1 / 50, 0, -1, 0], [0, 1 / 80, -0.08, -1]])
        mass = np.diag([1e-3, 2e-4, 0.0, 0.0])
        mass[2:, 2:] = [[3.3, 0.8], [0.8, 0.8]]
        s = 2j * np.pi * frequency
        elements = (WEIGHTS * s[:, None] / (s[:, None] + CORNERS)).sum(axis=1)
        springs = np.array([5e4 + 20 * s, 3e4 * (1 + 0.1 * (elements - SOFTER)) + 10 * s])
        S = W.T @ (springs.T[:, :, None] * W) + s[:, None, None] ** 2 * mass
        S[:, [0, 1], [0, 1]] += 1e-3 * s[:, None]
        expected = s[:, None, None] * np.linalg.inv(S)[:, :2, :2]
        np.testing.assert_allclose(jf.robot.frf(model, frequency)[0], expected, rtol=1e-9)

    @pytest.mark.slow
    def test_against_the_simulation(self):
        """LOG estimate of a small motion under gravity."""
        robot = linear_robot()
        design = jf.Multisine(2000.0, 4000, np.arange(9, 300, 6), rms=[0.03, 0.03, 0.03])
        data = jf.simulate(robot, design, self.q[:1], key=KEY, noise=0.0, run_in=4.0, steps=4)
        spectra = jf.with_output_quantity(jf.dft(data), "velocity")
        estimate = np.asarray(jf.estimate(spectra, jf.LogMean()).G)
        hold = jf.robot.ZeroOrderHold(2000.0, "position")
        G = lambda r: np.asarray(
            jf.robot.frf(jf.robot.linearise(r, jf.robot.operating_point(r, self.q[:1])), spectra.frequency, hold=hold)
        )
        size = np.abs(np.diagonal(G(robot), axis1=-2, axis2=-1)).min(axis=-1)[..., None, None]
        assert np.abs((estimate - G(robot)) / size).max() < 1e-3
        without = jf.robot.robot_from_table(jf.robot.table_from_robot(robot) | {"effect": []})
        assert np.abs((estimate - G(without)) / size).max() > 0.5

    @pytest.mark.slow
    def test_derivatives(self):
        """G and its derivative in springs and dampers, losses and coupling in them, against differences."""
        robot, frequency = linear_robot(), np.array([5.0, 17.0, 40.0])
        hold = jf.robot.ZeroOrderHold(2000.0, "position")
        found = jf.robot.frf_and_jacobian(robot, self.q, frequency, hold=hold)

        def G(values):
            changed = jf.robot.with_parameters(robot, values)
            return jf.robot.frf(
                jf.robot.linearise(changed, jf.robot.operating_point(changed, self.q)), frequency, hold=hold
            )

        np.testing.assert_allclose(found.G, G({}), rtol=1e-9)
        own = jf.robot.parameters(robot)
        for i, name in enumerate(found.names):
            if name in own:
                step = 1e-4 * float(own[name])
                change = (G({name: own[name] + step}) - G({name: own[name] - step})) / (2 * step)
                np.testing.assert_allclose(found.jacobian[..., i], change, atol=1e-6 * np.abs(change).max())

    @pytest.mark.slow
    def test_disturbances_do_not_show(self):
        bare = robot_of(arm(stiffness_low=3e4, stiffness_knee=2.9e-4) | {"axis": [1.0, 0.0, 0.0], "com": [0, 0, 0.3]})
        bare = jf.robot.with_parameters(bare, {"joint1.mass": 20.0})
        frequency, q = np.array([5.0, 20.0]), np.array([[0.4]])
        G = lambda r: jf.robot.frf(jf.robot.linearise(r, jf.robot.operating_point(r, q)), frequency)
        more = bare.with_effects(ef.TransmissionError(0, [1e-4], 120.0, (1,), [0.5]), ef.GearHysteresis(0, 5.0))
        np.testing.assert_allclose(G(more), G(bare), rtol=1e-9)

    @pytest.mark.slow
    def test_gradients(self):
        """Of the linearised robot in loss and ratio, against differences."""
        frequency = jnp.array([5.0, 20.0, 60.0])

        bare = robot_of(arm(), wrist())

        @jax.jit
        def size(x):
            robot = bare.with_effects(ef.StructuralDamping(0, x[0]), ef.WristCoupling(1, x[1]))
            point = jf.robot.operating_point(robot, jnp.zeros((1, 2)))
            return jnp.sum(jnp.real(jf.robot.frf(jf.robot.linearise(robot, point), frequency) * jnp.exp(0.3j)))

        x = jnp.array([0.03, 0.04])
        for i, slope in enumerate(jax.jacfwd(size)(x)):
            change = size(x.at[i].add(1e-6)) - size(x.at[i].add(-1e-6))
            assert float(slope) == pytest.approx(float(change / 2e-6), rel=1e-5)


class TestFiles:
    def test_robot_comes_back(self):
        robot = linear_robot().with_effects(
            ef.TransmissionError(1, [3e-5, 1e-5], 161.5, (1, 2), [0.1, 0.2]), ef.GearHysteresis(1, 3.0, 2e-4)
        )
        again = jf.robot.robot_from_table(jf.robot.table_from_robot(robot))
        assert [type(e) for e in again.effects] == [type(e) for e in robot.effects]
        point = lambda r: jf.robot.operating_point(r, np.array([[0.5, 0.3, -0.4]])).z
        np.testing.assert_array_equal(point(again), point(robot))

    def test_where_they_cannot_act(self):
        robot = robot_of(arm(), wrist(stiffness=np.inf))
        for effect in (
            ef.TransmissionError(1, [3e-5], 80.0, (1,)),
            ef.StructuralDamping("joint2", 0.02),
            ef.GearHysteresis(1, 3.0),
        ):
            with pytest.raises(jf.InputError, match=r"joint2 of .*rigid transmission"):
                robot.with_effects(effect)
        coupled = robot.with_effects(ef.WristCoupling(1, 0.02))  # for torques along a motion, but not to be simulated
        with pytest.raises(jf.InputError, match=r"joint2 of .*rigid transmission"):
            jf.robot.operating_point(coupled, np.zeros(2))
        with pytest.raises(jf.InputError, match=r"found joint1, the first axis; expected an axis with another"):
            robot.with_effects(ef.WristCoupling(0, 0.02))
