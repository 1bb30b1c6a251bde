"""Frequency response of the robot with its derivative in springs, dampers and friction."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._annotated import checked
from .._types import Array
from .equations import arm_inertia, spring_directions
from .linearise import GearLoss, LinearRobot, gravity_stiffness, linearise, local_stiffness, operating_point
from .response import ZeroOrderHold, actuated_sampling, aliases, high_frequency, motion
from .robot import Robot


class ParametricResponse(eqx.Module):
    """An FRF and its derivative in the parameters of the linearised robot.

    **Fields:** `G`: (*batch, freq, axis, axis). `jacobian`: dG/dtheta, (*batch, freq, axis, axis, parameter).
    `names`: of the parameters, as `joint1.stiffness`, `bearing2.damping`, `joint1.effective_friction`.
    """

    G: Complex[Array, "*batch freq axis axis"]
    jacobian: Complex[Array, "*batch freq axis axis parameter"]
    names: tuple[str, ...] = eqx.field(static=True)


@checked
def frf_and_jacobian(
    robot: Robot,
    arm_angles: Float[Array, "*batch axis"],
    frequency: Float[Array, "freq"],
    quantity: str = "velocity",
    hold: ZeroOrderHold | None = None,
    delay: Float[Array, "axis"] | float = 0.0,
    friction: Float[Array, "axis"] | None = None,
    deflections: Float[Array, "sample spring"] | None = None,
) -> ParametricResponse:
    """FRF at operating points under gravity, with its derivative in stiffness, damping and friction.

    A spring between coordinates along w adds k w w^T to the dynamic stiffness S, so with X = S^{-1} B, which
    G needs anyway,

        dG/dk = -(w^T X)^T (w^T X),   dG/dd = -j w (w^T X)^T (w^T X),

    an outer product. The stiffness of an elastic joint also moves the equilibrium, and with it inertia,
    gravity and the other springs' local stiffness; that part is included. Stiffness means k at high
    deflection where a spring is nonlinear. Where effects make stiffness complex, k scales that as well.

    **Arguments:**

    - `robot`: with its springs, friction and effects.
    - `arm_angles`: at rest, (*batch, axis), rad. `frequency`: (freq,), Hz, above 0.
    - `quantity`: `position`, `velocity` or `acceleration` of the motors. `hold`, `delay` (s): of the torque, as of
      `frf`.
    - `friction`: f_eff of every axis, motor side, (axis,), N m s/rad, and `deflections`, (sample, spring), rad: as of
      `linearise`.

    **Returns:** a `ParametricResponse`: G, (*batch, freq, axis, axis), and its derivative by each of
    `parameter_names`, in the unit of G over that of the parameter.

    **Raises:** `jaxfrf.InputError` for another quantity, and for another number of angles than driven joints.

    **Source:** the equation above, the derivative of an inverse; the equilibrium's part by the implicit function
    theorem.
    """
    friction = robot.drives.friction.viscous if friction is None else friction
    at, frequency, delay, friction = (jnp.asarray(x) for x in (arm_angles, frequency, delay, friction))
    return _frf_and_jacobian(robot, at, frequency, delay, friction, quantity, hold, deflections)


@eqx.filter_jit
def _frf_and_jacobian(robot: Robot, arm_angles, frequency, delay, friction, quantity, hold, deflections):
    omega = 2.0 * jnp.pi * frequency
    model, slopes = _with_slopes(robot, arm_angles.reshape(-1, arm_angles.shape[-1]), friction, deflections)
    factor, corrections = actuated_sampling(model, omega, quantity, hold, delay)
    motor, partners = model.motor, model.partners
    rebuilt = lambda matrices: tuple(GearLoss(x.group, m) for x, m in zip(model.losses, matrices, strict=True))

    complex_share = _complex_share(robot, model, omega)

    def at(position):
        (mass, damping, stiffness, losses), slope = position
        model = LinearRobot(mass, damping, stiffness, motor, partners, (), rebuilt(losses))
        X = motion(model, omega)
        position = motor.T @ X
        G = position * factor + aliases(model, hold, corrections)
        derivative = _rank_one(robot, slope, X, position, omega, factor, complex_share)
        if hold is not None:
            derivative = derivative + _alias_slopes(robot, model, slope, hold, corrections)
        return G, derivative

    matrices = (model.mass, model.damping, model.stiffness, tuple(loss.stiffness for loss in model.losses))
    batch = arm_angles.shape[:-1]
    if not batch:  # no loop, so that the compiler can merge what comes after with what is here
        G, jacobian = at(jax.tree.map(lambda x: x[0], (matrices, slopes)))
        return ParametricResponse(G, jacobian, parameter_names(robot))
    # One position after the other: what a position needs then stays in the cache.
    G, jacobian = jax.lax.map(at, (matrices, slopes))
    return ParametricResponse(
        G.reshape(*batch, *G.shape[1:]), jacobian.reshape(*batch, *jacobian.shape[1:]), parameter_names(robot)
    )


@checked
def parameter_names(robot: Robot) -> tuple[str, ...]:
    """Names of the parameters of `frf_and_jacobian`: stiffnesses, then dampings, then effective frictions.

    **Arguments:** `robot`: whose springs and axes they are of.

    **Returns:** names as `joint1.stiffness`, in the order of `ParametricResponse.jacobian`.
    """
    return (
        *(f"{joint}.stiffness" for joint in robot.spring_names),
        *(f"{joint}.damping" for joint in robot.spring_names),
        *(f"{joint}.effective_friction" for joint in robot.axis_names),
    )


class _Slopes(eqx.Module):
    """Derivatives in the springs' stiffness k.

    `local`: of each local stiffness in its own k, (*batch, spring). The stiffness of elastic joints moves the
    equilibrium: `others`, of all local stiffnesses, (*batch, spring, elastic); `mass` and `gravity`, of the
    inertia of the arm and of its gravity stiffness, (*batch, arm, arm, elastic).
    """

    local: jax.Array
    others: jax.Array
    mass: jax.Array
    gravity: jax.Array


def _with_slopes(robot: Robot, arm_angles, friction, deflections) -> tuple[LinearRobot, _Slopes]:
    motors, first = robot.n_motors, robot.n_motors + robot.n_axes

    def rest(k):
        changed = eqx.tree_at(lambda r: r.springs.stiffness, robot, k)
        point = operating_point(changed, arm_angles)
        return (local_stiffness(changed, point, deflections), point.z[..., first:]), point

    def carried(elastic):
        arm = jnp.concatenate([arm_angles, elastic], axis=-1)
        return arm_inertia(robot, arm), gravity_stiffness(robot, arm)

    (local, elastic), point = jax.jacfwd(rest, has_aux=True)(robot.springs.stiffness)
    along = lambda tangent: jax.jvp(carried, (point.z[..., first:],), (tangent,))[1]
    mass, gravity = jax.vmap(along, in_axes=-1, out_axes=-1)(elastic[..., motors:])
    own = jnp.diagonal(local, axis1=-2, axis2=-1)
    return linearise(robot, point, friction, deflections), _Slopes(own, local[..., motors:], mass, gravity)


def _complex_share(robot: Robot, model: LinearRobot, omega):
    """Complex stiffness of every spring over its real one, (freq, spring), or `None` where nothing is lost in them."""
    if not model.losses:
        return None
    axes = jnp.ones((robot.n_axes, omega.size), complex)
    for loss in model.losses:
        axes = loss.group.added(axes, jax.vmap(lambda e: e.response(1j * omega))(loss.group.effects))
    gears = axes[np.array(robot.flexible_axes, int)]
    return jnp.concatenate([gears, jnp.ones((robot.n_elastic, omega.size), complex)]).T


def _rank_one(robot: Robot, slope: _Slopes, X, position, omega, factor, complex_share):
    """Derivative of `factor` times the position FRF: (freq, axis, axis, parameter)."""
    n_gears, n_springs = robot.n_motors, robot.n_motors + robot.n_elastic
    stretch = _stretch(robot, X)
    across = jnp.concatenate([stretch, stretch, jnp.swapaxes(position, 1, 2)], axis=-1)
    gears = jnp.arange(n_springs) < n_gears
    static = jnp.broadcast_to(jnp.where(gears, slope.local, 0.0), (omega.size, n_springs))
    static = static if complex_share is None else static * complex_share
    moving = jnp.broadcast_to(1j * omega[:, None], (omega.size, n_springs + robot.n_axes))
    left = -across * jnp.concatenate([static, moving], axis=1)[:, None]
    late = jnp.swapaxes(jnp.broadcast_to(factor, (omega.size, 1, robot.n_axes)), 1, 2)
    columns = left[:, :, None] * (across * late)[:, None]
    if not robot.n_elastic:
        return columns
    tight = stretch if complex_share is None else stretch * complex_share[:, None]
    elastic = _moved_equilibrium(slope, X[:, n_gears:], stretch, tight, omega) * late[:, None]
    return jnp.concatenate([columns[..., :n_gears], elastic, columns[..., n_springs:]], axis=-1)


def _stretch(robot: Robot, X):
    """Deflection of every spring per unit torque, (freq, axis, spring)."""
    springs = spring_directions(robot)
    of = lambda part: jnp.einsum("fia,is->fas", part, springs)  # a real product each: half the work of a complex one
    return jax.lax.complex(of(X.real), of(X.imag))


def _moved_equilibrium(slope: _Slopes, X, across, tight, omega):
    """-X^T (dK - w^2 dM) X, the derivative in the elastic joints' stiffness: (freq, out, in, elastic)."""
    parts = jnp.stack([X.real, X.imag])  # a real product each: half the work of a complex one
    matrices = jnp.concatenate([slope.gravity, slope.mass], axis=-1)
    products = jnp.einsum("cfja,ije->cfiae", parts, matrices)
    n = slope.mass.shape[-1]
    products = products[..., :n] - jnp.square(omega)[:, None, None, None] * products[..., n:]
    moved = jax.lax.complex(products[0], products[1])
    arm = jnp.sum(X[:, :, :, None, None] * moved[:, :, None], axis=1)
    tight = jnp.einsum("fos,fas,se->foae", across, tight, slope.others.astype(across.dtype))
    return -(arm + tight)


