"""Operating point under gravity, and small motions about it."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from .._annotated import checked
from .._types import Array, arrays, traced
from ..effects import (
    AbstractActuator,
    AbstractFriction,
    AbstractGearCoupling,
    AbstractGearError,
    AbstractGearTorque,
    AbstractMotorTorque,
    AbstractSensor,
)
from ..effects._place import spring_of
from ..effects.acting import Group, groups
from .chain import gravity_forces
from .drive import ViscousFrictionLaw, effective_friction
from .equations import (
    arm_torques,
    chain_angles,
    drive_forces,
    gear_angles,
    gear_coupling,
    inertia,
    motor_directions,
    spring_directions,
)
from .robot import Robot
from .tolerances import Tolerances

_NEWTON_STEPS = 50
_TOLERANCE = 1e-13  # of a Newton step, rad; a deflection is 1e-5 to 1e-2 rad
_CONVERGED = 1e-9  # rad
_ALIKE = 16  # positions: fewer are filled up to so many, and share what is compiled
_NOT_AT_REST = (
    AbstractFriction,
    AbstractMotorTorque,
    AbstractSensor,
)  # effects that neither equilibrium nor slopes know


class OperatingPoint(eqx.Module):
    """The robot at rest with its arm at given angles.

    **Fields:** `z`: coordinates [q_m, q_a, q_e], (*batch, dof), rad. `torque`: motor torque that holds it,
    (*batch, axis), N m, without friction. `deflection`: of the springs, arm side, (*batch, spring), rad.
    `converged`: (*batch,).
    """

    z: Float[Array, "*batch dof"]
    torque: Float[Array, "*batch axis"]
    deflection: Float[Array, "*batch spring"]
    converged: Bool[Array, "*batch"]


class GearLoss(eqx.Module):
    """What effects with a memory make of the stiffness of transmissions, K + sum_i response_i(s) stiffness_i.

    **Fields:** `group`: the effects. `stiffness`: of their springs, (*batch, effect, dof, dof).
    """

    group: Group[AbstractGearTorque]
    stiffness: Float[Array, "*batch effect dof dof"]


class LinearRobot(eqx.Module):
    """Small motions about an operating point, M dz'' + D dz' + K dz = B du, motor angles B^T dz.

    **Fields:** `mass`, `damping`, `stiffness`: (*batch, dof, dof). `motor`: B, (dof, axis).
    `partners`: of each of the leading coordinates that are tied to one other coordinate only (a motor to its
    joint), that coordinate; the FRF eliminates them first. Empty where nothing is known.
    `actuators`: effects between command and motor torque; the FRF multiplies by their response.
    `losses`: effects that make K complex and a function of frequency; the FRF adds them.
    """

    mass: Float[Array, "*batch dof dof"]
    damping: Float[Array, "*batch dof dof"]
    stiffness: Float[Array, "*batch dof dof"]
    motor: Float[Array, "dof axis"]
    partners: tuple[int, ...] = eqx.field(static=True, default=())
    actuators: tuple[Group, ...] = ()
    losses: tuple[GearLoss, ...] = ()


@checked
def operating_point(robot: Robot, arm_angles: Float[Array, "*batch axis"]) -> OperatingPoint:
    """The equilibrium with the driven joints at these angles (arm side): spring torque = gravity torque.

    Newton's method on the deflections of all springs; derivatives by the implicit function theorem, not
    through the iterations. Check `converged`: it is false where Newton's method did not come to an end (a
    spring far too soft for its load) and at angles that are NaN.

    **Arguments:** `robot`: with its springs' law; friction and controller do not matter. `arm_angles`: q_a, (*batch,
    axis), rad.

    **Returns:** an `OperatingPoint`: coordinates and deflections in rad, torques of the motors in N m.

    **Raises:** `jaxfrf.InputError` for another number of angles than driven joints, and where effects couple gears that
    have no spring.

    **Source:** the equations of motion at rest (Moberg, Wernholt, Hanssen & Brogardh, J. Dyn. Sys. Meas. Control 136,
    2014); Newton's method.
    """
    _check_coupling(robot)
    arm_angles = jnp.asarray(arm_angles)
    robot = _at_rest(robot, (*_NOT_AT_REST, AbstractActuator))
    if traced((robot, arm_angles)):
        return _operating_point(robot, arm_angles)
    batch = arm_angles.shape[:-1]
    return _parted(_operating_point(robot, _filled(arm_angles, batch)), batch)


def _filled(rows, batch: tuple[int, ...]):
    """Rows in one line, the last one repeated up to `_ALIKE` of them."""
    rows = np.asarray(rows)
    rows = rows.reshape(math.prod(batch), *rows.shape[len(batch) :])
    missing = min(_ALIKE - len(rows), _ALIKE * len(rows))
    return rows if missing <= 0 else np.concatenate([rows, np.repeat(rows[-1:], missing, axis=0)])


def _parted(tree, batch: tuple[int, ...]):
    """What belongs to the rows that `_filled` was given."""
    count = math.prod(batch)
    return jax.tree.map(lambda x: jnp.asarray(np.asarray(x)[:count].reshape((*batch, *x.shape[1:]))), tree)


def _check_coupling(robot: Robot) -> None:
    for effect in robot.effects:
        if isinstance(effect, AbstractGearCoupling):
            spring_of(robot, effect.joint)


def _at_rest(robot: Robot, without: tuple[type, ...] = _NOT_AT_REST) -> Robot:
    """The robot with what matters here, numbers as arrays: many robots then share what is compiled."""
    kept = tuple(effect for effect in robot.effects if not isinstance(effect, without))
    plain = dataclasses.replace(
        robot, effects=kept, controller=None, name="", sampling_frequency=0.0, tolerances=Tolerances()
    )
    return arrays(plain)


@eqx.filter_jit
def _operating_point(robot: Robot, arm_angles) -> OperatingPoint:
    n_gears, flexible = robot.n_motors, np.array(robot.flexible_axes, int)
    held = arm_torques(robot, arm_angles, jnp.zeros_like(arm_angles)) if robot.effects else None
    coupling, relaxed = gear_coupling(robot), _relaxed(robot)

    def load(deflection):
        """Torque of gravity, and of effects on the arm, on the gears and q_e."""
        torque = _gravity(robot, jnp.concatenate([arm_angles, -deflection[..., n_gears:]], axis=-1))
        torque = torque if held is None else torque.at[..., : robot.n_axes].add(held)
        if coupling is None:
            return torque
        return torque.at[..., : robot.n_axes].set(torque[..., : robot.n_axes] @ jnp.linalg.inv(coupling))

    def residual(deflection):
        torque = load(deflection)
        carried = jnp.concatenate([torque[..., flexible], torque[..., robot.n_axes :]], axis=-1)
        tension = robot.springs.torque(deflection, jnp.zeros_like(deflection))
        return (tension if relaxed is None else relaxed * tension) - carried

    start = jnp.zeros((*arm_angles.shape[:-1], len(robot.spring_names)), jnp.result_type(arm_angles, float))
    deflection = jax.lax.custom_root(residual, start, _newton, _solve_tangent)
    torque, gear = load(deflection)[..., : robot.n_axes], robot.drives.gear_ratio
    output = jnp.asarray(gear_angles(robot, arm_angles)).at[..., flexible].add(deflection[..., :n_gears])
    motor, slope = _behind_errors(robot, output)
    error = residual(deflection) / robot.springs.tangent(deflection)
    return OperatingPoint(
        z=jnp.concatenate([gear[flexible] * motor[..., flexible], arm_angles, -deflection[..., n_gears:]], axis=-1),
        torque=torque * slope / gear,
        deflection=deflection,
        converged=jnp.all(jnp.abs(error) <= _CONVERGED, axis=-1) & jnp.all(jnp.isfinite(torque), axis=-1),
    )


def _relaxed(robot: Robot) -> Float[Array, "spring"] | None:
    """Torque of a spring and of the effects beside it at rest, over the spring's own; `None` where all are alone."""
    losses = groups(robot, AbstractGearTorque)
    if not losses:
        return None
    axes = jnp.ones(robot.n_axes)
    for group in losses:
        axes = group.added(axes, jax.vmap(lambda e: jnp.real(e.response(jnp.zeros((), complex))))(group.effects))
    return jnp.concatenate([axes[np.array(robot.flexible_axes, int)], jnp.ones(robot.n_elastic)])


