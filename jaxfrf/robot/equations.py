"""The equations of motion of a robot with elastic joints.

    M_m q_m'' = u - tau_fm(q_m') - tau_g / n
    M_ae(q_a, q_e) [q_a''; q_e''] = [tau_g; tau_e] - c_ae - g_ae

(the extended flexible joint model: Moberg, Wernholt, Hanssen & Brogardh, J. Dyn. Sys. Meas. Control 136,
2014).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._annotated import checked
from .._types import Array
from ..effects import AbstractArmTorque, AbstractFriction, AbstractGearCoupling
from ..effects.acting import groups
from .chain import mass_and_bias, mass_and_bias_columns, mass_matrix, potential_energy
from .robot import Robot


@checked
def chain_angles(robot: Robot, arm: Float[Array, "*batch arm"]) -> Float[Array, "*batch joint"]:
    """Angles of all joints in chain order, from [q_a, q_e], rad; a locked joint stands at zero.

    **Arguments:** `robot`: whose joints they are. `arm`: [q_a, q_e], (*batch, arm), rad, arm side.

    **Returns:** (*batch, joint), rad.
    """
    place = np.full(robot.chain.n_joints, arm.shape[-1])
    place[list(robot.arm_joints)] = np.arange(arm.shape[-1])
    return jnp.concatenate([arm, jnp.zeros_like(arm[..., :1])], axis=-1)[..., place]


def _arm_matrix(robot: Robot, matrix):
    """Chain inertia in the order [q_a, q_e], with the rotors of rigid transmissions on the diagonal."""
    order, rotor = np.array(robot.arm_joints), _reflected_rotors(robot)
    matrix = matrix[..., order[:, None], order]
    return matrix if rotor is None else matrix + jnp.diag(rotor)


def _reflected_rotors(robot: Robot):
    """Inertia of the rotors that turn with the arm, on the arm side, (arm,); `None` where all gears are flexible."""
    if robot.n_motors == robot.n_axes:
        return None
    rigid = np.ones(robot.n_axes)
    rigid[list(robot.flexible_axes)] = 0.0
    rotor = rigid * jnp.square(robot.drives.gear_ratio) * robot.drives.motor_inertia
    return jnp.concatenate([rotor, jnp.zeros(robot.n_elastic)])


@checked
@eqx.filter_jit
def arm_inertia(robot: Robot, arm: Float[Array, "*batch arm"]) -> Float[Array, "*batch arm arm"]:
    """M_ae(q_a, q_e), with the rotors of rigid transmissions.

    **Arguments:** `robot`: with its chain and motors. `arm`: [q_a, q_e], (*batch, arm), rad, arm side.

    **Returns:** (*batch, arm, arm), kg m^2.

    **Source:** as of `mass_matrix`.
    """
    return _arm_matrix(robot, mass_matrix(robot.chain, chain_angles(robot, arm)))


@checked
@eqx.filter_jit
def arm_inertia_and_bias(
    robot: Robot, arm: Float[Array, "*batch arm"], rate: Float[Array, "*batch arm"]
) -> tuple[Float[Array, "*batch arm arm"], Float[Array, "*batch arm"]]:
    """M_ae and c_ae + g_ae from one pass over the kinematics: what changes slowly within a control sample.

    **Arguments:** `robot`: with its chain and motors. `arm`: [q_a, q_e], (*batch, arm), rad, arm side. `rate`: of that
    shape, rad/s.

    **Returns:** (*batch, arm, arm), kg m^2, and (*batch, arm), N m.

    **Source:** as of `mass_and_bias`.
    """
    matrix, bias = mass_and_bias(robot.chain, chain_angles(robot, arm), chain_angles(robot, rate))
    return _arm_matrix(robot, matrix), bias[..., np.array(robot.arm_joints)]


@checked
def arm_inertia_and_bias_columns(
    robot: Robot, arm: Float[Array, "arm run"], rate: Float[Array, "arm run"]
) -> tuple[Float[Array, "arm arm run"], Float[Array, "arm run"]]:
    """As `arm_inertia_and_bias`, of many runs with the runs last: for simulations.

    **Arguments:** `robot`: with its chain and motors. `arm`: (arm, run), rad. `rate`: (arm, run), rad/s.

    **Returns:** (arm, arm, run), kg m^2, and (arm, run), N m.

    **Source:** as of `mass_and_bias`.
    """
    order = np.array(robot.arm_joints)
    angles, rates = chain_angles(robot, arm.T).T, chain_angles(robot, rate.T).T
    matrix, bias = mass_and_bias_columns(robot.chain, angles, rates)
    rotor = _reflected_rotors(robot)
    matrix = matrix[order[:, None], order]
    return (matrix if rotor is None else matrix + jnp.diag(rotor)[..., None]), bias[order]


@checked
def motor_inertia(robot: Robot) -> Float[Array, "motor"]:
    """Inertia of the motors that have a coordinate of their own, kg m^2.

    **Arguments:** `robot`: with its motors.

    **Returns:** (motor,), kg m^2, base to tip.
    """
    return robot.drives.motor_inertia[np.array(robot.flexible_axes, int)]


@checked
@eqx.filter_jit
def inertia(robot: Robot, z: Float[Array, "*batch dof"]) -> Float[Array, "*batch dof dof"]:
    """Inertia in the coordinates z: motors and arm are coupled by springs only, so it is block diagonal.

    **Arguments:** `robot`: with its chain and motors. `z`: [q_m, q_a, q_e], (*batch, dof), rad.

    **Returns:** (*batch, dof, dof), kg m^2.

    **Source:** as of `mass_matrix`; the blocks as Moberg, Wernholt, Hanssen & Brogardh, J. Dyn. Sys. Meas. Control 136,
    2014, have them.
    """
    arm = arm_inertia(robot, z[..., robot.n_motors :])
    motors = jnp.broadcast_to(jnp.diag(motor_inertia(robot)), (*arm.shape[:-2], robot.n_motors, robot.n_motors))
    corner = jnp.zeros((*arm.shape[:-2], robot.n_motors, arm.shape[-1]))
    return jnp.concatenate(
        [
            jnp.concatenate([motors, corner], axis=-1),
            jnp.concatenate([jnp.swapaxes(corner, -1, -2), arm], axis=-1),
        ],
        axis=-2,
    )


@checked
def deflections(robot: Robot, z: Float[Array, "*batch dof"]) -> Float[Array, "*batch spring"]:
    """Deflection of every spring, arm side, rad: q_m/n - q_a of flexible transmissions, then -q_e; linear in z.

    The sign makes a positive spring torque drive the arm, tau_g = torque(q_m/n - q_a) and tau_e =
    torque(-q_e). Where effects couple axes, q_a is what their gears see of the arm (`gear_coupling`).

    **Arguments:** `robot`: with its gears. `z`: [q_m, q_a, q_e], (*batch, dof), rad; or rates, rad/s, for those of the
    deflections.

    **Returns:** (*batch, spring), rad, or rad/s of rates.

    **Source:** the equations above.
    """
    flexible = np.array(robot.flexible_axes, int)
    motor, arm, elastic = jnp.split(z, [robot.n_motors, robot.n_motors + robot.n_axes], axis=-1)
    seen = gear_angles(robot, arm)
    return jnp.concatenate([motor / robot.drives.gear_ratio[flexible] - seen[..., flexible], -elastic], axis=-1)


def gear_coupling(robot: Robot) -> Float[Array, "axis axis"] | None:
    """Turn of every gear's output per turn of every driven joint; `None` where each has its own."""
    coupling = groups(robot, AbstractGearCoupling)
    if not coupling:
        return None
    ratio = jnp.zeros(robot.n_axes)
    for group in coupling:
        ratio = group.added(ratio, group(lambda effect: effect.ratio))
    return jnp.eye(robot.n_axes) + jnp.diag(ratio[1:], -1)


