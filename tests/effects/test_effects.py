"""Effects: laws against their equations, the simulation against plain NumPy, the linearised robot, and files."""

import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy.integrate
import scipy.signal

import jaxfrf as jf
from jaxfrf import effects as ef
from jaxfrf.effects._harmonics import harmonics
from jaxfrf.robot import with_parameters
from jaxfrf.robot.tolerances import DEFAULTS

KEY = jr.key(1)
AXIS = {"axis": [0.0, 0.0, 1.0], "offset": [0.0, 0.0, 0.0], "com": [0.0, 0.0, 0.0]}


def one_joint(**options):
    """Two masses and a spring: motor 1e-3 kg m^2 behind a gear of 50, arm 2.5 kg m^2, no gravity."""
    joint = AXIS | {"name": "joint1", "type": "driven", "mass": 1.0, "inertia": [1.0, 1.0, 2.5, 0.0, 0.0, 0.0]}
    joint |= {"gear_ratio": 50.0, "motor_inertia": 1e-3, "stiffness": 5e4, "damping": 20.0}
    joint |= {"torque_limit": 20.0, "velocity_gain": 0.2, "viscous_friction": 1e-3, "coulomb_friction": 0.1}
    table = {"name": "one", "gravity": [0.0, 0.0, 0.0], "joint": [joint | options]}
    return jf.robot.robot_from_table(table | {"controller": {"position_gain": 5.0, "integral_time": 0.05}})


def plan(scale=1.0, **options):
    return jf.Multisine(2000.0, 2000, np.arange(5, 80, 2), rms=[scale * 4.0], slow=jf.SlowSine([1], [20.0]), **options)


def replay(data, forces, reading=lambda q: q, u=None, kept=2000, sub=10):
    """The two-mass ODE in NumPy under the recorded torque, from rest: measured motor position at the samples.

    `forces(motor angle, motor speed, arm angle, arm rate, torque)` = (motor, arm) accelerations."""
    torque = data.u[0, 0, :, 0] if u is None else u
    x, h, out = np.zeros(4), 1 / (2000 * sub), []
    rhs = lambda x, u: np.array([x[2], x[3], *forces(x[0], x[2], x[1], x[3], u)])
    for k in range(kept):
        out.append(reading(x[0]))
        for i in range(sub):
            now = torque(k + i / sub) if callable(torque) else torque[k]
            a = rhs(x, now)
            b = rhs(x + h / 2 * a, now)
            c = rhs(x + h / 2 * b, now)
            x = x + h / 6 * (a + 2 * b + 2 * c + rhs(x + h * c, now))
    return np.array(out)


def spring(qm, vm, qa, va):
    return 5e4 * (qm / 50 - qa) + 20.0 * (vm / 50 - va)


def record(robot):
    """From rest at zero, the fade-in recorded too, no noise."""
    return jf.simulate(
        robot, plan(transient_periods=1, ramp=1.0), np.zeros((1, 1)), key=KEY, run_in=None, noise=0.0, steps=10
    )


def close(data, angle, within):
    y = data.y[0, 0, : len(angle), 0]
    assert np.abs(y - angle).max() < within * np.abs(y).max()


