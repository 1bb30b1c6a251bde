"""What a machine of one's own is missing: effects tried in turn, and what they explain of what no fit saw."""

import functools
from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Complex, Float

from .._arguments import expect, expect_each
from .._errors import InputError, input_error
from .._text import number, percent
from ..effects import AbstractEffect, Swing, library
from ..experiment import Experiment
from .fit import ENOUGH, FLOOR, MachineFit, fitted, measured_lines, of_hold, share_left
from .forces import CubicSpring
from .model import Machine
from .simulate import driving, simulate_machine

_LEAST_GAIN = 0.15  # part of the held-out gap that an effect has to close
_ALIKE = 1.3  # times what the best effect leaves on the held-out part: with less, another explains as well
_SURE = 3.0  # standard deviations of its largest number from 0
_EVERY = 3  # line that is held out, where there is one experiment
_SHAPES = ("width",)  # stays where it starts, as shapes of an effect itself do: a record seldom tells it
_SLOW = 0.02  # of a place's rms speed, within which friction may turn
_LEAST_FORCE = 0.05  # of the driving force's rms, at which an effect starts

Say = Callable[[str], None]


class MachineDiagnosis(eqx.Module):
    """What a machine is missing.

    **Fields:**

    - `verdict`: `sufficient` (it explains the record as it is), `named` (by `effects`), `ambiguous` (as well by one of
      `rivals`) or `unexplained`.
    - `effects`: that were added, with their numbers. `rivals`: effects in the place of the last one that leave as
      little. `before`, `fit`: without and with them.
    - `heldout`: what is left on the held-out experiment or lines over what was measured there, at first and with every
      effect.
    - `tried`: (place, effect, what it leaves on the held-out part) of every candidate, in the order of trial.
    - `doubt`: in words, where u does not look like what `hold` says between its samples; else empty.
    """

    verdict: str = eqx.field(static=True)
    effects: tuple[AbstractEffect, ...]
    rivals: tuple[AbstractEffect, ...]
    before: MachineFit
    fit: MachineFit
    heldout: tuple[float, ...] = eqx.field(static=True)
    tried: tuple[tuple[str, str, float], ...] = eqx.field(static=True)
    doubt: str = eqx.field(static=True, default="")

    def __str__(self) -> str:
        gap = " -> ".join(percent(x, 3) for x in self.heldout)
        named = "; ".join(f"{e.name} at {e.joint}" for e in self.effects) or "no effect"
        more = f"; or, in the place of the last: {', '.join(f'{e.name} at {e.joint}' for e in self.rivals)}"
        return f"{self.verdict}: {named} (left on the held-out part: {gap}){more if self.rivals else ''}" + (
            f"; {self.doubt}" if self.doubt else ""
        )


def diagnose_machine(
    machine: Machine,
    data: Experiment,
    candidates: Sequence[AbstractEffect] | None = None,
    *,
    band: tuple[float, float] | None = None,
    settle: int | None = None,
    floor: float = FLOOR,
    most: int = 2,
    hold: bool = True,
    say: Say = lambda _: None,
) -> MachineDiagnosis:
    """Find which effects a machine of your own is missing.

    The machine is fitted; then every candidate with all its other parameters, and the one that leaves least stays, up
    to `most` of them. The last of several experiments is held out, else every third line: no fit sees it, and an effect
    stays only if it closes a sixth of what is left there, has a sign that it can have, and differs from 0 by three
    standard deviations. Where another leaves as little, or both less than `floor`, the verdict is `ambiguous`.

    Says less than it seems where the machine's own matrices are wrong (a missing mass is nobody's friction), and with
    one experiment, whose held-out lines share its amplitude with the others: other amplitudes tell springs apart. Where
    u is not what `hold` says no effect explains the record, and `doubt` tells.

    **Arguments:**

    - `machine`: as it is known, with places. `data`: a periodic record of it.
    - `candidates`: by default Coulomb, Stribeck and one-sided friction at every place, and cubic spring, play and
      hardening where the machine has a spring; friction then turns within 2 % of the slowest place's rms speed or more.
    - `band` (Hz), `settle` (periods), `floor`, `hold`: as of `fit_machine`. `most`: effects that are added at most.
    - `say`: called with a line on every fit.

    **Returns:** a `MachineDiagnosis`: verdict, effects with their numbers, what is left on the held-out part.

    **Raises:** `jaxfrf.InputError` as `fit_machine`, and for a machine without places.

    **Source:** this project's own: forward selection, judged by what a held-out experiment or line is left with.
    """
    expect("machine", machine, Machine)
    expect("data", data, Experiment)
    if candidates is not None:
        expect_each("candidates", candidates, AbstractEffect, least=0)
    if not machine.places:
        raise input_error(
            "machine", "no places", "some, where effects can act", 'Name them: places={"spring": [1, -1]}.'
        )
    if candidates is None:
        machine = _smoothed(machine, data, hold)
    used = _fitted_lines(measured_lines(machine, data, band, floor)[1])
    either = functools.partial(fitted, data=data, band=band, settle=settle, floor=floor, used=used)
    fitting = functools.partial(either, hold=hold)
    before = fit = fitting(machine)
    heldout = [_gap(fit, used)]
    say(f"as it is: misfit {number(fit.misfit)}, {percent(heldout[0], 3)} left on the held-out part")
    effects: list[AbstractEffect] = []
    rivals: list[AbstractEffect] = []
    tried: list[tuple[str, str, float]] = []
    while fit.misfit > ENOUGH and len(effects) < most:
        own = _typical(fit.machine, data, hold) if candidates is None else candidates
        known = {(e.joint, e.name) for e in fit.machine.effects}
        found: list[tuple[float, MachineFit]] = []
        for effect in own:
            if (effect.joint, effect.name) not in known:
                one = _with(fit, effect, fitting)
                left = _gap(one, used) if one is not None else np.inf
                tried.append((str(effect.joint), effect.name, left))
                say(f"{effect.name} at {effect.joint}: {percent(left, 3)} left")
                if one is not None and left < (1 - _LEAST_GAIN) * heldout[-1] and _stands(effect, one):
                    found.append((left, one))
        if not found:
            break
        found.sort(key=lambda x: x[0])
        alike = max(_ALIKE * found[0][0], floor)
        rivals = [x[1].machine.effects[-1] for x in found[1:] if x[0] < alike]
        heldout.append(found[0][0])
        fit = found[0][1]
        effects.append(fit.machine.effects[-1])
    verdict = "unexplained" if not effects else "ambiguous" if rivals else "named"
    if before.misfit <= ENOUGH:
        verdict = "sufficient"
    added = fit.machine.effects[len(machine.effects) :]
    doubt = of_hold(fit, either)
    return MachineDiagnosis(verdict, added, tuple(rivals), before, fit, tuple(heldout), tuple(tried), doubt)


