"""Records of closed-loop experiments with MuJoCo as the simulator: data that jaxfrf's own simulator did not make.

Shared with `jaxfrf.simulate` are the robot's numbers, the references and what a sample means. Everything that moves is
MuJoCo's: rotors as bodies of their own, its kinematics and inertia, its integrator, its law of friction
(`frictionloss`: full stiction by its constraint solver, viscous below a slip speed, constant above). Spring shapes,
ripple and the other effects of `jaxfrf.effects` are evaluated by NumPy code of their own, in `_mujoco_loop`.
"""

import dataclasses
import os
import pathlib
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable

import mujoco
import numpy as np

import jaxfrf as jf
from jaxfrf import effects
from jaxfrf.effects._place import axis_of
from jaxfrf.io.mjcf import mjcf

_LOOP = pathlib.Path(__file__).with_name("_mujoco_loop.py")
_STICK = 1e-3  # s in which a motor below its slip speed comes to rest, the time constant of MuJoCo's friction
_PAST = 40.0  # time constants and samples of the past that a lag remembers


@dataclasses.dataclass(frozen=True)
class Ripple:
    """Ripple of all axes: amplitude, whole order and phase, each (axis, order), of torque (N m) and resolver (rad)."""

    torque: tuple[np.ndarray, np.ndarray, np.ndarray]
    resolver: tuple[np.ndarray, np.ndarray, np.ndarray]


def r3x_ripple(seed: int = 0, torque_order=(1, 2, 6, 18), resolver_order=(1, 2)) -> Ripple:
    """The proposed ripple of R3X: 10-50 mN m on axes 1-3, less on the wrist, .5 and 1 mrad of the resolvers.

    Phases are drawn once for each motor. Other orders than the default ones are not in the effects' own start list.
    """
    rng = np.random.default_rng([seed, 3])
    scale, amplitude = np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.07]), np.array([0.03, 0.02, 0.05, 0.03])
    rows = lambda x: np.tile(np.asarray(x, float), (6, 1))
    phases = lambda n: rng.uniform(-np.pi, np.pi, (6, n))
    return Ripple(
        (scale[:, None] * amplitude, rows(torque_order), phases(4)),
        (rows([5e-4, 1e-3]), rows(resolver_order), phases(2)),
    )


R3X_RIPPLE = r3x_ripple()


def mujoco_experiment(
    robot: jf.robot.Robot,
    design: jf.Multisine,
    positions,
    *,
    seed: int,
    run_in: float = 5.0,
    noise: float = 5e-5,
    ripple: Ripple | None = R3X_RIPPLE,
    substeps: int = 2,
    integrator: str = "RK4",
    stick: float = _STICK,
    chunk: int = 21,
    processes: int = 2,
    progress: Callable[[float], None] | None = None,
) -> jf.Experiment:
    """The record that `jaxfrf.simulate(robot, design, positions, run_in=run_in, ...)` makes, by MuJoCo.

    **Arguments:**

    - `seed`: of the noise; a run's noise depends on its position's and experiment's number only.
    - `ripple`: beside what `robot.effects` says; `None`: only that.
    - `substeps`: MuJoCo's steps in a control sample. `integrator`: "RK4" or "implicitfast". Error of R3X's torque
      against 32 substeps of RK4, all effects on: 2.8e-4, 7e-5, 1.7e-5 with 1, 2, 4 substeps of RK4, 3e-3 with 8 of
      implicitfast (relative rms, worst axis).
    - `stick`: time constant of MuJoCo's friction below the slip speed, s; the slip speed of a motor is about
      c stick/(2 J). At least two substeps.
    - `chunk`: runs that a process steps side by side.
    - `progress`: called with the part of the first process that is done.

    All effects of `jaxfrf.effects.library()` act, and those of `_outside_effects`.

    **Raises:** `ValueError` for a robot without equilibrium at a position, or an effect unknown here; `RuntimeError`
    with the run where one leaves its reference.
    """
    job = _job(robot, design, np.asarray(positions, float), run_in, ripple, substeps, integrator, stick)
    job |= {"seed": seed, "noise": noise, "chunk": chunk}
    u, y = _play(job, len(job["qpos"]) * design.n_exp, processes, progress)
    shape = (len(job["qpos"]), design.n_exp, *u.shape[1:])
    recorded = job["velocity"][:, int(job["run_in"]) :]
    return jf.Experiment(
        u=u.reshape(shape),
        y=y.reshape(shape),
        r=np.broadcast_to(recorded, (shape[0], *recorded.shape)),
        q=np.asarray(positions, float),
        fs=design.fs,
        period=design.period,
        lines=design.lines,
        y_quantity="position",
    )