class TestInTheSimulation:
    @pytest.mark.slow
    def test_friction_and_arm(self):
        robot = one_joint().with_effects(
            ef.CoulombFriction(0, 0.05),
            ef.ViscousFriction(0, 2e-3),
            ef.ArmViscousFriction("joint1", 8.0),
            ef.StribeckFriction(0, 0.06, 3.0, 0.5),
            ef.FrictionAsymmetry(0, 0.04, 0.03, 0.3),
            ef.LoadDependentFriction(0, 0.1, 0.4),
            ef.Counterbalance(0, 30.0, 0.0),
            ef.DressPack(0, 40.0, 0.0, 3.0),
            ef.TorqueRipple(0, [0.05, 0.03], [1, 6], [0.0, np.pi]),
        )

        def forces(qm, vm, qa, va, u):
            tau = spring(qm, vm, qa, va)
            rub = 3e-3 * vm + 0.15 * np.tanh(vm / 0.2) + 0.06 * np.exp(-((vm / 3.0) ** 2)) * np.tanh(vm / 0.5)
            rub += 0.04 + 0.03 * np.tanh(vm / 0.3) + 0.1 * abs(tau / 50) * np.tanh(vm / 0.4)
            ripple = 0.05 * np.sin(qm) + 0.03 * np.sin(6 * qm + np.pi)
            return (u + ripple - rub - tau / 50) / 1e-3, (tau - 11.0 * va - 70.0 * qa) / 2.5

        data = record(robot)
        close(data, replay(data, forces), 1e-5)

    @pytest.mark.slow
    def test_actuator(self):
        """Gain, clipping, delay and lag of the torque, one after the other."""
        robot = one_joint().with_effects(
            ef.TorqueConstant(0, 0.05), ef.TorqueSaturation(0, 0.6), ef.TorqueDelay(0, 7e-4), ef.CurrentLoopLag(0, 4e-4)
        )
        data = record(robot)
        u = data.u[0, 0, :, 0]
        clipped = np.clip(1.05 * u, -0.6, 0.6)
        assert np.any(1.05 * np.abs(u) > 0.6)

        def torque():
            """At the start of each tenth of a sample: 7e-4 s is 14 of them; the lag's mean over a step."""
            late = np.concatenate([np.zeros(14), np.repeat(clipped, 10)])[: 10 * len(u)]
            a, state, out = np.exp(-5e-5 / 4e-4), 0.0, []
            for x in late:
                out.append(x + (state - x) * 8.0 * (1 - a))
                state = x + (state - x) * a
            return np.array(out)

        line = torque()

        def forces(qm, vm, qa, va, u):
            tau = spring(qm, vm, qa, va)
            return (u - 1e-3 * vm - 0.1 * np.tanh(vm / 0.2) - tau / 50) / 1e-3, tau / 2.5

        close(data, replay(data, forces, u=lambda k: line[round(10 * k)]), 1e-9)

    def test_elastic_load(self):
        """The mean of each held step, against SciPy's step-invariant filter on steps that are much finer."""
        step, fine = 5e-4, 400
        load = ef.ElasticLoad(0, 40.0, 61.0, 0.03, 0.08)
        torque = np.random.default_rng(0).standard_normal(80)
        ours, _ = load.advance(load.start(jnp.zeros(()), step), jnp.asarray(torque), step)
        above, below = ([1 / w**2, 2 * z / w, 1.0] for w, z in ((80 * np.pi, 0.03), (122 * np.pi, 0.08)))
        through = scipy.signal.cont2discrete(scipy.signal.tf2ss(above, below), step / fine)
        held = np.repeat(torque, fine)
        _, out, _ = scipy.signal.dlsim(through, held)
        direct = through[3][0, 0] * np.diff(held, append=0.0)  # at a step's end, before the next one begins
        ends = np.append(out[1:, 0], out[-1, 0]) - direct
        theirs = ((out[:, 0] + ends) / 2).reshape(-1, fine).mean(axis=1)
        np.testing.assert_allclose(ours[:-1], theirs[:-1], atol=1e-7 * np.abs(theirs).max())

    def test_sensor(self):
        robot = one_joint().with_effects(ef.ResolverRipple(0, [5e-4, 1e-3], phase=[0.3, 0.1]))
        robot = robot.with_effects(ef.EncoderQuantisation(0, 1e-3))
        data = record(robot)

        def forces(qm, vm, qa, va, u):
            tau = spring(qm, vm, qa, va)
            return (u - 1e-3 * vm - 0.1 * np.tanh(vm / 0.2) - tau / 50) / 1e-3, tau / 2.5

        angle = replay(data, forces)
        rippled = angle + 5e-4 * np.sin(angle + 0.3) + 1e-3 * np.sin(2 * angle + 0.1)
        y = data.y[0, 0, :2000, 0]
        np.testing.assert_allclose(y / 1e-3, np.round(y / 1e-3), atol=1e-6)
        assert np.abs(y - rippled).max() < 5.1e-4

    @pytest.mark.slow
    def test_structure(self):
        robot = one_joint(viscous_friction=0.0, coulomb_friction=0.0).with_effects(
            ef.StiffnessHardening(0, 0.6, 2e-4),
            ef.Backlash(0, 1e-4),
            ef.MotorInertia(0, 2e-4),
            ef.Payload(2.0, np.array([0.3, 0.4, 0.7])),
        )

        def forces(qm, vm, qa, va, u):
            x, v, corner = qm / 50 - qa, vm / 50 - va, 5e-6
            log_cosh = lambda y: np.logaddexp(y, -y)
            beyond = x - 0.999 * corner / 2 * (log_cosh((x + 5e-5) / corner) - log_cosh((x - 5e-5) / corner))
            slope = 1 - 0.999 * (np.tanh((x + 5e-5) / corner) - np.tanh((x - 5e-5) / corner)) / 2
            tau = 5e4 * (beyond - 0.4 * 2e-4 * np.tanh(beyond / 2e-4)) + 20.0 * slope * v
            # A point mass of 2 kg at .5 m from the axis; the link's own mass sits on it.
            return (u - tau / 50) / 1.2e-3, tau / (2.5 + 2.0 * 0.25)

        data = record(robot)
        close(data, replay(data, forces, kept=1200), 1e-5)