_ROOTS = 4  # Newton steps for a motor angle behind a transmission error: quadratic, from within some 1e-4 rad


def _behind_errors(robot: Robot, output):
    """Motor angles on the arm side whose gears put out `output`, (*batch, axis), and d output / d motor there."""
    errors = groups(robot, AbstractGearError)
    if not errors:
        return output, jnp.ones_like(output)
    target = jnp.moveaxis(output, -1, 0)

    def put_out(angle):
        total = angle
        for group in errors:
            total = group.added(total, group(lambda effect, x: effect.lead(x), angle))
        return total

    angle = target
    for _ in range(_ROOTS):
        value, slope = jax.jvp(put_out, (angle,), (jnp.ones_like(angle),))
        angle = angle - (value - target) / slope
    slope = jax.jvp(put_out, (angle,), (jnp.ones_like(angle),))[1]
    return jnp.moveaxis(angle, 0, -1), jnp.moveaxis(slope, 0, -1)


def _gravity(robot: Robot, arm):
    return gravity_forces(robot.chain, chain_angles(robot, arm))[..., np.array(robot.arm_joints)]


def _jacobian(function, x):
    """d function / d x, (*batch, out, in), of a function that treats every row of x (*batch, in) on its
    own."""
    along = lambda e: jax.jvp(function, (x,), (jnp.broadcast_to(e, x.shape),))[1]
    return jax.vmap(along, out_axes=-1)(jnp.eye(x.shape[-1], dtype=x.dtype))


