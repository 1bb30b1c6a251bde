"""What a diagnosis says."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..effects import AbstractEffect
from ..frf import FRF
from ..robot import Robot


class EstimatedValue(eqx.Module):
    """A number with its standard deviation and unit.

    **Fields:** `value`, `std`: in `unit`, an SI unit as text.
    """

    value: float = eqx.field(static=True)
    std: float = eqx.field(static=True)
    unit: str = eqx.field(static=True)


class Named(eqx.Module):
    """An effect that was found missing.

    **Fields:** `effect`: with its fitted parameters; `joint`: name of the joint, "" where it has none. `parameters`: by
    name. `p_value`: of the null that it is not there, on data that chose nothing; where they chose, family-wise.
    `equivalent`: names of effects that the data cannot tell from it. `separating_experiment`: what would. `explains`:
    part of the misfit above the floor that it removes, on positions that chose nothing. `visible`: its size over the
    just visible one. `is_number`: no term is missing, but a number of the robot is wrong by this.
    """

    effect: AbstractEffect
    joint: str = eqx.field(static=True)
    parameters: dict[str, EstimatedValue]
    p_value: float = eqx.field(static=True)
    equivalent: tuple[str, ...] = eqx.field(static=True)
    separating_experiment: str = eqx.field(static=True)
    explains: float = eqx.field(static=True)
    visible: float = eqx.field(static=True)
    is_number: bool = eqx.field(static=True, default=False)

    @property
    def name(self) -> str:
        return self.effect.name


class WrongNumber(eqx.Module):
    """A number of the robot that is further off than is known of it, where no term need be missing for that.

    **Fields:** `name`: e.g. `joint3.coulomb_friction`. `value`, `std`: as fitted, in `unit`; `given`: as the robot's
    file states it; `change`: from there, in words. `p_value`: of so large an error among all numbers of the robot, were
    their tolerances true.
    """

    name: str = eqx.field(static=True)
    value: float = eqx.field(static=True)
    std: float = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    given: float = eqx.field(static=True)
    change: str = eqx.field(static=True)
    p_value: float = eqx.field(static=True)


class Ranked(eqx.Module):
    """A candidate in the order of what it explains alone.

    **Fields:** `name`: of the effect; `joint`: its name, "" where it has none. `score`: part of the misfit that it
    removes. `p_value`: of the null that it is not there, family-wise. `expected`: its parameters without a refit, in
    their units. `visible`: its size over the just visible one; below 1 the data could not show it. `why`: why it was
    taken or not, in words.
    """

    name: str = eqx.field(static=True)
    joint: str = eqx.field(static=True)
    score: float = eqx.field(static=True)
    p_value: float = eqx.field(static=True)
    expected: dict[str, float]
    visible: float = eqx.field(static=True)
    why: str = eqx.field(static=True)


class Cell(eqx.Module):
    """Where model and measurement differ: one joint's torque in one band at one position.

    **Fields:** `position`: from 0; `None`: all of them together. `channel`: name of the joint. `band_hz`: lowest and
    highest frequency, Hz. `z`: rms over the floor. `says`: one sentence.
    """

    position: int | None = eqx.field(static=True)
    channel: str = eqx.field(static=True)
    band_hz: tuple[float, float] = eqx.field(static=True)
    z: float = eqx.field(static=True)
    says: str = eqx.field(static=True)


class Gap(eqx.Module):
    """rms residual (of the torque, unless `quantity` says another) of the robots that are written, before and after,
    over its floor, on positions that nothing was fitted to.

    **Fields:** `before`, `after`: in `unit`; "1" of the torque's residual says over the floor of every line. `floor`:
    what noise and an honest model leave, in that unit. `shrink` = 1 - (after - floor)/(before - floor). `on`: which
    positions or records it was taken on, in words. `quantity`: what the residual is called. `torque_before`,
    `torque_after`: the same residual over the rms torque (of another quantity: in `unit`), per axis, (axis,).
    """

    before: float = eqx.field(static=True)
    after: float = eqx.field(static=True)
    floor: float = eqx.field(static=True)
    shrink: float = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    on: str = eqx.field(static=True)
    torque_before: Float[np.ndarray, "axis"]
    torque_after: Float[np.ndarray, "axis"]
    quantity: str = eqx.field(static=True, default="torque residual")


class Maps(eqx.Module):
    """Pictures of the residual before and after, on all positions.

    **Fields:** `before`, `after`: rms over the floor, (pos, axis, band). `bands`: edges, Hz, (band + 1,). `courses`:
    mean torque residual of every axis, N m, against a signal: {"speed" | "angle" | "load": (signal (axis, bin), before
    (axis, bin), after (axis, bin))}; signals in rad/s motor side, rad arm side, N m motor side.
    """

    before: Float[np.ndarray, "pos axis band"]
    after: Float[np.ndarray, "pos axis band"]
    bands: Float[np.ndarray, "edge"]
    courses: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]


class Diagnosis(eqx.Module):
    """The result of `jaxfrf.gap.diagnose`.

    **Fields:** `verdict`: `sufficient` (nothing is missing), `named` (by `effects`), `ambiguous` (several explain it as
    well), `unexplained` or `inconclusive` (the data do not tell); `says`: the verdict in a sentence or two. `effects`:
    named ones, in the order in which they were found. `wrong_numbers`: of the robot, off by more than is known of them,
    where what the robot is made of holds. `ranking`: of all candidates, the first few. `where`: the largest
    cells before. `gap`, `maps`. `parameters`: of the extended model, by name, with `changed` the relative change from
    the given robot in the same order. `given`, `base`, `extended`: robots: as given, refitted, with the effects; the
    last two have the ripple that their motors show, too, and gap and maps are theirs, simulated. `compared`: how
    measurement and model were compared. `fitted`, `heldout`: positions. `frf`: measured, base and extended FRF on the
    held-out positions, estimated alike. `next_experiment`: what to do next. `sources`: of the data. `settings`.
    """

    verdict: str = eqx.field(static=True)
    says: str = eqx.field(static=True)
    effects: tuple[Named, ...]
    ranking: tuple[Ranked, ...]
    where: tuple[Cell, ...]
    gap: Gap
    maps: Maps
    parameters: dict[str, EstimatedValue]
    changed: dict[str, float]
    given: Robot
    base: Robot
    extended: Robot
    compared: str = eqx.field(static=True)
    fitted: tuple[int, ...] = eqx.field(static=True)
    heldout: tuple[int, ...] = eqx.field(static=True)
    frf: tuple[FRF, FRF, FRF] | None
    next_experiment: str = eqx.field(static=True)
    sources: tuple = ()
    settings: dict = eqx.field(default_factory=dict)
    wrong_numbers: tuple[WrongNumber, ...] = ()

    @property
    def axis_names(self) -> tuple[str, ...]:
        return self.base.axis_names

    @property
    def ripple(self) -> dict[str, list[int]]:
        """Orders of ripple by joint that the refitted robot has and the given one had not."""
        waves = lambda robot: [effect for effect in robot.effects if hasattr(effect, "order")]
        orders: dict[str, list[int]] = {}
        for effect in waves(self.base)[len(waves(self.given)) :]:
            orders.setdefault(str(effect.joint), []).extend(effect.order)
        return {joint: sorted(set(found)) for joint, found in orders.items()}