def gear_angles(robot: Robot, arm: Float[Array, "*batch axis"]) -> Float[Array, "*batch axis"]:
    """Angles at the gears' outputs of driven joints at these angles, rad: the same but for coupled axes.

    **Arguments:** `arm`: of all driven joints, (*batch, axis), rad, arm side.
    """
    coupling = gear_coupling(robot)
    return arm if coupling is None else arm @ coupling.T


def motor_angles(robot: Robot, arm: Float[Array, "*batch axis"]) -> Float[Array, "*batch axis"]:
    """Angles of all motors whose driven joints stand at these, rad, behind gears that do not give way; rates of rates.

    What a log reads there is further by `Drives.zero` (`Drives.turned`).

    **Arguments:** `arm`: of all driven joints, (*batch, axis), rad, arm side.
    """
    return gear_angles(robot, arm) * robot.drives.gear_ratio


def arm_angles(robot: Robot, motor: Float[Array, "*batch axis"]) -> Float[Array, "*batch axis"]:
    """Angles of the driven joints whose motors stand at these, rad: the inverse of `motor_angles`.

    **Arguments:** `motor`: of all axes, (*batch, axis), rad, motor side.
    """
    coupling, outputs = gear_coupling(robot), motor / robot.drives.gear_ratio
    return outputs if coupling is None else outputs @ jnp.linalg.inv(coupling).T