class TestInTheLinearisation:
    @pytest.mark.slow
    def test_everything_that_is_linear(self):
        """LOG estimate of a small motion against the linearised robot, all exact effects together."""
        robot = one_joint(viscous_friction=0.0, coulomb_friction=0.0).with_effects(
            ef.TorqueDelay(0, 3.7e-4),
            ef.CurrentLoopLag(0, 3e-4),
            ef.TorqueConstant(0, 0.05),
            ef.ArmViscousFriction(0, 5.0),
            ef.DressPack(0, 500.0, 0.3, 1.0),
            ef.Counterbalance(0, -50.0, 0.1),
            ef.Payload(2.0, np.array([0.1, 0.4, 0.5])),
            ef.ExtraFlexibility(0, np.array([1.0, 0.0, 0.0]), 2e4, 15.0),
            ef.MotorInertia(0, 1e-4),
            ef.ViscousFriction(0, 1e-3),
            ef.StiffnessHardening(0, 0.6, 1e-2),
        )
        assert robot.dof == 3
        design = jf.Multisine(2000.0, 4000, np.arange(9, 320, 6), rms=[0.05])
        q = np.array([[0.4], [-0.2]])
        data = jf.simulate(robot, design, q, key=KEY, noise=0.0, run_in=8.0, steps=10)
        spectra = jf.with_output_quantity(jf.dft(data), "velocity")
        estimate = np.asarray(jf.estimate(spectra, jf.LogMean()).G)
        hold = jf.robot.ZeroOrderHold(2000.0, "position")
        model = jf.robot.linearise(robot, jf.robot.operating_point(robot, q))
        G = np.asarray(jf.robot.frf(model, spectra.frequency, hold=hold))
        assert np.abs(estimate / G - 1).max() < 3e-3
        slopes = jf.robot.frf_and_jacobian(robot, q, spectra.frequency, hold=hold)
        np.testing.assert_allclose(slopes.G, G, rtol=1e-9)
        bare = one_joint()
        plain = jf.robot.linearise(bare, jf.robot.operating_point(bare, q))
        assert plain.actuators == ()

    def test_factors(self):
        """Delay and lag as e^{-s tau}/(1 + s T), continuous."""
        bare = one_joint()
        robot = bare.with_effects(ef.TorqueDelay(0, 4e-4), ef.CurrentLoopLag(0, 3e-4), ef.TorqueConstant(0, -0.02))
        frequency = np.geomspace(1, 900, 50)
        G = lambda r: np.asarray(
            jf.robot.frf(jf.robot.linearise(r, jf.robot.operating_point(r, np.zeros((1, 1)))), frequency)
        )[0, :, 0, 0]
        s = 2j * np.pi * frequency
        np.testing.assert_allclose(G(robot) / G(bare), 0.98 * np.exp(-4e-4 * s) / (1 + 3e-4 * s), rtol=1e-11)

    def test_describing_gains(self):
        bare = one_joint()
        gain = lambda r, load=0.0: float(jf.robot.describing_friction(r, 30.0, load)[0]) - 1e-3
        assert gain(bare) == pytest.approx(2 * 0.1 / (np.pi * 30), rel=1e-12)
        more = bare.with_effects(ef.CoulombFriction(0, 0.05))
        assert gain(more) == pytest.approx(2 * 0.15 / (np.pi * 30), rel=1e-12)
        loaded = bare.with_effects(ef.LoadDependentFriction(0, 0.1))
        assert gain(loaded, -2.0) - gain(bare) == pytest.approx(2 * 0.2 / (np.pi * 30), rel=1e-4)
        assert gain(bare.with_effects(ef.FrictionAsymmetry(0, 0.3))) == pytest.approx(gain(bare), rel=1e-12)
        # The mean slope of the Stribeck hump over v = A sin(phi), by adaptive integration over the speed.
        law = lambda v: 0.06 * np.exp(-((v / 2.0) ** 2)) * np.tanh(v / 0.2)
        slope = lambda v: (law(v + 1e-6) - law(v - 1e-6)) / 2e-6 / np.sqrt(900 - v**2) / np.pi
        expected = scipy.integrate.quad(slope, -12, 12, limit=500, points=[0.0])[0]
        hump = ef.StribeckFriction(0, 0.06)
        assert gain(bare.with_effects(hump)) - gain(bare) == pytest.approx(expected, rel=1e-4, abs=1e-9)


