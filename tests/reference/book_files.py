"""The files that the book's pages and the README take for granted, small: records, a robot, a motion, a bench."""

import pathlib

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import scipy.io

import jaxfrf as jf

FS = 500.0

JOINT = """
[[joint]]
name = "joint{n}"
type = "driven"
axis = [0.0, 1.0, 0.0]
offset = [{offset}, 0.0, 0.0]
mass = {mass}
com = [0.22, 0.0, 0.0]
inertia = [0.01, {inertia}, {inertia}, 0.0, 0.0, 0.0]
gear_ratio = 100.0
motor_inertia = 2.0e-4
stiffness = {stiffness}
damping = {damping}
viscous_friction = 2.0e-3
coulomb_friction = 0.05
torque_limit = 50.0
velocity_gain = 0.02
"""
CONTROLLER = "\n[controller]\nposition_gain = 8.0\nintegral_time = 0.2\n"
ROBOT = (
    'name = "two axes"\ngravity = [0.0, 0.0, -9.81]\nsampling_frequency = 500.0\n'
    + JOINT.format(n=5, offset=0.0, mass=8.0, inertia=0.2, stiffness=2e4, damping=25.0)
    + JOINT.format(n=6, offset=0.5, mass=4.0, inertia=0.1, stiffness=8e3, damping=8.0)
)

LINK = """<link name="link_{n}"><inertial><mass value="{mass}"/><origin xyz="0.2 0 0"/>
<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
<joint name="joint_{n}" type="revolute"><parent link="{parent}"/><child link="link_{n}"/>
<origin xyz="{offset} 0 0"/><axis xyz="0 1 0"/></joint>"""
URDF = (
    '<robot name="arm"><link name="base"/>'
    + LINK.format(n=1, mass=3.0, parent="base", offset=0)
    + LINK.format(n=2, mass=2.0, parent="link_1", offset=0.4)
    + "</robot>"
)
DRIVE = """[[joint]]
name = "joint_{n}"
gear_ratio = 50.0
motor_inertia = 1e-4
viscous_friction = 1e-3
coulomb_friction = 0.03
stiffness = inf
"""
DRIVES = (
    'urdf = "arm.urdf"\nsampling_frequency = 1000.0\n' + DRIVE.format(n=1) + DRIVE.format(n=2)
) + '[friction]\nsmoothing = 0.5\n[tolerance]\nfriction = "unknown"\n'


def write(folder: pathlib.Path, wanted: str) -> None:
    """Write into the folder what a text names, and nothing else."""
    makers = {
        "robot.toml": _robot,
        "without_controller.toml": _robot,
        "run1.nc": _runs,
        "run.nc": _runs,
        "frf.nc": _frf,
        "frf_a.nc": _drives,
        "sides1.csv": _sides,
        "empty.nc": _payload,
        "log.mat": _log,
        "logs/*.mat": _log,
        "angles.csv": _tables,
        "bend1.csv": _bends,
        "motion.csv": _motion,
        "bench.nc": _bench,
    }
    needed = [maker for name, maker in makers.items() if name in wanted]
    if _motion in needed:  # another robot.toml
        needed = [_motion]
    for maker in dict.fromkeys(needed):
        maker(folder)


def _robot(folder):
    (folder / "robot.toml").write_text(ROBOT + CONTROLLER)
    (folder / "without_controller.toml").write_text(ROBOT)
    return jf.io.read_robot(folder / "robot.toml")


def _played(robot, seed, positions=3, blocks=1):
    slow = jf.SlowSine([1, 2], [25.0, 25.0])
    design = jf.Multisine(FS, 1000, np.arange(7, 121, 2), rms=np.array([4.0, 4.0]), slow=slow, blocks=blocks, seed=seed)
    return jf.simulate(robot, design, jf.random_positions(positions, jr.key(seed), 2), key=jr.key(9), noise=2e-5)


def _runs(folder):
    robot = _robot(folder)
    machine = jf.robot.with_parameters(robot, {"joint5.stiffness": 1.8e4, "joint6.damping": 10.0})
    for name, seed in (("run1.nc", 1), ("run2.nc", 2), ("run.nc", 3)):
        jf.io.write(folder / name, _played(machine, seed))


def _frf(folder):
    jf.io.write_frf(folder / "frf.nc", jf.estimate(jf.example(blocks=3), jf.Auto()))


def _drives(folder):
    """One inertia with a lag."""
    f = np.arange(10.0, 200.0, 2.0)
    s, one = 2j * np.pi * f, np.ones((1, len(f)))
    for name, seed in (("frf_a.nc", 1), ("frf_b.nc", 2)):
        noise = np.random.default_rng(seed).standard_normal((2, len(f)))
        G = 100.0 / s / (1.0 + 1e-3 * s) * (1.0 + 0.01 * (noise[0] + 1j * noise[1]))
        cov = (0.014 * np.abs(G)) ** 2 + 0j
        frf = jf.FRF(G[None, :, None, None], f, cov[None, :, None, None], 20 * one, 0 * one.astype(int), one)
        jf.io.write_frf(folder / name, frf)


def _sides(folder):
    """A spring behind a motor, and a link encoder that is logged late."""
    t = np.arange(2500) / 250.0
    for name, f in (("sides1.csv", 0.7), ("sides2.csv", 0.9)):
        q, v, a = (np.sin(2 * np.pi * f * t + k * np.pi / 2) * (2 * np.pi * f) ** k for k in range(3))
        u = 3 * np.sin(2 * q) + 0.4 * a + np.tanh(v)
        table = np.column_stack([u, q, q - 5e-5 * u - 2e-3 * v])
        np.savetxt(folder / name, table, delimiter=",", header="torque,motor,link", comments="")


