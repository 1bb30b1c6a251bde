"""The linearised robot as a state space, continuous or sampled; to python-control."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from .._annotated import checked
from .._errors import input_error
from .._types import Array
from .linearise import LinearRobot
from .quantity import derivatives


class StateSpace(eqx.Module):
    """State space x' = A x + B u, y = C x + D u (`sample_time` 0), or x(k+1) = A x(k) + B u(k) (`sample_time` in s).

    **Fields:** `A`: (*batch, state, state). `B`: (*batch, state, in). `C`: (*batch, out, state). `D`:
    (*batch, out, in).
    """

    A: Float[Array, "*batch state state"]
    B: Float[Array, "*batch state in"]
    C: Float[Array, "*batch out state"]
    D: Float[Array, "*batch out in"]
    sample_time: float = eqx.field(static=True, default=0.0)


@checked
@eqx.filter_jit
def state_space(model: LinearRobot, quantity: str = "velocity") -> StateSpace:
    """State space from motor torque to motor position, velocity or acceleration; the state is [dz, dz'].

    **Arguments:** `model`: of `jaxfrf.robot.linearise`; what its actuators and losses do is left out. `quantity`:
    `position`, `velocity` or `acceleration`.

    **Returns:** a continuous `StateSpace` with 2 dof states (rad, rad/s), inputs in N m, outputs in rad, rad/s or
    rad/s^2, motor side.

    **Raises:** `jaxfrf.InputError` for another quantity.

    **Source:** closed form, A = [0, 1; -M^-1 K, -M^-1 D] and B = [0; M^-1 B_motor].
    """
    dof, axes = model.motor.shape
    batch = model.mass.shape[:-2]
    motor = jnp.broadcast_to(model.motor, (*batch, dof, axes))
    right = jnp.concatenate([-model.stiffness, -model.damping, motor], axis=-1)
    accelerated = jnp.linalg.solve(model.mass, right)
    zero, eye = jnp.zeros((*batch, dof, dof)), jnp.broadcast_to(jnp.eye(dof), (*batch, dof, dof))
    A = jnp.concatenate(
        [jnp.concatenate([zero, eye], axis=-1), accelerated[..., : 2 * dof]],
        axis=-2,
    )
    B = jnp.concatenate([jnp.zeros_like(motor), accelerated[..., 2 * dof :]], axis=-2)
    rows = jnp.swapaxes(motor, -1, -2)
    C = jnp.concatenate([rows, jnp.zeros_like(rows)], axis=-1)
    D = jnp.zeros((*batch, axes, axes))
    for _ in range(derivatives(quantity)):
        C, D = C @ A, C @ B
    return StateSpace(A, B, C, D)


@checked
@eqx.filter_jit
def discretise(system: StateSpace, sampling_frequency: float) -> StateSpace:
    """The same system between samples with its input held (zero-order hold), by a matrix exponential.

    **Arguments:** `system`: continuous. `sampling_frequency`: Hz.

    **Returns:** a `StateSpace` with `sample_time` 1/`sampling_frequency`, s.

    **Raises:** `jaxfrf.InputError` for a system that is discrete already.

    **Source:** Van Loan, IEEE Trans. Automatic Control 23 (1978) 395-404.
    """
    if system.sample_time:
        raise input_error("system", f"sample_time {system.sample_time:g} s", "a continuous system", "Discretise once.")
    n, m = system.B.shape[-2:]
    top = jnp.concatenate([system.A, system.B], axis=-1) / sampling_frequency
    flat = jnp.concatenate([top, jnp.zeros((*top.shape[:-2], m, n + m))], axis=-2).reshape(-1, n + m, n + m)
    step = jax.vmap(jax.scipy.linalg.expm)(flat).reshape(*top.shape[:-2], n + m, n + m)
    return StateSpace(step[..., :n, :n], step[..., :n, n:], system.C, system.D, 1.0 / sampling_frequency)


@checked
@eqx.filter_jit
def state_space_frf(system: StateSpace, frequency: Float[Array, "freq"]) -> Complex[Array, "*batch freq out in"]:
    """C (s - A)^{-1} B + D at s = j w, or at z = e^{j w T} of a sampled system; (*batch, freq, out, in).

    **Arguments:** `system`: continuous or sampled. `frequency`: (freq,), Hz.

    **Returns:** (*batch, freq, out, in), unit of the output over that of the input.

    **Source:** the equation above.
    """
    omega = 2.0 * jnp.pi * jnp.asarray(frequency)
    point = jnp.exp(1j * omega * system.sample_time) if system.sample_time else 1j * omega
    n = system.A.shape[-1]
    resolvent = point[:, None, None] * jnp.eye(n) - system.A[..., None, :, :]
    right = jnp.broadcast_to(system.B[..., None, :, :], (*resolvent.shape[:-1], system.B.shape[-1]))
    return (
        system.C[..., None, :, :] @ jnp.linalg.solve(resolvent, right.astype(resolvent.dtype))
        + system.D[..., None, :, :]
    )


@checked
def to_control(system: StateSpace) -> Any:
    """The system as a `control.StateSpace` of python-control; one operating point (no batch axes).

    **Arguments:** `system`: continuous or sampled.

    **Returns:** a `control.StateSpace`.

    **Raises:** `jaxfrf.InputError` for several operating points; `ImportError` without python-control: `pip install
    'jaxfrf[control]'`.
    """
    try:
        import control
    except ImportError as error:
        raise ImportError("python-control is not installed: pip install 'jaxfrf[control]'") from error
    if system.A.ndim != 2:
        raise input_error(
            "system",
            f"{system.A.shape[:-2]} operating points",
            "one",
            "Take one: jax.tree.map(lambda x: x[0], system).",
        )
    matrices = (np.asarray(x) for x in (system.A, system.B, system.C, system.D))
    return control.ss(*matrices, system.sample_time) if system.sample_time else control.ss(*matrices)