def test_harmonics():
    angle, order = np.linspace(-400, 400, 999), (1, 2, 6, 18, 37)
    amplitude, phase = np.arange(1.0, 6.0), np.linspace(-2, 2, 5)
    expected = sum(a * np.sin(h * angle + p) for a, h, p in zip(amplitude, order, phase, strict=True))
    np.testing.assert_allclose(harmonics(amplitude, order, phase, jnp.asarray(angle)), expected, atol=1e-11)


@pytest.mark.slow
def test_gradients():
    """Through the linearised robot, in the parameters of effects of every kind, against differences."""
    frequency, bare = jnp.array([5.0, 20.0, 60.0]), one_joint()

    @jax.jit
    def size(x):
        delay, error, viscous, ratio, mass = x
        robot = bare.with_effects(
            ef.TorqueDelay(0, delay),
            ef.TorqueConstant(0, error),
            ef.ArmViscousFriction(0, viscous),
            ef.StiffnessHardening(0, ratio),
            ef.Payload(mass, jnp.array([0.3, 0.0, 0.0])),
        )
        G = jf.robot.frf(jf.robot.linearise(robot, jf.robot.operating_point(robot, jnp.zeros((1, 1)))), frequency)
        return jnp.sum(jnp.real(G * jnp.exp(0.3j)))

    x = jnp.array([3e-4, 0.02, 5.0, 0.7, 1.0])
    for i, slope in enumerate(jax.grad(size)(x)):
        step = 1e-5 * x[i]
        change = size(x.at[i].add(step)) - size(x.at[i].add(-step))
        assert float(slope) == pytest.approx(float(change / (2 * step)), rel=1e-5)


class TestLibrary:
    def test_names(self):
        """The names that other programs rely on."""
        promised = """coulomb_friction viscous_friction arm_viscous_friction stribeck_friction friction_asymmetry
            load_dependent_friction torque_ripple resolver_ripple torque_delay current_loop_lag backlash
            stiffness_hardening torque_constant motor_inertia payload counterbalance extra_flexibility
            torque_saturation encoder_quantisation dress_pack
            transmission_error structural_damping gear_hysteresis wrist_coupling sensor_delay elastic_load"""
        assert set(promised.split()) <= set(ef.library())

    @pytest.mark.parametrize("name", ef.library())
    def test_every_effect(self, name):
        """States what it must, fits the joints of R3X, starts inside its bounds, and comes back from a file."""
        kind, robot = ef.library()[name], jf.robot.r3x()
        assert set(kind.units) == set(kind.bounds) <= set(inspect.signature(kind).parameters)
        assert kind.signature and kind.confusable and "In data:" in kind.__doc__
        for axis in (1, 5):  # the first axis has none before it to be coupled with
            effect = kind.typical(robot, robot.axis_names[axis])
            for key, (low, high) in kind.bounds.items():
                value = getattr(effect, key)
                assert value is None or np.all((np.asarray(value) >= low) & (np.asarray(value) <= high)), key
            table = ef.effect_to_table(effect, robot.axis_names[axis])
            again = ef.effect_from_table(table)
            assert type(again) is kind and again.joint == robot.axis_names[axis]
            for key in kind.units:
                if getattr(effect, key) is not None:
                    np.testing.assert_allclose(getattr(again, key), getattr(effect, key))
            equipped = robot.with_effects(effect)
            assert equipped.n_axes == 6

    def test_a_spring_that_hardens_gives_its_stiffness_another_meaning(self):
        """Of joint4, which was straight, it is that at high deflection then; joint1 hardens already, its own stays."""
        robot = jf.robot.r3x()
        redefined = [ef.StiffnessHardening(joint, 0.5).redefines(robot) for joint in ("joint4", "joint1")]
        assert redefined == [("joint4.stiffness",), ()]
        assert not ef.StribeckFriction("joint4", 0.1).redefines(robot)

    def test_unknown_joint(self):
        with pytest.raises(jf.InputError, match=r"found 'joint7'; expected a driven joint"):
            jf.robot.r3x().with_effects(ef.TorqueDelay("joint7", 1e-4))
        with pytest.raises(jf.InputError, match=r"rigid transmission"):
            one_joint(stiffness=np.inf).with_effects(ef.Backlash(0, 1e-4))

    def test_a_long_delay(self):
        """What a fit found comes back from its file, beyond the 2 ms that are kept by default, too; not what seems to
        be no seconds."""
        found = ef.TorqueDelay("joint2", jnp.asarray(2.0021e-3))
        again = ef.effect_from_table(ef.effect_to_table(found, "joint2"))
        kept = [effect.longest for effect in (again, ef.TorqueDelay(0, 2e-3), ef.TorqueDelay(0, 1e-3, 5e-3))]
        assert kept == [3e-3, 2e-3, 5e-3]
        assert float(again.delay) == pytest.approx(2.0021e-3)
        line = jnp.arange(1.0, 41.0)
        late, _ = again.advance(again.start(line[0], 1e-4) * 0.0, line, 1e-4)
        np.testing.assert_allclose(late[25:], line[25:] - 20.021, rtol=1e-12)
        with pytest.raises(jf.InputError, match=r"delay: found 0.4 s; expected 0 to longest = 0.02 s. State it in sec"):
            ef.TorqueDelay(0, 0.4)
        with pytest.raises(jf.InputError, match=r"delay: found -0.1 s"):
            ef.TorqueDelay(0, -0.1)


