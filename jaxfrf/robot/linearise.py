"""Operating point under gravity, and small motions about it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from .._types import Array
from .chain import gravity_forces
from .drive import ViscousFriction
from .robot import (
    Robot,
    chain_angles,
    generalised_forces,
    inertia,
    motor_directions,
    spring_directions,
)

_NEWTON_STEPS = 50
_TOLERANCE = 1e-13  # of a Newton step, rad; a deflection is 1e-5 to 1e-2 rad


class OperatingPoint(eqx.Module):
    """The robot at rest with its arm at given angles.

    **Fields:** `z`: coordinates [q_m, q_a, q_e], (*batch, dof), rad. `torque`: motor torque that holds it, (*batch, axis),
    N m, without friction. `deflection`: of the springs, arm side, (*batch, spring), rad. `converged`: (*batch,).
    """

    z: Float[Array, "*batch dof"]
    torque: Float[Array, "*batch axis"]
    deflection: Float[Array, "*batch spring"]
    converged: Bool[Array, "*batch"]


class LinearRobot(eqx.Module):
    """Small motions about an operating point, M dz'' + D dz' + K dz = B du, motor angles B^T dz.

    **Fields:** `mass`, `damping`, `stiffness`: (*batch, dof, dof). `motor`: B, (dof, axis), the same everywhere.
    """

    mass: Float[Array, "*batch dof dof"]
    damping: Float[Array, "*batch dof dof"]
    stiffness: Float[Array, "*batch dof dof"]
    motor: Float[Array, "dof axis"]


def operating_point(robot: Robot, arm_angles: Float[Array, "*batch axis"]) -> OperatingPoint:
    """The equilibrium with the driven joints at these angles (arm side): spring torque = gravity torque.

    Newton's method on the deflections of all springs; derivatives by the implicit function theorem, not through the
    iterations. Check `converged`: it fails where gravity overcomes a spring (no equilibrium) or at angles that are NaN.

    **Arguments:** `arm_angles`: q_a, (*batch, axis), rad.
    """
    arm_angles = jnp.asarray(arm_angles)
    if arm_angles.shape[-1:] != (robot.n_axes,):
        raise ValueError(f"arm_angles have shape {arm_angles.shape}; expected (*batch, {robot.n_axes}).")
    flat = arm_angles.reshape(-1, robot.n_axes)
    point = jax.vmap(lambda q: _equilibrium(robot, q))(flat)
    return jax.tree.map(lambda x: x.reshape(*arm_angles.shape[:-1], *x.shape[1:]), point)


def _equilibrium(robot: Robot, arm_angles) -> OperatingPoint:
    n_flexible = robot.n_motors
    flexible = jnp.array(robot.flexible_axes, int)

    def gravity(deflection):
        arm = jnp.concatenate([arm_angles, -deflection[n_flexible:]])
        return gravity_forces(robot.chain, chain_angles(robot, arm))[np.array(robot.arm_joints)]

    def carried(deflection):
        """Gravity torque that each spring has to carry."""
        load = gravity(deflection)
        return jnp.concatenate([load[flexible], load[robot.n_axes :]])

    def residual(deflection):
        return robot.springs.torque(deflection, jnp.zeros_like(deflection)) - carried(deflection)

    start = jnp.zeros(len(robot.spring_names), arm_angles.dtype)
    deflection = jax.lax.custom_root(residual, start, _newton, _solve_tangent) if start.size else start
    load = gravity(deflection)
    gear = robot.drives.gear_ratio
    motor = gear[flexible] * (arm_angles[flexible] + deflection[:n_flexible])
    step = jnp.linalg.solve(jax.jacfwd(residual)(deflection), residual(deflection)) if start.size else start
    return OperatingPoint(
        z=jnp.concatenate([motor, arm_angles, -deflection[n_flexible:]]),
        torque=load[: robot.n_axes] / gear,
        deflection=deflection,
        converged=jnp.all(jnp.abs(step) <= 1e-9) & jnp.all(jnp.isfinite(load)),
    )


def _newton(residual, start):
    def proceed(carry):
        _, step, count = carry
        return jnp.any(jnp.abs(step) > _TOLERANCE) & (count < _NEWTON_STEPS)

    def advance(carry):
        x, _, count = carry
        step = jnp.linalg.solve(jax.jacfwd(residual)(x), residual(x))
        return x - step, step, count + 1

    return jax.lax.while_loop(proceed, advance, (start, jnp.full_like(start, jnp.inf), 0))[0]


def _solve_tangent(linear, y):
    return jnp.linalg.solve(jax.jacfwd(linear)(jnp.zeros_like(y)), y)


def linearise(
    robot: Robot,
    point: OperatingPoint,
    friction: Float[Array, "axis"] | None = None,
    swing: Float[Array, "sample spring"] | None = None,
) -> LinearRobot:
    """Small motions about a point of rest, by automatic differentiation of the generalised forces.

    K includes the change of gravity with position and the local stiffness of nonlinear springs. Friction enters as a
    viscous coefficient: its slope at rest would describe speeds below the smoothing only.

    **Arguments:**

    - `friction`: f_eff of every axis, motor side, (axis,), N m s/rad, as `effective_friction` gives it; the robot's
      viscous friction where it is `None`.
    - `swing`: deflections about the point of rest over which the local stiffness is averaged, (sample, spring), rad: an
      experiment that moves far over a nonlinear spring sees its mean stiffness. `None`: the stiffness at rest.
    """
    viscous = ViscousFriction(robot.drives.friction.viscous if friction is None else jnp.asarray(friction))
    smooth = eqx.tree_at(lambda r: r.drives.friction, robot, viscous)

    def at(z, torque):
        rest = jnp.zeros_like(z)
        stiffness, damping = jax.jacfwd(generalised_forces, argnums=(1, 2))(smooth, z, rest, torque)
        return -stiffness, -damping

    dof, batch = robot.dof, point.z.shape[:-1]
    stiffness, damping = jax.vmap(at)(point.z.reshape(-1, dof), point.torque.reshape(-1, robot.n_axes))
    stiffness = stiffness.reshape(*batch, dof, dof)
    if swing is not None:
        more = local_stiffness(robot, point, swing) - local_stiffness(robot, point)
        springs = spring_directions(robot)
        stiffness = stiffness + jnp.einsum("is,...s,js->...ij", springs, more, springs)
    return LinearRobot(
        mass=inertia(robot, point.z),
        damping=damping.reshape(*batch, dof, dof),
        stiffness=stiffness,
        motor=motor_directions(robot),
    )


def local_stiffness(
    robot: Robot, point: OperatingPoint, swing: Float[Array, "sample spring"] | None = None
) -> Float[Array, "*batch spring"]:
    """Stiffness of every spring at its deflection, averaged over `swing` about it; N m/rad."""
    if swing is None:
        return robot.springs.tangent(point.deflection)
    return jnp.mean(robot.springs.tangent(point.deflection[..., None, :] + swing), axis=-2)
