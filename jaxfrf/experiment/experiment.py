"""The record of an experiment: reference r, input u, output y, and what is known about them."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from .._errors import input_error
from .._text import counted, number
from .._types import Array
from ..periodic import FoundPeriod, find_period, mismatch
from ..units import quantity_of
from .arguments import (
    as_configurations,
    as_count,
    as_each,
    as_line_numbers,
    as_positive,
    as_quantity,
    as_signal,
    as_unit,
)

_NOBODY_SAYS = (
    "nothing says what y is; it was taken as a velocity. Say it: y_quantity='position' (or velocity, acceleration), "
    "or its unit, y_unit='rad'."
)
_SHORTEST = 4  # samples of a period
_NOT_AFTER = 0.8  # mismatch of reference or input, from which they do not repeat after a lag (1: chance)


class Source(eqx.Module):
    """Where data come from: a file's `name` and the `sha256` of its bytes, '' where it is not known."""

    name: str = eqx.field(static=True)
    sha256: str = eqx.field(static=True, default="")


class Experiment(eqx.Module):
    """Records of one or several experiments at one or several operating points, sampled together.

    **Arguments:**

    - `u`: plant input, (pos, exp, time, in), N m (motor side).
    - `y`: plant output, (pos, exp, time, out), unit by `y_quantity`.
    - `fs`: sampling frequency, Hz.
    - `period`: samples in one excitation period; 0 = not periodic.
    - `r`: reference, (pos, exp, time, ref), unit by `r_quantity`; `None` where it was not recorded.
    - `q`: arm configuration of every operating point, (pos, joint), rad; `None` where there is none.
    - `lines`: excited DFT lines of one period; `None` = to be found in `r` (or `u`).
    - `transient_periods`: leading periods that are not steady and are dropped by `jaxfrf.dft`.
    - `r_quantity`, `y_quantity`: `position`, `velocity` or `acceleration`. Where neither `y_quantity` nor `y_unit` says
      what y is, it is taken as a velocity, and `warnings` say so, as for files.
    - `u_unit`, `y_unit`: SI units for pictures and files, where they are not those above (a force in N, a current in A,
      a position in m). The numbers are not converted: `jaxfrf.io.read` does that, here units that are known and not SI
      are refused. Where `y_unit` is that of another motion than `y_quantity`, `warnings` say so.
    - `sources`: `Source`s of the data. `warnings`: sentences on what the record is not good for.

    Fewer dimensions are accepted where the meaning is plain: (time, channel) is one operating point and one
    experiment, (exp, time, channel) one operating point. Signals are held in double precision on the host.

    **Raises:** `jaxfrf.InputError` naming the variable, what was found, what was expected and what to do.
    """

    u: Float[Array, "pos exp time in"]
    y: Float[Array, "pos exp time out"]
    r: Float[Array, "pos exp time ref"] | None
    q: Float[Array, "pos joint"] | None
    lines: Int[Array, "freq"] | None
    fs: float = eqx.field(static=True)
    period: int = eqx.field(static=True)
    transient_periods: int = eqx.field(static=True)
    r_quantity: str = eqx.field(static=True)
    y_quantity: str = eqx.field(static=True)
    u_unit: str = eqx.field(static=True)
    y_unit: str = eqx.field(static=True)
    sources: tuple[Source, ...] = eqx.field(static=True)
    warnings: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        u,
        y,
        fs: float,
        period: float = 0,
        *,
        r=None,
        q=None,
        lines=None,
        transient_periods: float = 0,
        r_quantity: str = "velocity",
        y_quantity: str | None = None,
        u_unit: str = "",
        y_unit: str = "",
        sources: Sequence[Source] = (),
        warnings: Sequence[str] = (),
    ):
        self.u = as_signal("u", u)
        self.y = as_signal("y", y)
        self.r = None if r is None else as_signal("r", r)
        self.q = None if q is None else as_configurations(q)
        self.lines = None if lines is None else as_line_numbers(lines)
        self.fs = as_positive("fs", fs)
        self.period = as_count("period", period)
        self.transient_periods = as_count("transient_periods", transient_periods)
        self.r_quantity = as_quantity("r_quantity", r_quantity)
        self.u_unit = as_unit("u_unit", u_unit)
        self.y_unit = as_unit("y_unit", y_unit)
        by_unit = quantity_of(self.y_unit)
        stated = by_unit if y_quantity is None else y_quantity
        self.y_quantity = as_quantity("y_quantity", "velocity" if stated is None else stated)
        self.sources = as_each("sources", sources, Source)
        told = as_each("warnings", warnings, str)
        doubt = _doubt(self.y_unit, by_unit, self.y_quantity if stated is not None else None)
        self.warnings = told if not doubt or any(text.endswith(doubt) for text in told) else (*told, doubt)

    def __check_init__(self):
        for name in ("y", "r"):
            x = getattr(self, name)
            if x is not None and x.shape[:3] != self.u.shape[:3]:
                raise input_error(
                    f"{name} and u",
                    f"{x.shape[:3]} and {self.u.shape[:3]} (position, experiment, time)",
                    "the same number of positions, experiments and samples",
                    "Cut both to their common part, or read each record from its own file.",
                )
        n_pos, _, n_time, _ = self.u.shape
        if self.q is not None and len(self.q) != n_pos:
            raise input_error(
                "q",
                f"{len(self.q)} configurations",
                f"one for each of the {n_pos} positions",
                "Check the order of axes.",
            )
        if self.period:
            _check_periods(self)
        if self.lines is not None:
            _check_lines(self.lines, self.period or n_time)

    @property
    def n_pos(self) -> int:
        return self.u.shape[0]

    @property
    def n_exp(self) -> int:
        return self.u.shape[1]

    @property
    def n_time(self) -> int:
        return self.u.shape[2]

    @property
    def n_in(self) -> int:
        return self.u.shape[3]

    @property
    def n_out(self) -> int:
        return self.y.shape[3]

    @property
    def n_periods(self) -> int:
        """Steady periods (transient ones not counted); 0 where the record is not periodic."""
        return self.n_time // self.period - self.transient_periods if self.period else 0