def _newton_step(residual, x):
    return jnp.linalg.solve(_jacobian(residual, x), residual(x)[..., None])[..., 0]


def _newton(residual, start):
    def proceed(carry):
        _, step, count = carry
        return jnp.any(jnp.abs(step) > _TOLERANCE) & (count < _NEWTON_STEPS)

    def advance(carry):
        x, _, count = carry
        step = _newton_step(residual, x)
        return x - step, step, count + 1

    return jax.lax.while_loop(proceed, advance, (start, jnp.full_like(start, jnp.inf), 0))[0]


def _solve_tangent(linear, y):
    return jnp.linalg.solve(_jacobian(linear, jnp.zeros_like(y)), y[..., None])[..., 0]


@checked
def linearise(
    robot: Robot,
    point: OperatingPoint,
    friction: Float[Array, "axis"] | None = None,
    deflections: Float[Array, "sample spring"] | None = None,
) -> LinearRobot:
    """Small motions about a point of rest, by automatic differentiation of the forces.

    K includes the change of gravity with position and the local stiffness of nonlinear springs; centrifugal
    and Coriolis forces are of second order at rest. Friction enters as a viscous coefficient: its slope at
    rest would describe speeds below the smoothing only.

    Biased where motions are not small: what depends on the amplitude (play, Coulomb friction, springs that stiffen) is
    one number here, that of `friction` and `deflections`.

    **Arguments:**

    - `robot`: with its effects, those that act in small motion. `point`: of `operating_point`.
    - `friction`: f_eff of every axis, motor side, (axis,), N m s/rad, as `effective_friction` gives it; the
      robot's viscous friction where it is `None`.
    - `deflections`: about the point of rest over which the local stiffness is averaged, (sample,
      spring), rad: an experiment that moves far over a nonlinear spring sees its mean stiffness. `None`: the
      stiffness at rest.

    **Returns:** a `LinearRobot`: mass in kg m^2, damping in N m s/rad, stiffness in N m/rad, per operating point.

    **Source:** first-order Taylor series of the equations of motion (Moberg, Wernholt, Hanssen & Brogardh, J. Dyn. Sys.
    Meas. Control 136, 2014).
    """
    friction = robot.drives.friction.viscous if friction is None else friction
    robot, friction = _at_rest(robot), jnp.asarray(friction)
    deflections = None if deflections is None else jnp.asarray(deflections)
    if traced((robot, point, friction, deflections)):
        return _linearised(robot, point, friction, deflections)
    batch = point.z.shape[:-1]
    rows = _linearised(robot, jax.tree.map(lambda x: _filled(x, batch), point), friction, deflections)
    mass, damping, stiffness = _parted((rows.mass, rows.damping, rows.stiffness), batch)
    losses = tuple(GearLoss(loss.group, _parted(loss.stiffness, batch)) for loss in rows.losses)
    return dataclasses.replace(rows, mass=mass, damping=damping, stiffness=stiffness, losses=losses)


