"""The record of an experiment: reference r, input u, output y, and what is known about them."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from ._arguments import expect
from ._errors import input_error
from ._types import Array
from .periodic import FoundPeriod, find_period
from .units import QUANTITIES, UNITS as UNITS

_LARGEST = 1e100


class Source(eqx.Module):
    """Where data come from: a file name and the sha256 of its bytes."""

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
    - `r_quantity`, `y_quantity`: `position`, `velocity` or `acceleration`.
    - `u_unit`, `y_unit`: SI units for pictures and files, where they are not those above (a force in N, a current in A,
      a position in m). The numbers are not converted: `jaxfrf.io.read` does that.

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
        period: int = 0,
        *,
        r=None,
        q=None,
        lines=None,
        transient_periods: int = 0,
        r_quantity: str = "velocity",
        y_quantity: str = "velocity",
        u_unit: str = "",
        y_unit: str = "",
        sources: Sequence[Source] = (),
        warnings: Sequence[str] = (),
    ):
        self.u = _signal("u", u)
        self.y = _signal("y", y)
        self.r = None if r is None else _signal("r", r)
        self.q = None if q is None else _configurations(q)
        self.lines = None if lines is None else _line_numbers(lines)
        self.fs = _positive("fs", fs)
        self.period = _count("period", period)
        self.transient_periods = _count("transient_periods", transient_periods)
        self.r_quantity = _quantity("r_quantity", r_quantity)
        self.y_quantity = _quantity("y_quantity", y_quantity)
        self.u_unit = str(u_unit)
        self.y_unit = str(y_unit)
        self.sources = tuple(sources)
        self.warnings = tuple(warnings)

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


def select_periods(data: Experiment, start: int, stop: int | None = None) -> Experiment:
    """The steady periods `start:stop` of a record, a slice counted from 0 after the transient ones.

    **Raises:** `jaxfrf.InputError` if the record is not periodic or nothing is left.
    """
    expect("data", data, Experiment)
    if not data.period:
        raise input_error(
            "period",
            "0 (not periodic)",
            "a periodic record",
            "Say how long a period is, e.g. --set period=2500.",
        )
    chosen = range(data.n_periods)[start:stop]
    if not chosen:
        raise input_error(
            "periods",
            f"{start}:{'' if stop is None else stop}",
            f"a part of the {data.n_periods} steady periods (0:{data.n_periods})",
            "Choose periods that are there.",
        )
    first, last = data.transient_periods + chosen[0], data.transient_periods + chosen[-1] + 1
    samples = slice(first * data.period, last * data.period)
    return _rebuild(
        data,
        u=data.u[:, :, samples],
        y=data.y[:, :, samples],
        r=None if data.r is None else data.r[:, :, samples],
        transient_periods=0,
    )


def segments(data: Experiment, length: int) -> Experiment:
    """A long record that is not periodic, cut into pieces of `length` samples: as many more experiments.

    Local methods with a transient term take them together (each piece has a transient of its own): lines fs/length Hz
    apart instead of fs/duration, and as many times fewer of them. What is left at the end is not used.

    **Raises:** `jaxfrf.InputError` if the record has a period (choose whole periods: `select_periods`), or is shorter.
    """
    n = data.n_time // length if length == int(length) and length >= 8 else 0
    if data.period or n < 1:
        raise input_error(
            "segment",
            f"{length} samples of a record of {data.n_time}" + (f" with period {data.period}" if data.period else ""),
            "a whole number from 8 to the length of a record without a period",
            "Choose another, or choose whole periods (--periods).",
        )

    def cut(x):
        if x is None:
            return None
        x = x[:, :, : n * length].reshape(x.shape[0], -1, n, length, x.shape[3])
        return x.reshape(x.shape[0], -1, length, x.shape[4])

    return _rebuild(data, u=cut(data.u), y=cut(data.y), r=cut(data.r))


def _rebuild(data: Experiment, **changes) -> Experiment:
    fields = {f.name: getattr(data, f.name) for f in dataclasses.fields(data)}
    return Experiment(**(fields | changes))


def concatenate(records: Sequence[Experiment]) -> Experiment:
    """Several records as one data set.

    Records of the same operating points (equal `q`, or none) become further experiments there; records of
    other operating points become further positions.

    **Raises:** `jaxfrf.InputError` where they do not fit together (other `fs`, `period`, lines, channels or
    quantities).
    """
    records = [records] if isinstance(records, Experiment) else list(records)
    for record in records:
        expect("records", record, Experiment)
    if not records:
        raise input_error("records", "none", "at least one record", "Name a file.")
    first = records[0]
    for other in records[1:]:
        check_compatible(first, other)
    if len(records) == 1:
        return first
    same_place = all(same_numbers(first.q, other.q) for other in records[1:])
    axis = 1 if same_place else 0
    if axis == 1 and len({x.n_pos for x in records}) > 1:
        raise input_error(
            "positions",
            f"{[x.n_pos for x in records]} without configurations q",
            "as many in every file",
            "Store q in the files, so that positions can be told apart.",
        )
    if axis == 0 and len({x.n_exp for x in records}) > 1:
        raise input_error(
            "experiments",
            f"{[x.n_exp for x in records]} at different positions",
            "as many at every position",
            "Leave out the surplus experiments, or estimate the files one by one.",
        )

    def join(name):
        parts = [getattr(x, name) for x in records]
        return None if parts[0] is None else np.concatenate(parts, axis=axis)

    return _rebuild(
        first,
        u=join("u"),
        y=join("y"),
        r=join("r"),
        q=first.q if axis == 1 else join("q"),
        sources=tuple(s for x in records for s in x.sources),
        warnings=tuple(dict.fromkeys(w for x in records for w in x.warnings)),
    )


def check_compatible(first: Experiment, other: Experiment) -> None:
    """Refuse records that cannot be one data set."""
    where = other.sources[0].name if other.sources else "a record"
    pairs = {
        "fs": (first.fs, other.fs),
        "period": (first.period, other.period),
        "samples after the transient": (
            first.n_time - first.transient_periods * first.period,
            other.n_time - other.transient_periods * other.period,
        ),
        "transient_periods": (first.transient_periods, other.transient_periods),
        "inputs": (first.n_in, other.n_in),
        "outputs": (first.n_out, other.n_out),
        "references": (_width(first.r), _width(other.r)),
        "r_quantity": (first.r_quantity, other.r_quantity),
        "y_quantity": (first.y_quantity, other.y_quantity),
        "u_unit": (first.u_unit, other.u_unit),
        "y_unit": (first.y_unit, other.y_unit),
        "joints in q": (_width(first.q), _width(other.q)),
    }
    for name, (a, b) in pairs.items():
        if a != b:
            raise input_error(
                f"{where}: {name}",
                f"{b}",
                f"{a} as in the file before it",
                "Estimate files that differ one by one.",
            )
    if not same_numbers(first.lines, other.lines):
        raise input_error(
            f"{where}: lines",
            f"{'no list' if other.lines is None else f'{len(other.lines)} lines'}",
            "the same excited lines as in the file before it",
            "Estimate files with other lines one by one.",
        )


def _width(x) -> int:
    return 0 if x is None else x.shape[-1]


def same_numbers(a, b) -> bool:
    """Whether two arrays are the same but for rounding, or both `None`."""
    if a is None or b is None:
        return a is b
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=0, atol=1e-9))


def _array(name: str, value) -> np.ndarray:
    """An array; what is no array, or one of which a mask hides a part, is refused."""
    if np.ma.is_masked(value):
        hidden = int(np.ma.getmaskarray(value).sum())
        raise input_error(
            name,
            f"a masked array that hides {hidden} samples",
            "a record without holes",
            "Cut it to what is whole, or fill the holes yourself (.filled) and know what that does to the spectrum.",
        )
    try:
        return np.asarray(value)
    except ValueError:
        raise input_error(
            name, "lists of unequal length", "numbers in rows of one length", "Cut them to their common part."
        ) from None


def _signal(name: str, value) -> np.ndarray:
    if value is None:
        raise input_error(name, "None", "a record", "Give the signal.")
    x = _array(name, value)
    if not (np.issubdtype(x.dtype, np.floating) or np.issubdtype(x.dtype, np.integer) or x.dtype == bool):
        kind = "complex numbers" if np.issubdtype(x.dtype, np.complexfloating) else f"{x.dtype} data"
        raise input_error(name, kind, "real numbers", "Store the time record itself, not its spectrum or a text.")
    if x.size == 0:
        raise input_error(name, f"no samples (shape {x.shape})", "a record", "Check the file and the names in --map.")
    if x.ndim == 1 or (x.ndim == 2 and len(x) == 1):
        x = x.reshape(-1, 1)  # a row vector is one channel too
    if not 2 <= x.ndim <= 4:
        raise input_error(
            name,
            f"{x.ndim} dimensions {x.shape}",
            "(time, channel), (experiment, time, channel) or (position, experiment, time, channel)",
            "Reshape the array.",
        )
    x = x.astype(np.float64, copy=False)
    x = x.reshape((1,) * (4 - x.ndim) + x.shape)
    if x.shape[3] > x.shape[2]:
        raise input_error(
            name,
            f"{x.shape[2]} samples of {x.shape[3]} channels",
            "more samples than channels (the last two axes are time, channel)",
            "The axes look swapped: transpose the array.",
        )
    # One NaN or Inf makes the sum so; the mask, as long as the record, is needed then only.
    with np.errstate(over="ignore", invalid="ignore"):
        suspicious = not np.isfinite(x.sum())
    if suspicious and (bad := ~np.isfinite(x)).any():
        pos, exp, time, channel = (int(i) for i in np.argwhere(bad)[0])
        raise input_error(
            name,
            f"{int(bad.sum())} NaN or Inf samples, the first at position {pos}, experiment {exp}, "
            f"sample {time}, channel {channel}",
            "finite numbers",
            "Repair or cut the record: a DFT spreads one bad sample over all frequencies.",
        )
    if max(x.max(), -x.min()) > _LARGEST:
        raise input_error(
            name,
            f"numbers up to {max(x.max(), -x.min()):.3g}",
            f"at most {_LARGEST:g}, whose squares are finite",
            "The file is damaged, or these are no numbers of a record.",
        )
    return x


def _configurations(value) -> np.ndarray:
    q = np.atleast_2d(_array("q", value))
    if q.ndim != 2 or q.dtype.kind not in "iuf" or not np.isfinite(q).all():
        raise input_error(
            "q", f"{q.dtype} of shape {q.shape}", "finite angles of shape (position, joint), rad", "Check q."
        )
    return q.astype(np.float64)


def _line_numbers(value) -> np.ndarray:
    k = np.atleast_1d(_array("lines", value)).ravel()
    if k.size == 0 or k.dtype.kind not in "iuf" or np.any(k != np.round(k)):
        raise input_error("lines", f"{k[:5]}", "whole DFT line numbers of one period", "Line k is k*fs/period Hz.")
    return k.astype(np.int64)


def _number(name: str, value) -> float:
    x = _array(name, value)
    if x.size != 1 or x.dtype.kind not in "biuf":
        raise input_error(name, f"{x.dtype} of shape {x.shape}", "one real number", f"Set it, e.g. --set {name}=2000.")
    return float(x.item())


def _positive(name: str, value) -> float:
    x = _number(name, value)
    if not (np.isfinite(x) and x > 0):
        raise input_error(name, f"{x:g}", "a positive number", f"Set it, e.g. --set {name}=2000.")
    return x


def _count(name: str, value) -> int:
    x = _number(name, value)
    if not (np.isfinite(x) and x >= 0 and x == round(x)):
        raise input_error(name, f"{x:g}", "a whole number, 0 or more", f"Set it, e.g. --set {name}=2500.")
    return int(x)


def _quantity(name: str, value) -> str:
    value = str(value)
    if value not in QUANTITIES:
        raise input_error(name, repr(value), "position, velocity or acceleration", f"Set it: --set {name}=velocity.")
    return value


def _check_periods(data: Experiment) -> None:
    n_time, period, transient = data.n_time, data.period, data.transient_periods
    if n_time % period:
        seen = seen_period(data.r, data.u, data.y)
        if seen is None or seen[1].period == period:
            do = f"Cut the record to {n_time // period} periods, or correct the period."
        else:
            do = f"{seen[0]} repeats every {seen[1].period} samples: {how_to_set(n_time, seen[1].period)}."
        raise input_error(
            "period",
            f"{n_time} samples, {n_time / period:.4g} periods of {period}",
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


def seen_period(r, u, y) -> tuple[str, FoundPeriod] | None:
    """The period that a record shows, in the reference where there is one, and in which signal; `None` if none.

    **Arguments:** signals (pos, exp, time, channel) or `None`. The first experiment speaks for all.
    """
    for name, x in (("r", r), ("u", u), ("y", y)):
        found = None if x is None else find_period(np.asarray(x)[0, 0])
        if found is not None:
            return name, found
    return None


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
