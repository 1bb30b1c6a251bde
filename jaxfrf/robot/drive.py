"""Drive trains: motors behind gears, the springs of transmissions and bearings, motor friction.

A spring or a friction law is a small module that acts on all its joints at once. Another law is another
subclass.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float

from .._annotated import check_fields, checked
from .._types import Array


class AbstractSpring(eqx.Module):
    """Springs and dampers, one for every flexible transmission and elastic joint.

    `deflection` (*batch, spring) is in rad on the arm side, the torque in N m. `stiffness` (at high deflection,
    N m/rad) and `damping` (N m s/rad): of every spring.
    """

    stiffness: eqx.AbstractVar[Float[Array, "spring"]]
    damping: eqx.AbstractVar[Float[Array, "spring"]]

    @abc.abstractmethod
    def torque(self, deflection, rate) -> Float[Array, "*batch spring"]:
        """Torque that resists the deflection and its rate, rad and rad/s."""

    @abc.abstractmethod
    def tangent(self, deflection) -> Float[Array, "*batch spring"]:
        """Local stiffness, d torque / d deflection at rest, N m/rad."""

    @abc.abstractmethod
    def energy(self, deflection) -> Float[Array, "*batch"]:
        """Energy stored in all springs together, J."""


class Spring(AbstractSpring):
    """A spring that stiffens from k_lo at zero to k_hi at high deflection, with a linear damper.

        tau = k x - k (1 - rho) x0 tanh(x/x0) + d x',    k = k_hi, rho = k_lo/k_hi

    rho = 1 is a linear spring. Stating the ratio and not k_lo keeps the shape when `stiffness` is identified.

    **Arguments:** (each of shape (spring,))

    - `stiffness`: k, N m/rad, at high deflection.
    - `damping`: d, N m s/rad.
    - `stiffness_ratio`: rho. `stiffness_knee`: x0, rad; not zero even where the ratio is 1.
    - `backlash`: b, rad, or `None` where no gear has play. x is then what is left of the deflection beyond
      +-b/2, with corners rounded over b/20; a thousandth of the deflection inside the gap keeps the point of rest
      of an unloaded joint defined. The damper acts as the spring does.

    **Source:** the equation above, this project's own: a smooth law between two stiffnesses.
    """

    stiffness: Float[Array, "spring"]
    damping: Float[Array, "spring"]
    stiffness_ratio: Float[Array, "spring"]
    stiffness_knee: Float[Array, "spring"]
    backlash: Float[Array, "spring"] | None = None

    def __check_init__(self):
        check_fields(self)

    def torque(self, deflection, rate):
        if self.backlash is not None:
            deflection, slope = _beyond_play(deflection, self.backlash)
            rate = slope * rate
        knee = self.stiffness_knee
        shape = deflection - (1.0 - self.stiffness_ratio) * knee * jnp.tanh(deflection / knee)
        return self.stiffness * shape + self.damping * rate

    def tangent(self, deflection):
        slope = 1.0
        if self.backlash is not None:
            deflection, slope = _beyond_play(deflection, self.backlash)
        bend = 1.0 - jnp.square(jnp.tanh(deflection / self.stiffness_knee))
        return self.stiffness * (1.0 - (1.0 - self.stiffness_ratio) * bend) * slope

    def energy(self, deflection):
        if self.backlash is not None:
            raise NotImplementedError("The energy of springs with play has no closed form here.")
        x = jnp.abs(deflection / self.stiffness_knee)
        log_cosh = x + jnp.log1p(jnp.exp(-2.0 * x)) - jnp.log(2.0)
        soft = (1.0 - self.stiffness_ratio) * jnp.square(self.stiffness_knee) * log_cosh
        return jnp.sum(self.stiffness * (0.5 * jnp.square(deflection) - soft), axis=-1)


_INSIDE = 1e-3  # of the stiffness, inside the gap
_CORNER = 0.05  # of the gap


def _beyond_play(x, gap):
    """The deflection beyond +-gap/2, and its slope; x itself where the gap is zero."""
    open_gap = gap > 0.0
    corner = jnp.where(open_gap, _CORNER * gap, 1.0)
    right, left = (x + 0.5 * gap) / corner, (x - 0.5 * gap) / corner
    log_cosh = lambda y: jnp.abs(y) + jnp.log1p(jnp.exp(-2.0 * jnp.abs(y)))
    inside = 0.5 * corner * (log_cosh(right) - log_cosh(left))  # clip(x, -gap/2, gap/2) with round corners
    slope = 0.5 * (jnp.tanh(right) - jnp.tanh(left))
    keep = 1.0 - _INSIDE
    return jnp.where(open_gap, x - keep * inside, x), jnp.where(open_gap, 1.0 - keep * slope, 1.0)


class AbstractFrictionLaw(eqx.Module):
    """Friction of the motors, on the motor side, one for every driven joint; `viscous`: its linear part, N m s/rad."""

    viscous: eqx.AbstractVar[Float[Array, "axis"]]

    @abc.abstractmethod
    def torque(self, speed) -> Float[Array, "*batch axis"]:
        """Torque against the motor speed (*batch, axis), rad/s; N m."""


class Friction(AbstractFrictionLaw):
    """Viscous and smoothed Coulomb friction, tau = f v + c tanh(v/eps).

    It is not to be linearised at rest, where its slope f + c/eps holds for speeds below eps only: see
    `jaxfrf.robot.effective_friction`.

    **Arguments:** `viscous`: f, (axis,), N m s/rad. `coulomb`: c, (axis,), N m. `smoothing`: eps, rad/s.

    **Source:** Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083-1138, where the sign is not
    smoothed.
    """

    viscous: Float[Array, "axis"]
    coulomb: Float[Array, "axis"]
    smoothing: Float[Array, ""]

    def __check_init__(self):
        check_fields(self)

    def torque(self, speed):
        return self.viscous * speed + self.coulomb * jnp.tanh(speed / self.smoothing)


class ViscousFrictionLaw(AbstractFrictionLaw):
    """Viscous friction alone, tau = f v; `viscous`: (axis,), N m s/rad.

    **Source:** the equation above.
    """

    viscous: Float[Array, "axis"]

    def __check_init__(self):
        check_fields(self)

    def torque(self, speed):
        return self.viscous * speed


@checked
def effective_friction(friction: AbstractFrictionLaw, amplitude: Float[Array, "axis"] | float) -> Float[Array, "axis"]:
    """Gain of the friction for small motion on top of a slow sine of this speed: f + 2 c/(pi A), N m s/rad.

    The mean slope of c sgn(v) over v = A sin(phi) is 2 c/(pi A). It fails where the speed does not reverse
    cleanly (A not large against the smoothing, or the excitation not small against A).

    **Arguments:** `friction`: of the motors; another law than `Friction` gives its viscous part. `amplitude`: A, motor
    side, (axis,) or a number, rad/s.

    **Returns:** (axis,), N m s/rad.

    **Source:** Gelb & Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968.
    """
    if not isinstance(friction, Friction):
        return friction.viscous
    return friction.viscous + 2.0 * friction.coulomb / (jnp.pi * amplitude)


class Drives(eqx.Module):
    """The motors and gears of all driven joints, base to tip.

    **Arguments:**

    - `motor_inertia`: (axis,), kg m^2. `gear_ratio`: motor turns per joint turn, (axis,).
    - `torque_limit`: of the motor, (axis,), N m; `inf` where there is none.
    - `friction`: of the motors.
    - `zero`: readings of the motors in a log, (axis,), rad, where the joints' angles are zero; `None`: zero. Used where
      a log's motor angles are turned into the arm's.
    """

    motor_inertia: Float[Array, "axis"]
    gear_ratio: Float[Array, "axis"]
    torque_limit: Float[Array, "axis"]
    friction: AbstractFrictionLaw
    zero: Float[Array, "axis"] | None = None

    def __check_init__(self):
        check_fields(self)

    def turned(self, reading: Float[Array, "*batch axis"]) -> Float[Array, "*batch axis"]:
        """Motor angles behind readings of a log, rad: 0 where the joints' angles are."""
        return reading if self.zero is None else reading - self.zero
