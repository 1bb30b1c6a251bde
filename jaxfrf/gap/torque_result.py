"""What a diagnosis by inverse dynamics found."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..effects import AbstractEffect
from ..robot import Robot
from .torque_where import Remainder


class Value(eqx.Module):
    """A number with its standard deviation (NaN where it was held) and unit."""

    value: float
    std: float
    unit: str = eqx.field(static=True)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval."""
        return self.value - 1.96 * self.std, self.value + 1.96 * self.std


class NamedEffect(eqx.Module):
    """An effect that the data call for.

    **Fields:** `effect`: itself, with its values; `name`, `joint`. `parameters`: name -> `Value`. `p_value`:
    family-wise. `share`: of the reducible gap on held-out stretches that it took away when it was added. `equivalent`:
    effects that the data cannot tell from it. `separating_experiment`: what would.
    """

    effect: AbstractEffect
    name: str = eqx.field(static=True)
    joint: str = eqx.field(static=True)
    parameters: dict[str, Value]
    p_value: float
    share: float
    equivalent: tuple[str, ...] = eqx.field(static=True)
    separating_experiment: str = eqx.field(static=True)


class Ranked(eqx.Module):
    """A candidate at the first step: `score` is the share of the residual's power that it explains."""

    name: str = eqx.field(static=True)
    joint: str = eqx.field(static=True)
    score: float
    p_value: float


class TorqueGap(eqx.Module):
    """Rms of the torque residual over the rms of the measured torque, over all axes.

    **Fields:** `nominal`: of the robot as it was given. `before`: its own parameters refitted. `after`: with the named
    effects. `floor`: what no function of the motion explains. `newton_metres`: the same four as rms of the residual of
    all axes, N m. `axis_before`, `axis_after`: of every axis by itself. `on`: the data that it stands for. `shrink`:
    1 - (after - floor)/(before - floor).
    """

    nominal: float
    before: float
    after: float
    floor: float
    newton_metres: dict[str, float]
    axis_before: Float[np.ndarray, "axis"]
    axis_after: Float[np.ndarray, "axis"]
    on: str = eqx.field(static=True)

    @property
    def shrink(self) -> float:
        reducible = self.before - self.floor
        return 1.0 - (self.after - self.floor) / reducible if reducible > 0 else 0.0


class TorqueDiagnosis(eqx.Module):
    """What `diagnose_torque` found.

    **Fields:**

    - `verdict`: `sufficient`, `named`, `ambiguous`, `unexplained` or `inconclusive`; `says`: the same in words.
    - `effects`: in the order in which they were found. `ranking`: all candidates at the first step, best first.
    - `gap`: on the sealed records, or on held-out stretches where there are none. `fit_gap`: on the fitted records.
    - `parameters`: the robot's own, refitted with the effects, name -> `Value`.
    - `where`: what the remaining residual goes with.
    - `given`, `base`: the robot as it was given, and refitted. `robot`: refitted with the effects; `base` where nothing
      was named.
    - `remarks`: sentences. `left_out`: effects that were not assessed, name -> why. `cutoff`: of the filter, Hz.
    """

    verdict: str = eqx.field(static=True)
    says: str = eqx.field(static=True)
    effects: tuple[NamedEffect, ...]
    ranking: tuple[Ranked, ...]
    gap: TorqueGap
    fit_gap: TorqueGap
    parameters: dict[str, Value]
    where: tuple[Remainder, ...]
    given: Robot
    base: Robot
    robot: Robot
    remarks: tuple[str, ...] = eqx.field(static=True)
    left_out: dict[str, str] = eqx.field(static=True)
    cutoff: float = eqx.field(static=True)
