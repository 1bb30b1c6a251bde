"""The sampled joint controller: P on position, PI on velocity, torque limited and held."""

import equinox as eqx
import jax.numpy as jnp

from ..robot import Robot
from .plant import Columns, columns


class ControllerState(eqx.Module):
    """`reading`: the last measured motor position, (axis, run), rad. `integral`: e summed over T_i, rad/s. `speed`: the
    filtered one, rad/s."""

    reading: Columns
    integral: Columns
    speed: Columns


class Cascade(eqx.Module):
    """One sample of the cascade; the torque is held until the next.

        v = (q[k] - q[k-1]) fs, or that of a sensor,   through a first-order low-pass where there is one
        e = K_p (q_ref - q) + v_ref - v
        u = K_v (e + sum(e)/(fs T_i)),   clipped to the torque limit.

    The speed is the difference of measured positions, as a drive with a resolver has it: it lags half a sample
    and carries the position noise times fs; a sensor of the speed shows it at the sample, without noise. The sum
    goes on while the torque is clipped; with an anti-windup it waits where the error would clip it further.
    """

    position_gain: Columns
    velocity_gain: Columns
    integral_rate: Columns
    limit: Columns
    kept: Columns | None  # of the filtered speed, from sample to sample
    feedforward: bool = eqx.field(static=True)
    anti_windup: bool = eqx.field(static=True)
    speed_sensor: bool = eqx.field(static=True)
    fs: float = eqx.field(static=True)

    @classmethod
    def of(cls, robot: Robot) -> "Cascade":
        settings, fs = columns(robot.controller), robot.sampling_frequency
        limit = columns(robot.drives.torque_limit)
        rate = 1.0 / (fs * settings.integral_time)
        corner = settings.speed_filter
        return cls(
            settings.position_gain,
            settings.velocity_gain,
            rate,
            limit,
            None if corner is None else jnp.exp(-2.0 * jnp.pi * corner / fs),
            settings.feedforward,
            settings.anti_windup,
            settings.speed_sensor,
            fs,
        )

    def at_rest(self, position: Columns, torque: Columns) -> ControllerState:
        """The state that holds a robot at rest with this torque; without integral part it starts from nothing."""
        held = (self.integral_rate > 0) & (self.velocity_gain > 0)
        integral = jnp.where(held, torque / jnp.where(held, self.velocity_gain, 1.0), 0.0)
        return ControllerState(position, integral, jnp.zeros_like(position))

    def torque(
        self, state: ControllerState, position: Columns, sensed: Columns, position_reference, velocity_reference
    ):
        """Torque command from the measured position and what a sensor of the speed shows, and the next state."""
        speed = sensed if self.speed_sensor else (position - state.reading) * self.fs
        if self.kept is not None:
            speed = self.kept * state.speed + (1.0 - self.kept) * speed
        error = self.position_gain * (position_reference - position) - speed
        error = error + velocity_reference if self.feedforward else error
        integral = state.integral + self.integral_rate * error
        wanted = self.velocity_gain * (error + integral)
        if self.anti_windup:
            integral = jnp.where((jnp.abs(wanted) > self.limit) & (wanted * error > 0), state.integral, integral)
        return jnp.clip(wanted, -self.limit, self.limit), ControllerState(position, integral, speed)