def _play(job, n_runs: int, processes: int, progress):
    """Split the runs over processes without JAX; (run, time, axis) of both signals."""
    cuts = np.linspace(0, n_runs, min(processes, n_runs) + 1).round().astype(int)
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        np.savez(folder / "job.npz", **job)
        results = [folder / f"{first}.npz" for first in cuts[:-1]]
        workers = [
            subprocess.Popen(
                [sys.executable, _LOOP, folder / "job.npz", str(first), str(last), result],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=environment,
                text=True,
            )
            for first, last, result in zip(cuts[:-1], cuts[1:], results, strict=True)
        ]
        try:
            for line in workers[0].stdout:
                if progress is not None:
                    progress(float(line))
            for worker in workers:
                if worker.wait():
                    raise RuntimeError(worker.stderr.read().strip())
        finally:
            for worker in workers:
                worker.kill()
                worker.wait()
                worker.stdout.close()
                worker.stderr.close()
        parts = [dict(np.load(result)) for result in results]
    return tuple(np.concatenate([part[name] for part in parts]) for name in ("u", "y"))


def _job(robot, design, positions, run_in, ripple, substeps, integrator, stick) -> dict:
    """All numbers of a study as arrays."""
    point = jf.robot.operating_point(robot, positions)
    if not np.all(point.converged):
        raise ValueError(f"{robot.name} has no equilibrium at position {int(np.argmin(np.asarray(point.converged)))}.")
    if design.fs != robot.sampling_frequency or design.n_in != robot.n_axes:
        raise ValueError("The design needs the robot's sampling frequency and one input for each axis.")
    step = 1.0 / (design.fs * substeps)
    if stick < 2 * step * (1 - 1e-9):
        raise ValueError(f"stick = {stick:g} s is below two substeps of {step:g} s; take more of them.")
    xml = _model(robot, step, integrator, stick)
    order, qpos = _coordinates(robot, mujoco.MjModel.from_xml_string(xml), np.asarray(point.z))
    controller = robot.controller
    job = {
        "xml": np.array(xml),
        "fs": design.fs,
        "substeps": substeps,
        "qpos": qpos,
        "torque": np.asarray(point.torque),
        "gear": np.asarray(robot.drives.gear_ratio),
        "torque_limit": np.asarray(robot.drives.torque_limit),
        "position_gain": np.asarray(controller.position_gain),
        "integral_time": np.asarray(controller.integral_time),
        "speed_filter": np.inf if controller.speed_filter is None else np.asarray(controller.speed_filter),
        "anti_windup": controller.anti_windup,
        "velocity_gain": np.asarray(controller.velocity_gain),
        "feedforward": controller.feedforward,
    }
    job |= _references(design, run_in)
    job |= _springs(robot, order)
    return job | _effects(robot, ripple, substeps) | _outside(robot, order)