@eqx.filter_jit
def _linearised(robot: Robot, point: OperatingPoint, friction, deflections) -> LinearRobot:
    smooth = dataclasses.replace(robot, drives=dataclasses.replace(robot.drives, friction=ViscousFrictionLaw(friction)))
    z, rest, motors = _without_errors(robot, point), jnp.zeros_like(point.z), robot.n_motors
    stiffness = -_jacobian(lambda x: drive_forces(smooth, x, rest, point.torque), z)
    damping = -_jacobian(lambda x: drive_forces(smooth, z, x, point.torque), rest)
    stiffness = stiffness.at[..., motors:, motors:].add(gravity_stiffness(robot, z[..., motors:]))
    if deflections is not None:
        more = local_stiffness(robot, point, deflections) - local_stiffness(robot, point)
        springs = spring_directions(robot)
        stiffness = stiffness + jnp.einsum("is,...s,js->...ij", springs, more, springs)
    partners = tuple(motors + axis for axis in robot.flexible_axes) if gear_coupling(robot) is None else ()
    actuators, losses = groups(robot, AbstractActuator), _losses(robot, local_stiffness(robot, point, deflections))
    return LinearRobot(inertia(robot, z), damping, stiffness, motor_directions(robot), partners, actuators, losses)


def _without_errors(robot: Robot, point: OperatingPoint):
    """The coordinates at rest with the motors where they would stand behind gears without transmission error."""
    if not groups(robot, AbstractGearError):
        return point.z
    n, flexible = robot.n_motors, np.array(robot.flexible_axes, int)
    output = gear_angles(robot, point.z[..., n : n + robot.n_axes])[..., flexible] + point.deflection[..., :n]
    return jnp.asarray(point.z).at[..., :n].set(robot.drives.gear_ratio[flexible] * output)


def _losses(robot: Robot, tangent) -> tuple[GearLoss, ...]:
    found, W = groups(robot, AbstractGearTorque), spring_directions(robot)

    def loss(group):
        springs = np.array([robot.flexible_axes.index(axis) for axis in group.axes])
        return GearLoss(group, jnp.einsum("is,...s,js->...sij", W[:, springs], tangent[..., springs], W[:, springs]))

    return tuple(loss(group) for group in found)


@checked
def describing_friction(
    robot: Robot,
    amplitude: Float[Array, "axis"] | float,
    load: Float[Array, "axis"] | float = 0.0,
) -> Float[Array, "axis"]:
    """Viscous coefficient of all friction, the robot's own and its effects', for small motion on a slow sine.

    Own friction as in `effective_friction`, effects by the mean slope of their law over the sine: what `linearise`
    and `frf_and_jacobian` take as `friction`. It fails where the small motion is not small against the slow one.

    **Arguments:** `robot`: with its friction and effects. `amplitude`: of the slow sine, motor side, (axis,) or a
    number, rad/s. `load`: torque in the gears on the motor side, as `OperatingPoint.torque`, (axis,) or a number, N m.

    **Returns:** (axis,), N m s/rad.

    **Source:** Gelb & Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968.
    """
    amplitude, load = (jnp.broadcast_to(jnp.asarray(x, float), (robot.n_axes,)) for x in (amplitude, load))
    total = effective_friction(robot.drives.friction, amplitude)
    for group in groups(robot, AbstractFriction):
        total = group.added(total, group(lambda effect, a, l: effect.gain(a, l), amplitude, load))
    return total


@checked
def gravity_stiffness(robot: Robot, arm: Float[Array, "*batch arm"]) -> Float[Array, "*batch arm arm"]:
    """Change of the gravity torque with the arm's angles, dg_ae/d arm.

    **Arguments:** `robot`: with its chain. `arm`: [q_a, q_e], (*batch, arm), rad, arm side.

    **Returns:** (*batch, arm, arm), N m/rad.

    **Source:** the derivative of `gravity_forces`, by automatic differentiation.
    """
    return _jacobian(lambda x: _gravity(robot, x), arm)


@checked
def local_stiffness(
    robot: Robot, point: OperatingPoint, deflections: Float[Array, "sample spring"] | None = None
) -> Float[Array, "*batch spring"]:
    """Stiffness of every spring at its deflection, averaged over `deflections` about it; N m/rad.

    **Arguments:** `robot`: with its springs' law. `point`: whose deflections are taken, (*batch, spring).
    `deflections`: samples about it, (sample, spring), rad, arm side; `None`: the tangent at the point.

    **Returns:** (*batch, spring), N m/rad.

    **Source:** the derivative of the springs' law (`Spring`); the mean over a motion as describing functions take it
    (Gelb & Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968).
    """
    if deflections is None:
        return robot.springs.tangent(point.deflection)
    return jnp.mean(robot.springs.tangent(point.deflection[..., None, :] + deflections), axis=-2)
