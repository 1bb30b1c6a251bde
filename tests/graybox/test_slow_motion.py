"""The response of an arm that moves slowly: against time-domain simulations, and its pieces against NumPy."""

import dataclasses

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from marks import slow
from two_axes import ROBOT

import jaxfrf as jf
from jaxfrf.graybox.indirect import measured_frf
from jaxfrf.graybox.slow_motion import SlowMotion, moving_response, slow_motion
from jaxfrf.io.robots import read_robot
from jaxfrf.robot import Controller, with_parameters
from jaxfrf.simulation.controller import Cascade, ControllerState

FS, PERIOD = 500.0, 4000
TURN = np.array([0.25, 0.4])  # of the arm by the slow sines, rad
LINES = np.arange(25, 481, 2)  # 3.1 to 60 Hz
SLOW = [3, 5]  # .4 and .6 Hz


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """Linear but for what the arm's own motion changes, and lightly damped."""
    path = tmp_path_factory.mktemp("robot") / "robot.toml"
    path.write_text(ROBOT)
    light = {"shoulder.damping": 8.0, "elbow.damping": 3.0}
    still = {"shoulder.coulomb_friction": 0.0, "elbow.coulomb_friction": 0.0}
    return with_parameters(read_robot(path), light | still)


def played(robot, slow: bool, q, blocks=2, seed=0):
    amplitude = TURN * np.asarray(robot.drives.gear_ratio) * 2 * np.pi * np.array(SLOW) * FS / PERIOD
    sines = jf.SlowSine(SLOW, list(amplitude)) if slow else None
    design = jf.Multisine(FS, PERIOD, LINES, rms=np.array([4.0, 4.0]), slow=sines, blocks=blocks, seed=seed)
    return jf.simulate(robot, design, q, key=jr.key(1), noise=0.0)


@pytest.fixture(scope="module")
def moving(robot):
    return played(robot, True, np.array([[0.3, 0.9], [-0.8, 1.6]]))


def values_of(model) -> dict:
    return {name: float(p.start) for name, p in model.parameters.items()}


class TestWhereTheArmWas:
    def test_angles(self, robot, moving):
        slow = slow_motion(robot, moving, 1.5)
        about = slow.q - moving.q[:, None]
        assert np.abs(about.mean(axis=1)).max() < 0.05 * TURN.min()
        np.testing.assert_allclose(about.std(axis=1), np.tile(TURN / np.sqrt(2), (2, 1)), rtol=0.05)
        np.testing.assert_allclose(np.abs(about).max(axis=1), np.tile(TURN, (2, 1)), rtol=0.05)
        # The two sines are independent: no place of one belongs to a place of the other.
        assert np.abs([np.corrcoef(a.T)[0, 1] for a in about]).max() < 0.1

    def test_torque(self, robot, moving):
        """Power of the slow part from the record's own lines; the samples of the rest have the power of the others."""
        slow = slow_motion(robot, moving, 1.5)
        drives, s = robot.drives, 2j * np.pi * np.fft.rfftfreq(PERIOD, 1 / FS)[:, None]
        U, Y = (np.fft.rfft(np.asarray(x)[:, :, -PERIOD:], axis=2) / PERIOD for x in (moving.u, moving.y))
        T = np.asarray(drives.gear_ratio) * (U - (drives.motor_inertia * s**2 + drives.friction.viscous * s) * Y)
        power = 2 * np.mean(np.abs(T) ** 2, axis=1)  # (pos, line, axis)
        np.testing.assert_allclose(slow.torque.var(axis=1), power[:, 1:13].sum(axis=1), rtol=0.05)
        fast = power[:, 13:961].sum(axis=1)  # 144 samples: a tenth of scatter each
        assert np.abs(np.log(slow.fast.var(axis=1) / fast)).mean() < 0.25

    def test_every_quantity(self, robot, moving):
        """A record of speeds says the same as one of positions."""
        s = 2j * np.pi * np.fft.rfftfreq(PERIOD, 1 / FS)[:, None]
        Y = np.fft.rfft(np.asarray(moving.y)[:, :, -PERIOD:], axis=2)
        speed = np.fft.irfft(s * Y, PERIOD, axis=2)
        one = jf.Experiment(
            u=np.asarray(moving.u)[:, :, -PERIOD:],
            y=speed,
            r=np.asarray(moving.r)[:, :, -PERIOD:],
            q=moving.q,
            fs=FS,
            period=PERIOD,
            lines=LINES,
            y_quantity="velocity",
        )
        two, three = slow_motion(robot, one, 1.5), slow_motion(robot, moving, 1.5)
        np.testing.assert_allclose(two.q, three.q, atol=1e-9)
        np.testing.assert_allclose(two.torque, three.torque, atol=1e-6 * np.abs(three.torque).max())

    def test_an_arm_at_rest(self, robot, moving):
        assert slow_motion(robot, played(robot, False, moving.q), 1.5) is None