def _model(robot, step: float, integrator: str, stick: float) -> str:
    """MJCF with linear springs, MuJoCo's friction, and the effects that are springs and dampers of joints."""
    linear = dataclasses.replace(
        robot.springs, stiffness_ratio=np.ones_like(robot.springs.stiffness_ratio), backlash=None
    )
    root = ET.fromstring(mjcf(dataclasses.replace(robot, springs=linear, effects=()), timestep=step))
    option = root.find("option")
    # PGS: the friction of motors behind springs is uncoupled, so that two of its cheap sweeps are exact.
    for name, value in {"integrator": integrator, "solver": "PGS", "jacobian": "dense", "tolerance": "1e-10"}.items():
        option.set(name, value)
    option.find("flag").set("island", "disable")
    root.remove(root.find("actuator"))  # torques are applied to the joints
    ET.SubElement(root, "size", memory="1M")
    joints = {joint.get("name"): joint for joint in root.iter("joint") if joint.get("name")}
    for joint in joints.values():
        if "frictionloss" in joint.attrib:
            joint.set("solreffriction", f"{stick!r} 1")
            joint.set("solimpfriction", "0.99 0.99 0.001 0.5 2")  # next to no creep
    for effect in robot.effects:
        name = robot.axis_names[axis_of(robot, effect.joint)]
        match effect:
            case effects.AbstractArmTorque() if effect.name != "bumper":
                _hold(joints[name], effect)
            case effects.WristCoupling():
                before = robot.axis_names[axis_of(robot, effect.joint) - 1]
                tendon = next(tendon for tendon in root.iter("fixed") if tendon.get("name") == name)
                ET.SubElement(tendon, "joint", joint=before, coef=f"{-float(effect.ratio)!r}")
            case _ if effect.name == "presliding_friction":  # instead of the motor's Coulomb friction
                joints[f"motor:{name}"].attrib.pop("frictionloss", None)
    return ET.tostring(root, encoding="unicode")


def _hold(joint, effect) -> None:
    """A spring or damper of the arm's joint itself."""
    old = {name: float(joint.get(name, 0.0)) for name in ("stiffness", "springref", "damping")}
    stiffness, rest = float(getattr(effect, "stiffness", 0.0)), float(getattr(effect, "rest", 0.0))
    damping = float(getattr(effect, "coefficient", getattr(effect, "damping", 0.0)))
    total = old["stiffness"] + stiffness
    if total:
        joint.set("springref", repr((old["stiffness"] * old["springref"] + stiffness * rest) / total))
    joint.set("stiffness", repr(total))
    joint.set("damping", repr(old["damping"] + damping))


def _coordinates(robot, model, z):
    """Where the coordinates [q_m, q_a, q_e] stand in MuJoCo's, and positions in its order."""
    motors = [f"motor:{robot.axis_names[axis]}" for axis in robot.flexible_axes]
    names = motors + [robot.joint_names[i] for i in robot.arm_joints]
    order = np.array([model.joint(name).dofadr[0] for name in names])
    qpos = np.zeros((len(z), model.nv))
    qpos[:, order] = z
    return order, qpos


def _references(design, run_in: float) -> dict:
    """Steady periods after a run-in of the same motion, of which the first 60 % fade in."""
    played = jf.reference(design)
    first = int(np.ceil(run_in * design.fs))
    steady = design.transient_periods * design.period  # a sample of phase zero, behind the design's own ramp
    index = steady + np.arange(-first, design.periods * design.period) % design.period
    velocity, position = played.r[:, index], played.position[:, index]
    n = int(0.6 * first)
    if n:
        x = np.linspace(0.0, 1.0, n, endpoint=False)[:, None]
        weight, slope = ((6 * x - 15) * x + 10) * x**3, 30 * (x * (1 - x)) ** 2 * design.fs / n
        velocity[:, :n] = weight * velocity[:, :n] + slope * position[:, :n]
        position[:, :n] *= weight
    return {"velocity": velocity, "position": position, "run_in": first}


