"""The sampled joint controller: P on position, PI on velocity, torque limited and held."""

import equinox as eqx
import jax.numpy as jnp

from ..robot import Robot
from .plant import Columns, columns


class ControllerState(eqx.Module):
    """`reading`: the last measured motor position, (axis, run), rad. `integral`: e summed over T_i, rad/s."""

    reading: Columns
    integral: Columns


class Cascade(eqx.Module):
    """One sample of the cascade; the torque is held until the next.

        v = (q[k] - q[k-1]) fs
        e = K_p (q_ref - q) + v_ref - v
        u = K_v (e + sum(e)/(fs T_i)),   clipped to the torque limit.

    The speed is the difference of measured positions, as a drive with a resolver has it: it lags half a sample
    and carries the position noise times fs. The sum goes on while the torque is clipped.
    """

    position_gain: Columns
    velocity_gain: Columns
    integral_rate: Columns
    limit: Columns
    feedforward: bool = eqx.field(static=True)
    fs: float = eqx.field(static=True)

    @classmethod
    def of(cls, robot: Robot) -> "Cascade":
        settings, fs = columns(robot.controller), robot.sampling_frequency
        limit = columns(robot.drives.torque_limit)
        rate = 1.0 / (fs * settings.integral_time)
        return cls(settings.position_gain, settings.velocity_gain, rate, limit, settings.feedforward, fs)

    def at_rest(self, position: Columns, torque: Columns) -> ControllerState:
        """The state that holds a robot at rest with this torque; without integral part it starts from nothing."""
        held = (self.integral_rate > 0) & (self.velocity_gain > 0)
        return ControllerState(position, jnp.where(held, torque / jnp.where(held, self.velocity_gain, 1.0), 0.0))

    def torque(self, state: ControllerState, position: Columns, position_reference, velocity_reference):
        """Torque command from the measured position, and the next state."""
        speed = (position - state.reading) * self.fs
        error = self.position_gain * (position_reference - position) - speed
        error = error + velocity_reference if self.feedforward else error
        integral = state.integral + self.integral_rate * error
        torque = jnp.clip(self.velocity_gain * (error + integral), -self.limit, self.limit)
        return torque, ControllerState(position, integral)