def _payload(folder):
    robot = _robot(folder)
    payload = jf.effects.Payload(mass=5.0, place=np.array([0.0, 0.0, 0.12]))
    jf.io.write(folder / "empty.nc", _played(robot, 4))
    jf.io.write(folder / "loaded.nc", _played(robot.with_effects(payload), 4))


def _log(folder):
    """Two axes under the names of a log, three periods of which the first is transient."""
    (folder / "logs").mkdir(exist_ok=True)
    for name, period, fs in (("log.mat", 56000, 2000.0), ("logs/a.mat", 8000, 2000.0), ("logs/b.mat", 8000, 2000.0)):
        rng = np.random.default_rng(len(name) + period)
        lines = np.arange(period // 500, period // 40, 2 * (period // 8000) + 1)
        spectrum = np.zeros((2, period // 2 + 1), complex)
        spectrum[:, lines] = np.exp(2j * np.pi * rng.random((2, len(lines))))
        s = 2j * np.pi * np.arange(period // 2 + 1) * fs / period
        response = 1 / (0.002 * s + 0.05) * (s**2 + s + 2e3) / (s**2 + 2 * s + 5e3)
        u, y = (np.tile(np.fft.irfft(x, period).T, (3, 1)) * 100 for x in (spectrum, spectrum * response))
        y = y + 1e-3 * rng.standard_normal(y.shape)
        contents = {"tau1": u[:, 0], "tau2": u[:, 1], "v_ref": u, "rec": {"motor_speed": y}}
        scipy.io.savemat(folder / name, contents)


def _tables(folder):
    rng = np.random.default_rng(0)
    u = rng.standard_normal((3000, 2))
    y = np.zeros_like(u)
    for k in range(1, len(u)):
        y[k] = 0.95 * y[k - 1] + 0.05 * u[k - 1]
    np.savetxt(folder / "currents.csv", u, delimiter=",", header="tau1,tau2", comments="")
    np.savetxt(folder / "angles.csv", y, delimiter=",", header="q1,q2", comments="")


def _bends(folder):
    """Two experiments at each of two positions, the joints' angles in degrees beside torques and speeds."""
    heading = "M1 [Nm],M2 [Nm],V1 [rad/s],V2 [rad/s],Pos1 [deg],Pos2 [deg]"
    for place, at in enumerate(([20.0, -40.0], [60.0, -10.0])):
        data = jf.example(blocks=1, seed=place)
        for k in range(2):
            q = at + np.rad2deg(np.cumsum(data.y[0, k], axis=0) / data.fs / 100.0)  # behind gears of 100
            table = np.column_stack([data.u[0, k], data.y[0, k], q])
            name = folder / f"bend{2 * place + k + 1}.csv"
            np.savetxt(name, table, delimiter=",", header=heading, comments="")


def _motion(folder):
    """A rigid arm of two joints on smooth waves: angles and torques of its motors."""
    (folder / "arm.urdf").write_text(URDF)
    (folder / "robot.toml").write_text(DRIVES)
    robot = jf.io.read_robot(folder / "robot.toml")
    t = np.arange(12000) / 1000.0
    waves = [[(0.8, 0.35, 0.0), (0.3, 0.9, 1.0)], [(0.6, 0.5, 0.4), (0.3, 1.3, 2.0)]]
    q = np.stack([sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in joint) for joint in waves], axis=1)
    rate = np.gradient(q, t, axis=0)
    acceleration = np.gradient(rate, t, axis=0)
    arm = np.asarray(jf.robot.inverse_dynamics(robot.chain, q, rate, acceleration))
    u = arm / 50 + 1e-4 * 50 * acceleration + 2e-3 * 50 * rate + 0.06 * np.tanh(50 * rate / 0.5)
    u += 0.005 * np.random.default_rng(0).standard_normal(u.shape)
    table = np.column_stack([u, 50 * q])
    np.savetxt(folder / "motion.csv", table, delimiter=",", header="tau1,tau2,theta1,theta2", comments="")


def _bench(folder):
    """Two masses and a cubic coupling under a multisine: torque on the motor, speed of the motor."""
    from jaxfrf.machine import CubicSpring, Machine, simulate_machine

    def matrices(v):
        c = jnp.array([[1.0, -1.0], [-1.0, 1.0]])
        return v["m"] * jnp.eye(2), 0.01 * c + jnp.diag(jnp.array([0.01, 0.0])), 100.0 * c

    places = {"coupling": [1.0, -1.0], "motor": [1.0, 0.0]}
    machine = Machine(matrices, {"m": jf.Parameter(1e-3)}, inputs=[[1.0], [0.0]], outputs=[[1.0, 0.0]], places=places)
    t = np.arange(500) / FS
    rng = np.random.default_rng(0)
    u = sum(0.05 * np.cos(2 * np.pi * k * t + rng.uniform(0, 6)) for k in range(3, 91, 2))
    one = jf.Experiment(np.tile(u, 2)[:, None], np.zeros((1000, 1)), FS, 500, y_quantity="velocity")
    y = np.asarray(simulate_machine(machine.with_effects(CubicSpring("coupling", 1e4)), one, settle=8, steps=2))
    y = np.tile(y.reshape(500, 1), (2, 1)) + 1e-4 * rng.standard_normal((1000, 1))
    jf.io.write(folder / "bench.nc", jf.Experiment(np.tile(u, 2)[:, None], y, FS, 500, y_quantity="velocity"))