def _springs(robot, order) -> dict:
    """The nonlinear springs, and the directions of motor torques and of these springs in MuJoCo's coordinates."""
    s, axes, motors = robot.springs, robot.n_axes, robot.n_motors
    gap = np.zeros(len(s.stiffness)) if s.backlash is None else np.asarray(s.backlash)
    inside = (effects.LoadDependentFriction, effects.AbstractGearError, effects.AbstractGearTorque)
    needed = (np.asarray(s.stiffness_ratio) != 1.0) | (gap > 0)
    for effect in (e for e in robot.effects if isinstance(e, inside)):
        axis = axis_of(robot, effect.joint)
        if axis in robot.flexible_axes:
            needed[robot.flexible_axes.index(axis)] = True
    which = np.flatnonzero(needed)
    gear = np.asarray(robot.drives.gear_ratio)
    z = np.zeros((len(order), axes + len(which)))  # rows q_m, q_a, q_e
    for axis in range(axes):
        flexible = axis in robot.flexible_axes
        z[robot.flexible_axes.index(axis) if flexible else motors + axis, axis] = 1.0 if flexible else gear[axis]
    for column, spring in enumerate(which, axes):
        if spring < motors:
            axis = robot.flexible_axes[spring]
            z[spring, column], z[motors + axis, column] = 1.0 / gear[axis], -1.0
        else:
            z[axes + spring, column] = -1.0
    springs = {robot.flexible_axes[i]: k for k, i in enumerate(which) if i < motors}
    for effect in (e for e in robot.effects if isinstance(e, effects.WristCoupling)):
        axis = axis_of(robot, effect.joint)
        if axis in springs:
            z[motors + axis - 1, axes + springs[axis]] -= float(effect.ratio)
    directions = np.zeros_like(z)
    directions[order] = z
    return {
        "directions": directions,
        "spring_axis": np.array([robot.flexible_axes[i] if i < motors else -1 for i in which], int),
        "spring_stiffness": np.asarray(s.stiffness)[which],
        "spring_damping": np.asarray(s.damping)[which],
        "spring_ratio": np.asarray(s.stiffness_ratio)[which],
        "spring_knee": np.asarray(s.stiffness_knee)[which],
        "spring_gap": gap[which],
    } | _gears(robot, springs)


def _gears(robot, springs: dict[int, int]) -> dict:
    """Effects inside gears as rows, each with the number of its spring among the nonlinear ones."""
    lead, loss, slip = [], [], []
    for effect in robot.effects:
        axis = axis_of(robot, effect.joint)
        match effect:
            case effects.TransmissionError():
                orders = np.asarray(effect.order) * float(effect.teeth)
                lead += [(springs[axis], *row) for row in zip(effect.amplitude, orders, effect.phase, strict=True)]
            case effects.StructuralDamping():
                loss.append((springs[axis], effect.loss))
            case effects.GearHysteresis():
                slip.append((springs[axis], effect.torque, effect.slip))
    rows = lambda table, width: np.array(table, float).reshape(-1, width)
    return {"gear_lead": rows(lead, 4), "gear_loss": rows(loss, 2), "gear_slip": rows(slip, 3)}


def _outside(robot, order) -> dict:
    """The effects of `_outside_effects` as rows."""
    bristles, drift, stops, drives = [], np.zeros((3, robot.n_axes)), [], robot.drives
    drift[2] = 1.0
    for effect in robot.effects:
        axis = axis_of(robot, effect.joint)
        match effect.name:
            case "presliding_friction":
                level = float(drives.friction.coulomb[axis])
                damping = 0.6 * np.sqrt(level * float(drives.motor_inertia[axis]) / float(effect.distance))
                bristles.append((axis, level, effect.distance, damping))
            case "gain_drift":
                drift[:, axis] = effect.swing, effect.begin, effect.length
            case "bumper":
                stops.append((order[robot.n_motors + axis], effect.stop, effect.side, effect.stiffness))
    rows = lambda table: np.array(table, float).reshape(-1, 4)
    return {"bristles": rows(bristles), "drift": drift, "stops": rows(stops)}


