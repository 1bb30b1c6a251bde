"""The sampled joint controller as a robot's file states it: its settings and its law, line by line."""

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from .._annotated import check_fields
from .._types import Array


class Controller(eqx.Module):
    """Settings of the sampled joint controller, as the robot's file states them; the simulation acts on them.

    Velocity error e = position_gain (q_ref - q_m) + v_ref - v_m; torque
    u = velocity_gain (e + integral(e)/integral_time).

    **Arguments:** numbers for all axes, or one for each, (axis,)

    - `position_gain`: 1/s. `integral_time`: s; `inf` = no integral part. `velocity_gain`: (axis,), N m s/rad, motor
      side.
    - `feedforward`: whether the speed reference v_ref is added.
    - `speed_filter`: corner of a first-order low-pass of the measured speed v_m, Hz; `None`: there is none.
    - `speed_sensor`: whether v_m is read from a sensor of the motor's speed at the sample, not the difference of two
      measured positions, which lags half a sample. The simulation's is without noise, and what disturbs sensors of the
      position (`jaxfrf.effects`) does not act on it.
    - `anti_windup`: whether the integral waits while the torque is clipped and the error would clip it further.
    """

    position_gain: Float[Array, "..."]
    integral_time: Float[Array, "..."]
    velocity_gain: Float[Array, "axis"]
    feedforward: bool = eqx.field(static=True, default=True)
    speed_filter: Float[Array, "..."] | None = None
    anti_windup: bool = eqx.field(static=True, default=False)
    speed_sensor: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        check_fields(self)

    def command(
        self,
        frequency: Float[Array, "freq"],
        sampling_frequency: float,
        position: Complex[np.ndarray, "... freq axis"],
        velocity: Complex[np.ndarray, "... freq axis"],
        measured: Complex[np.ndarray, "... freq axis"],
    ) -> Complex[np.ndarray, "... freq axis"]:
        """Torque command for references and measured motor position, lines of one period, N m.

        Sampled as it runs: the speed is the difference of two positions or what a sensor reads, filtered, the integral
        the sum of all errors. Limits of the torque are left out. `frequency`: Hz, above 0. `position`, `measured`: rad.
        `velocity`: rad/s.
        """
        s = 2j * np.pi * np.asarray(frequency)[:, None]
        back = np.exp(-s / sampling_frequency)
        speed = s if self.speed_sensor else sampling_frequency * (1.0 - back)
        if self.speed_filter is not None:
            kept = np.exp(-2 * np.pi * np.asarray(self.speed_filter) / sampling_frequency)
            speed = speed * (1.0 - kept) / (1.0 - kept * back)
        error = np.asarray(self.position_gain) * (position - measured) - speed * measured
        if self.feedforward:
            error = error + velocity
        rate = 1.0 / (sampling_frequency * np.asarray(self.integral_time))
        return np.asarray(self.velocity_gain) * error * (1.0 + rate / (1.0 - back))

    def feedback(self, frequency: Float[Array, "freq"], sampling_frequency: float) -> Complex[np.ndarray, "freq axis"]:
        """FRF from measured motor position to the torque that the controller takes back, -du/dq, N m/rad.

        As `command` says it. `frequency`: Hz, above 0.
        """
        nothing = np.zeros(())
        return -self.command(frequency, sampling_frequency, nothing, nothing, np.ones(()))