def test_a_hump_that_turns_otherwise_does_nearly_the_same():
    """No other level and width of a grid come nearer, where the hump turns as the robot's friction does."""
    robot = jf.robot.r3x()
    own = float(robot.drives.friction.smoothing)
    wide = ef.StribeckFriction("joint2", 1.8, 1.4, 3.0 * own)
    (other,) = wide.elsewhere(robot)
    assert float(other.smoothing) == own and other.joint == "joint2"
    speed = np.linspace(0.0, 5.6, 500)
    missed = lambda level, width: np.linalg.norm(
        level * np.exp(-((speed / width) ** 2)) * np.tanh(speed / own)
        - 1.8 * np.exp(-((speed / 1.4) ** 2)) * np.tanh(speed / (3.0 * own))
    )
    grid = min(missed(level, width) for level in np.linspace(0.5, 2.0, 151) for width in np.linspace(1.0, 3.0, 201))
    assert missed(float(other.level), float(other.width)) < 1.001 * grid < 0.25 * missed(0.0, 1.0)
    for nothing_else in (ef.StribeckFriction("joint2", 1.8, 1.4, 1.2 * own), ef.TorqueDelay("joint2", 1e-3)):
        assert nothing_else.elsewhere(robot) == ()


def test_further_starts_of_what_numbers_imitate():
    """On a joint of the robot, of plausible size, beside kinds of numbers that a robot has."""
    robot = jf.robot.r3x()
    for kind in ef.library().values():
        starts = kind.starts(robot, robot, "joint2")
        assert bool(starts) == bool(kind.imitated_by), kind.name
        assert set(kind.imitated_by) <= set(DEFAULTS)
        for start in starts:
            assert start.joint == "joint2"
            assert all(low <= getattr(start, name) <= high for name, (low, high) in kind.bounds.items())
            robot.with_effects(start)


def test_a_damper_of_the_arm_begins_with_what_the_motor_had_in_its_place():
    robot = jf.robot.r3x()
    given, gear = (float(x[1]) for x in (robot.drives.friction.viscous, robot.drives.gear_ratio))
    fitted = with_parameters(robot, {"joint2.viscous_friction": 3.0 * given})
    (start,) = ef.ArmViscousFriction.starts(robot, fitted, "joint2")
    assert float(start.coefficient) == pytest.approx(2.0 * given * gear**2)
    assert ef.ArmViscousFriction.starts(fitted, robot, "joint2") == (ef.ArmViscousFriction.typical(fitted, "joint2"),)


@pytest.mark.parametrize("scale", [1e-2, 1.0, 30.0])
def test_flexibilities_are_looked_for_about_the_joints_own_stiffness(scale):
    """From half of it to far above, whatever the robot's size: a link of the compliance of its gear is among them."""
    robot = jf.robot.r3x()
    robot = eqx.tree_at(lambda r: r.springs.stiffness, robot, robot.springs.stiffness * scale)
    for axis, joint in enumerate(robot.axis_names):
        own = float(robot.springs.stiffness[axis])
        tried = ef.ExtraFlexibility.candidates(robot, joint, 10.0)
        reach = [(c.make((c.high[0],)).stiffness, c.make((c.low[0],)).stiffness) for c in tried]
        assert {tuple(np.abs(c.basis[0].axis)) for c in tried} == {
            tuple(x)
            for x in np.eye(3)
            if np.linalg.norm(np.cross(x, robot.chain.axis[robot.driven_joints[axis]])) > 0.5
        }
        for stiffness in np.geomspace(0.3, 20.0, 12) * own:
            assert any(low <= stiffness <= high for low, high in reach)