def _effects(robot, ripple: Ripple | None, substeps: int) -> dict:
    """Effects as tables; those on the robot's numbers are in them, arm torques in the model."""
    axes = robot.n_axes
    if ripple is not None and len(ripple.torque[0]) != axes:
        raise ValueError(f"The ripple has {len(ripple.torque[0])} axes, {robot.name} has {axes}.")
    torque, resolver = ([[] for _ in range(axes)] for _ in range(2))
    if ripple is not None:
        for lists, table in ((torque, ripple.torque), (resolver, ripple.resolver)):
            for axis in range(axes):
                lists[axis] += list(zip(*(np.asarray(x)[axis] for x in table), strict=True))
    gain, limit, resolution = np.ones(axes), np.full(axes, np.inf), np.zeros(axes)
    delay, lag, rubbing = np.zeros(axes), np.zeros(axes), []
    for effect in robot.effects:
        axis = axis_of(robot, effect.joint)
        match effect:
            case effects.TorqueRipple():
                torque[axis] += list(zip(effect.amplitude, effect.order, effect.phase, strict=True))
            case effects.ResolverRipple():
                resolver[axis] += list(zip(effect.amplitude, effect.order, effect.phase, strict=True))
            case effects.EncoderQuantisation():
                resolution[axis] = effect.resolution
            case effects.TorqueConstant():
                gain[axis] *= 1.0 + effect.error
            case effects.TorqueSaturation():
                limit[axis] = effect.limit
            case effects.TorqueDelay():
                delay[axis] += effect.delay
            case effects.CurrentLoopLag() if lag[axis] == 0.0:
                lag[axis] = effect.time_constant
            case effects.StribeckFriction():
                rubbing.append((0, axis, effect.level, effect.width, effect.smoothing))
            case effects.FrictionAsymmetry():
                rubbing.append((1, axis, effect.offset, effect.level, effect.smoothing))
            case effects.LoadDependentFriction():
                rubbing.append((2, axis, effect.coefficient, 0.0, effect.smoothing))
            case effects.AbstractArmTorque() | effects.AbstractGear():
                pass  # in the model, or in tables of their own
            case _ if effect.name in ("presliding_friction", "gain_drift"):
                pass
            case _:
                raise ValueError(f"{effect.name} on {effect.joint} is not known here, or stands there twice.")
    return {
        "torque_ripple": _padded(torque),
        "resolver_ripple": _padded(resolver),
        "actuator_gain": gain,
        "actuator_limit": limit,
        "actuator_weight": _weights(delay, lag, robot.sampling_frequency, substeps),
        "resolution": resolution,
        "rubbing": np.array(rubbing, float).reshape(-1, 5),
    }


def _padded(lists) -> np.ndarray:
    """(amplitude, order, phase) lists of all axes as one array (3, axis, order)."""
    table = np.zeros((3, len(lists), max(1, *map(len, lists))))
    for axis, rows in enumerate(lists):
        if rows:
            table[:, axis, : len(rows)] = np.array(rows, float).T
    return table


def _weights(delay, lag, fs: float, substeps: int) -> np.ndarray:
    """Part of each past command in the mean torque of each substep, (substep, sample ago, axis).

    A command held from 0 to T gives P(t) = S(t) - S(t - T), S the step response 1 - exp(-(t - delay)/lag).
    """
    sample, step = 1.0 / fs, 1.0 / (fs * substeps)
    past = 1 + int(np.ceil(np.max(np.where(delay + lag > 0, delay * fs + _PAST * lag * fs + 1, 0.0))))

    def summed(t):  # integral of the step response
        t = np.maximum(t[..., None] - delay, 0.0)
        safe = np.where(lag > 0, lag, 1.0)
        return t + np.where(lag > 0, safe * np.expm1(-t / safe), 0.0)

    held = lambda t: summed(t) - summed(t - sample)
    start = np.arange(past) * sample + np.arange(substeps)[:, None] * step
    weight = (held(start + step) - held(start)) / step
    return weight / weight.sum(axis=1, keepdims=True)