@checked
def spring_directions(robot: Robot) -> Float[Array, "dof spring"]:
    """W with deflections(z) = W^T z, rad; a spring torque tau acts on the coordinates as -W tau.

    **Arguments:** `robot`: with its gears.

    **Returns:** W, (dof, spring).
    """
    return deflections(robot, jnp.eye(robot.dof))


@checked
def motor_directions(robot: Robot) -> Float[Array, "dof axis"]:
    """B with motor angles = B^T z (all axes, motor side, rad); a motor torque u acts on the coordinates as B u.

    **Arguments:** `robot`: with its gears.

    **Returns:** B, (dof, axis).
    """
    motors, axes = robot.n_motors, robot.n_axes
    flexible = np.array(robot.flexible_axes, int)
    direct = np.zeros((robot.dof, axes))
    direct[np.arange(motors), flexible] = 1.0
    geared = np.zeros((robot.dof, axes))
    rigid = np.setdiff1d(np.arange(axes), flexible)
    geared[motors + rigid, rigid] = 1.0
    return direct + geared * robot.drives.gear_ratio


@checked
def motor_values(robot: Robot, z: Float[Array, "*batch dof"]) -> Float[Array, "*batch axis"]:
    """Motor angles of all axes from the coordinates z, or motor speeds from z'; motor side.

    **Arguments:** `robot`: with its gears. `z`: [q_m, q_a, q_e], (*batch, dof), rad; or z', rad/s.

    **Returns:** (*batch, axis), in the unit of `z`.
    """
    return z @ motor_directions(robot)


@checked
def drive_forces(
    robot: Robot,
    z: Float[Array, "*batch dof"],
    rate: Float[Array, "*batch dof"],
    torque: Float[Array, "*batch axis"],
) -> Float[Array, "*batch dof"]:
    """The fast part of the dynamics: motors, friction and springs, B (u - tau_fm) - W tau_spring.

    **Arguments:** `robot`: with its springs, friction and effects. `z`: [q_m, q_a, q_e], (*batch, dof), rad. `rate`: of
    that shape, rad/s. `torque`: u, of the motors of all axes, (*batch, axis), N m, motor side.

    **Returns:** force on every coordinate, (*batch, dof), N m.

    **Source:** Moberg, Wernholt, Hanssen & Brogardh, J. Dyn. Sys. Meas. Control 136, 2014; effects as each of them
    says.
    """
    spring = robot.springs.torque(deflections(robot, z), deflections(robot, rate))
    speed = motor_values(robot, rate)
    friction = robot.drives.friction.torque(speed)
    forces = jnp.asarray(-spring @ spring_directions(robot).T)
    if robot.effects:
        friction = friction + friction_effects(robot, speed, gear_load(robot, spring, torque))
        arm = slice(robot.n_motors, robot.n_motors + robot.n_axes)
        forces = forces.at[..., arm].add(-arm_torques(robot, z[..., arm], rate[..., arm]))
    return forces + (torque - friction) @ motor_directions(robot).T


def gear_load(robot: Robot, spring, torque) -> Float[Array, "*batch axis"]:
    """Torque in every gear on the motor side: of its spring, or of the motor where the transmission is rigid; N m."""
    flexible = np.array(robot.flexible_axes, int)
    return torque.at[..., flexible].set(spring[..., : robot.n_motors] / robot.drives.gear_ratio[flexible])


@checked
def friction_effects(
    robot: Robot, speed: Float[Array, "*batch axis"], load: Float[Array, "*batch axis"]
) -> Float[Array, "*batch axis"]:
    """Torque against the motors by the robot's effects, motor side.

    **Arguments:** `robot`: with its effects. `speed`: of the motors, (*batch, axis), rad/s. `load`: torque in the gears
    on the motor side, (*batch, axis), N m.

    **Returns:** (*batch, axis), N m.

    **Source:** as each of the effects says.
    """
    return _effects_torque(robot, AbstractFriction, speed, load)