def _doubt(unit: str, by_unit: str | None, stated: str | None) -> str:
    """What is not sure about y; "" where nothing is."""
    if stated is None:
        return _NOBODY_SAYS
    return "" if by_unit in (None, stated) else f"y: its unit {unit} is that of a {by_unit}, y_quantity says {stated}."


def _check_periods(data: Experiment) -> None:
    n_time, period, transient = data.n_time, data.period, data.transient_periods
    if period < _SHORTEST:
        raise input_error(
            "period",
            counted(period, "sample"),
            f"{_SHORTEST} samples or more: a shorter one has hardly a line",
            "Give the samples of one period (--set period=N), or 0 for a record without one.",
        )
    if n_time % period:
        seen = seen_period(data.r, data.u, data.y)
        if seen is None or seen[1].period == period:
            do = f"Cut the record to {n_time // period} periods, or correct the period."
        else:
            do = f"{seen[0]} repeats every {seen[1].period} samples: {how_to_set(n_time, seen[1].period)}."
        raise input_error(
            "period",
            f"{n_time} samples, {_broken(n_time / period)} periods of {period}",
            "a whole number of periods",
            do,
        )
    if n_time // period <= transient:
        raise input_error(
            "transient_periods",
            f"{transient} of {n_time // period} periods",
            "at least one period left after them",
            "Lower transient_periods, or record longer.",
        )


def _broken(periods: float) -> str:
    """A number that is not whole, with as many digits as show that."""
    texts = (number(periods, digits) for digits in range(4, 16))
    return next((text for text in texts if not float(text).is_integer()), f"{periods!r}")


def seen_period(r, u, y) -> tuple[str, FoundPeriod] | None:
    """The period that a record shows, in the reference where there is one, and in which signal; `None` if none.

    An output alone may ring: its period counts where reference or input repeat after it, too, if less clearly.

    **Arguments:** signals (pos, exp, time, channel) or `None`. The first experiment speaks for all.
    """
    causes = [(name, np.asarray(x)[0, 0]) for name, x in (("r", r), ("u", u)) if x is not None]
    for name, x in causes:
        if (found := find_period(x)) is not None:
            return name, found
    found = None if y is None else find_period(np.asarray(y)[0, 0])
    if found is None or (causes and all(mismatch(x, found.period) > _NOT_AFTER for _, x in causes)):
        return None
    return "y", found


def how_to_set(n_time: int, period: int) -> str:
    """The option that sets a period, and cuts the record to whole ones where it has to."""
    whole = n_time // period * period
    return f"--set period={period}" + ("" if whole == n_time else f",samples=0:{whole}")


def _check_lines(lines: np.ndarray, period: int) -> None:
    top = (period - 1) // 2
    if lines.min() < 1 or lines.max() > top:
        raise input_error(
            "lines",
            f"{lines.min()} to {lines.max()}",
            f"lines between 1 and {top} (below half the sampling frequency)",
            "Check period and fs: line k is k*fs/period Hz.",
        )
    if np.any(np.diff(lines) <= 0):
        raise input_error(
            "lines", "a list that is not increasing", "increasing line numbers", "Sort them, without repeats."
        )