def _fitted_lines(measured: Complex[np.ndarray, "exp line out"]) -> Bool[np.ndarray, "exp line"]:
    used = np.ones(measured.shape[:2], bool)
    if len(used) > 1:
        used[-1] = False
    else:
        used[:, _EVERY - 1 :: _EVERY] = False
    return used


def _gap(fit: MachineFit, used) -> float:
    left = share_left(fit.left, fit.measured, ~used) if not used.all() else fit.residual
    return left if np.isfinite(left) else np.inf


def _with(fit: MachineFit, effect: AbstractEffect, fitting: Callable[[Machine], MachineFit]) -> MachineFit | None:
    machine = fit.machine.with_effects(effect)
    shapes = [f"{effect.joint}.{effect.name}.{f}" for f in effect.units if f in (*effect.shapes, *_SHAPES)]
    try:
        return fitting(machine.held(*shapes))
    except InputError as error:  # no candidate
        if "diverges" not in str(error):
            raise
        return None


def _stands(effect: AbstractEffect, fit: MachineFit) -> bool:
    """Whether its numbers have a sign that it can have, and the largest of them is not 0."""
    names = {f: f"{effect.joint}.{effect.name}.{f}" for f in effect.units}
    free = {f: n for f, n in names.items() if n in fit.values}
    allowed = all(fit.values[n] >= 0 or effect.bounds[f][0] < 0 for f, n in free.items())
    return allowed and any(abs(fit.values[n]) > _SURE * fit.std[n] for n in free.values())


def _typical(machine: Machine, data: Experiment, hold: bool) -> list[AbstractEffect]:
    """Effects at every place of a size that the machine's motion there lets see."""
    found: list[AbstractEffect] = []
    kinds: tuple[type[AbstractEffect], ...] = (*library().values(), CubicSpring)
    for place, p in machine.places.items():
        x, v = (_rms(_seen(machine, p, kind), data, hold) for kind in ("position", "velocity"))
        force = _LEAST_FORCE * float(np.sqrt(np.mean(driving(data) ** 2))) * float(np.abs(machine.inputs).max())
        slow = max(machine.smoothing, _SLOW * v)
        K = np.asarray(machine.matrices_at({n: p.start for n, p in machine.parameters.items()})[2], float)
        swing = Swing(x, v, force, slow, sprung=bool(p @ K @ p > 0))
        each = (kind.of_swing(place, swing) for kind in kinds)
        found += [effect for effect in each if effect is not None]
    return found


def _smoothed(machine: Machine, data: Experiment, hold: bool) -> Machine:
    """With friction that turns no faster than its fastest place lets see: a step that follows it costs a hundred."""
    slow = _SLOW * min(_rms(_seen(machine, p, "velocity"), data, hold) for p in machine.places.values())
    if slow <= machine.smoothing:
        return machine
    return machine.with_smoothing(slow)


def _seen(machine: Machine, p: Float[np.ndarray, "dof"], quantity: str) -> Machine:
    """The machine, seen at a place."""
    return eqx.tree_at(
        lambda m: m.outputs,
        Machine(
            machine.matrices,
            machine.parameters,
            inputs=machine.inputs,
            outputs=machine.outputs,
            places=machine.places,
            quantity=quantity,
            smoothing=machine.smoothing,
        ),
        p[None],
    )


def _rms(machine: Machine, data: Experiment, hold: bool) -> float:
    y = np.asarray(simulate_machine(machine, data, hold=hold))
    return max(float(np.sqrt(np.mean((y - y.mean(axis=1, keepdims=True)) ** 2))), 1e-12)