def _alias_slopes(robot: Robot, model: LinearRobot, slope: _Slopes, hold: ZeroOrderHold, corrections):
    """Derivative of `aliases`: (freq, axis, axis, parameter)."""
    springs, n_gears, n_elastic, dof = spring_directions(robot), robot.n_motors, robot.n_elastic, robot.dof
    squares = jnp.einsum("is,js->sij", springs, springs)
    turns = jnp.einsum("ia,ja->aij", model.motor, model.motor)
    none = lambda count: jnp.zeros((count, dof, dof))
    arm = lambda x: jnp.pad(jnp.moveaxis(x, -1, 0), ((0, 0), (n_gears, 0), (n_gears, 0)))
    gears = squares[:n_gears] * slope.local[:n_gears, None, None]
    elastic = jnp.einsum("sij,se->eij", squares, slope.others) + arm(slope.gravity)
    after = none(n_gears + n_elastic + robot.n_axes)
    mass = jnp.concatenate([none(n_gears), arm(slope.mass), after])
    stiffness = jnp.concatenate([gears, elastic, after])
    damping = jnp.concatenate([none(n_gears + n_elastic), squares, turns])

    plain = LinearRobot(model.mass, model.damping, model.stiffness, model.motor, model.partners)

    def along(dm, dd, dk):
        tangent = LinearRobot(dm, dd, dk, jnp.zeros_like(model.motor), model.partners)
        return jnp.stack(jax.jvp(lambda m: tuple(high_frequency(m, hold.order)), (plain,), (tangent,))[1])

    terms = jnp.moveaxis(jax.vmap(along)(mass, damping, stiffness), 0, -1)  # (term, axis, axis, parameter)
    return sum(c[..., None] * term for c, term in zip(corrections, terms, strict=True))