def arm_torques(robot: Robot, angle, rate) -> Float[Array, "*batch axis"]:
    """Torque against the driven joints by the robot's effects, arm side; N m."""
    return _effects_torque(robot, AbstractArmTorque, angle, rate)


def _effects_torque(robot: Robot, kind, *signals):
    of_axes = [jnp.moveaxis(x, -1, 0) for x in jnp.broadcast_arrays(*signals)]
    total = jnp.zeros_like(of_axes[0])
    for group in groups(robot, kind):
        total = group.added(total, group(lambda effect, *x: effect.torque(*x), *of_axes))
    return jnp.moveaxis(total, 0, -1)


@checked
@eqx.filter_jit
def generalised_forces(
    robot: Robot,
    z: Float[Array, "*batch dof"],
    rate: Float[Array, "*batch dof"],
    torque: Float[Array, "*batch axis"],
) -> Float[Array, "*batch dof"]:
    """All forces that accelerate the coordinates: `drive_forces` less [0; c_ae + g_ae].

    **Arguments:** `robot`: all of it. `z`: [q_m, q_a, q_e], (*batch, dof), rad. `rate`: of that shape, rad/s. `torque`:
    u, of the motors of all axes, (*batch, axis), N m, motor side.

    **Returns:** (*batch, dof), N m; `inertia` times the acceleration of z.

    **Source:** as of `drive_forces` and `mass_and_bias`.
    """
    motors = robot.n_motors
    _, bias = arm_inertia_and_bias(robot, z[..., motors:], rate[..., motors:])
    return drive_forces(robot, z, rate, torque) - jnp.concatenate([jnp.zeros_like(z[..., :motors]), bias], axis=-1)


@checked
@eqx.filter_jit
def forward_dynamics(
    robot: Robot, state: Float[Array, "*batch state"], torque: Float[Array, "*batch axis"]
) -> Float[Array, "*batch state"]:
    """Time derivative of the state [z, z'] under a motor torque: the right-hand side of an ODE.

    M(z) z'' = `generalised_forces`. A simulation that evaluates the slow part (`arm_inertia_and_bias`) less
    often than the fast one (`drive_forces`) is several times cheaper.

    **Arguments:** `robot`: all of it. `state`: (*batch, 2 dof), rad and rad/s. `torque`: motor side, (*batch, axis),
    N m.

    **Returns:** (*batch, 2 dof), rad/s and rad/s^2.

    **Source:** Moberg, Wernholt, Hanssen & Brogardh, J. Dyn. Sys. Meas. Control 136, 2014; the arm by its inertia
    matrix (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 6).
    """
    motors = robot.n_motors
    z, rate = state[..., : robot.dof], state[..., robot.dof :]
    matrix, bias = arm_inertia_and_bias(robot, z[..., motors:], rate[..., motors:])
    forces = drive_forces(robot, z, rate, torque)
    factor = jax.scipy.linalg.cho_factor(matrix, lower=True)
    arm = jax.scipy.linalg.cho_solve(factor, (forces[..., motors:] - bias)[..., None])[..., 0]
    return jnp.concatenate([rate, forces[..., :motors] / motor_inertia(robot), arm], axis=-1)


@checked
@eqx.filter_jit
def energy(robot: Robot, state: Float[Array, "*batch state"]) -> Float[Array, "*batch"]:
    """Kinetic energy of rotors and links, springs and gravity; (*batch,), J.

    Kept where there is no damping, friction or torque.

    **Arguments:** `robot`: whose springs have no play. `state`: [z, z'], (*batch, 2 dof), rad and rad/s.

    **Returns:** (*batch,), J.

    **Raises:** `NotImplementedError` for springs with play.

    **Source:** 1/2 z'^T M(z) z', `potential_energy`, and the integral of the springs' law.
    """
    z, rate = state[..., : robot.dof], state[..., robot.dof :]
    kinetic = 0.5 * jnp.einsum("...i,...ij,...j->...", rate, inertia(robot, z), rate)
    lifted = potential_energy(robot.chain, chain_angles(robot, z[..., robot.n_motors :]))
    return kinetic + lifted + robot.springs.energy(deflections(robot, z))