class TestController:
    @pytest.mark.parametrize(
        ("corner", "sensor"), [slow(None, False), slow(None, True), slow(40.0, False), ([30.0, 90.0], False)]
    )
    def test_feedback_against_the_sampled_law(self, robot, corner, sensor):
        """A sine through the controller's own difference equation, until it is steady."""
        filtered = None if corner is None else np.array(corner)
        robot = dataclasses.replace(
            robot, controller=dataclasses.replace(robot.controller, speed_filter=filtered, speed_sensor=sensor)
        )
        cascade = Cascade.of(robot)
        period, line = 250, 7
        angle = np.exp(2j * np.pi * line * np.arange(4 * period) / period)
        torques = []
        speed = 2j * np.pi * line * FS / period * angle
        for part, rate in ((angle.real, speed.real), (angle.imag, speed.imag)):
            state = ControllerState(jnp.full((2, 1), part[0]), jnp.zeros((2, 1)), jnp.zeros((2, 1)))
            zero, out = jnp.zeros((2, 1)), []
            for x, v in zip(part, rate, strict=True):
                u, state = cascade.torque(state, jnp.full((2, 1), x), jnp.full((2, 1), v), zero, zero)
                out.append(np.asarray(u)[:, 0])
            out = np.array(out)[-period:]
            torques.append(out - out.mean(axis=0))  # the sum keeps what the start left in it
        found = (torques[0] + 1j * torques[1]) * np.exp(-2j * np.pi * line * np.arange(period) / period)[:, None]
        expected = robot.controller.feedback(np.array([line * FS / period]), FS)[0]
        np.testing.assert_allclose(-found.mean(axis=0), expected, rtol=1e-9)

    def test_without_integral(self):
        held = Controller(np.array(4.0), np.array(np.inf), np.array([0.5]))
        w = 2 * np.pi * 3.0
        found = held.feedback(np.array([3.0]), 1e6)[0, 0]  # so fast that it is continuous
        np.testing.assert_allclose(found, 0.5 * (4.0 + 1j * w), rtol=1e-4)


class TestResponse:
    def test_against_numpy(self, robot):
        """<G W> <W>^-1 over places whose G come from the state space."""
        from jaxfrf.robot import discretise, linearise, operating_point, state_space, state_space_frf

        model = jf.RobotModel(robot, quantity="position")
        frequency, q = np.array([4.0, 11.0, 23.0]), np.array([[0.3, 0.9]])
        places = q + np.array([[-0.2, 0.3], [0.0, -0.3], [0.2, 0.1]])
        none = np.zeros((1, 3, 2))
        slow = SlowMotion(places[None], none, np.zeros((1, 1, 2)))
        found = moving_response(model, values_of(model), frequency, q, slow)[0]
        friction = np.array([values_of(model)[f"{axis}.effective_friction"] for axis in robot.axis_names])
        linear = linearise(robot, operating_point(robot, places), friction)
        G = np.asarray(state_space_frf(discretise(state_space(linear, "position"), FS), frequency))
        C = np.asarray(robot.controller.feedback(frequency, FS))
        for f in range(3):
            W = [np.linalg.inv(np.eye(2) + np.diag(C[f]) @ g[f]) for g in G]
            mean = sum(g[f] @ w for g, w in zip(G, W, strict=True)) @ np.linalg.inv(sum(W))
            np.testing.assert_allclose(found[f], mean, rtol=2e-4)

    @pytest.mark.slow
    def test_one_place_is_the_response_there(self, robot):
        model, q = jf.RobotModel(robot), np.array([[0.3, 0.9]])
        slow = SlowMotion(q[:, None], np.zeros((1, 1, 2)), np.zeros((1, 1, 2)))
        frequency = np.array([4.0, 11.0])
        found = moving_response(model, values_of(model), frequency, q, slow)[0]
        np.testing.assert_allclose(found, model.response(frequency, values_of(model), jnp.asarray(q[0])), rtol=1e-9)

    @pytest.mark.slow
    def test_what_an_experiment_measures(self, robot, moving):
        """The arm turns by a quarter of a radian: its FRF is that of all places, not of the middle."""
        model = jf.RobotModel(robot)
        frf = measured_frf(moving, jf.JointInputOutput(jf.H1()), "acceleration")
        slow = slow_motion(robot, moving, 1.5)
        values = values_of(model)
        places = moving_response(model, values, frf.frequency, moving.q, slow)
        rest = np.stack([model.response(frf.frequency, values, jnp.asarray(q)) for q in moving.q])
        diagonal = lambda x: np.diagonal(x, axis1=-2, axis2=-1)
        miss = lambda model: np.sqrt(np.mean(np.abs(np.log(diagonal(model) / diagonal(np.asarray(frf.G)))) ** 2))
        assert miss(rest) > 0.08
        assert miss(places) < 0.4 * miss(rest)


class TestFit:
    @pytest.mark.slow
    def test_bias_of_a_moving_arm(self, robot, moving):
        """Damping of a robot that is exactly the model: what the motion smears, the direct fit takes out."""
        start = with_parameters(robot, {"shoulder.stiffness": 2.3e4, "elbow.stiffness": 7e3, "elbow.damping": 5.0})
        model = jf.RobotModel(start)
        frf = measured_frf(moving, jf.JointInputOutput(jf.LRM()), "acceleration")
        plain = jf.fit(model, frf, starts=2)
        found = jf.fit_in_motion(model, moving, frf, starts=2)
        true = {name: float(v) for name, v in jf.robot.parameters(robot).items()}
        off = lambda fitted: np.mean([abs(fitted.values[n] / v - 1) for n, v in true.items() if n.endswith("damping")])
        print(f"damping off by {100 * off(plain):.1f} %, in motion {100 * off(found):.1f} %")
        assert off(plain) > 0.1
        assert off(found) < 0.35 * off(plain)
        assert found.cost < plain.cost
