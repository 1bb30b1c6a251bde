"""Records cut and put together."""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from .._arguments import expect, expect_whole, wrong_kind
from .._errors import input_error
from .experiment import Experiment

_SAME_RATE = 1e-6  # rates of one clock, found in time stamps that are rounded


def select_periods(data: Experiment, start: int, stop: int | None = None) -> Experiment:
    """The steady periods `start:stop` of a record, a slice counted from 0 after the transient ones.

    **Arguments:** `data`: periodic. `start`, `stop`: periods, as of a Python slice; `stop` is not included, negative
    ones count from the end, `None`: up to the last one.

    **Returns:** the record of these periods, without transient ones.

    **Raises:** `jaxfrf.InputError` if the record is not periodic, `start` or `stop` are no whole numbers, or nothing is
    left.
    """
    expect("data", data, Experiment)
    expect_whole("start", start, None)
    if stop is not None:
        expect_whole("stop", stop, None)
    if not data.period:
        raise input_error(
            "period",
            "0 (not periodic)",
            "a periodic record",
            "Say how long a period is, e.g. --set period=2500.",
        )
    chosen = range(data.n_periods)[int(start) : None if stop is None else int(stop)]
    if not chosen:
        raise input_error(
            "periods",
            f"{start}:{'' if stop is None else stop}",
            f"a part of the {data.n_periods} steady periods (0:{data.n_periods})",
            "Choose periods that are there.",
        )
    first, last = data.transient_periods + chosen[0], data.transient_periods + chosen[-1] + 1
    samples = slice(first * data.period, last * data.period)
    return rebuilt(
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

    **Arguments:** `data`: without a period. `length`: of a piece, samples, 8 or more.

    **Returns:** the record with n_time // `length` experiments for each of its own: u (pos, exp, `length`, in), y and r
    likewise.

    **Raises:** `jaxfrf.InputError` if the record has a period (choose whole periods: `select_periods`), or is shorter.
    """
    expect("data", data, Experiment)
    expect_whole("length", length)
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

    return rebuilt(data, u=cut(data.u), y=cut(data.y), r=cut(data.r))


def rebuilt(data: Experiment, **changes) -> Experiment:
    """The same record with other fields, checked as a new one."""
    fields = {f.name: getattr(data, f.name) for f in dataclasses.fields(data)}
    return Experiment(**(fields | changes))


def concatenate(records: Sequence[Experiment]) -> Experiment:
    """Several records as one data set.

    Records of the same operating points (equal `q`, or none) become further experiments there; records of
    other operating points become further positions. Where some points have more experiments than others, every record
    is a position of its own.

    **Arguments:** `records`: one or several.

    **Returns:** the data set, u (pos, exp, time, in), others likewise.

    **Raises:** `jaxfrf.InputError` for none, and where they do not fit together (other `fs`, `period`, lines, channels
    or quantities).
    """
    if not isinstance(records, Iterable):
        raise wrong_kind("records", records, "a list of jaxfrf.Experiment, one or more", Experiment)
    records = [records] if isinstance(records, Experiment) else list(records)
    for record in records:
        expect("records", record, Experiment)
    if not records:
        raise input_error("records", "none", "at least one record", "Name a file.")
    for other in records[1:]:
        check_compatible(records[0], other)
    return grouped(records, places([x.q for x in records], [x.n_exp for x in records]))


def places(configurations: Sequence, experiments: Sequence[int]) -> list[tuple[int, ...]]:
    """Numbers of the records that are experiments at the same operating points: one group after the other.

    **Arguments:** of every record: its configurations, (pos, joint) or `None`, and how many experiments it has.
    """
    groups: list[list[int]] = []
    for i, q in enumerate(configurations):
        known = next((group for group in groups if same_numbers(configurations[group[0]], q)), None)
        if known is None:
            groups.append([i])
        else:
            known.append(i)
    if len({sum(experiments[i] for i in group) for group in groups}) > 1:
        return [(i,) for i in range(len(configurations))]
    return [tuple(group) for group in groups]


def grouped(records: Sequence[Experiment], groups: Sequence[tuple[int, ...]]) -> Experiment:
    """Compatible records as one data set: those of a group are experiments at the same positions, each group further
    positions."""
    if len(records) == 1:
        return records[0]
    for group in groups:
        if len({records[i].n_pos for i in group}) > 1:
            raise input_error(
                "positions",
                f"{[records[i].n_pos for i in group]} without configurations q",
                "as many in every file",
                "Store q in the files, so that positions can be told apart.",
            )
    if len({sum(records[i].n_exp for i in group) for group in groups}) > 1:
        raise input_error(
            "experiments",
            f"{[x.n_exp for x in records]} at different positions",
            "as many at every position",
            "Leave out the surplus experiments, or estimate the files one by one.",
        )
    first, firsts = records[0], [records[group[0]].q for group in groups]

    def join(name):
        if getattr(first, name) is None:
            return None
        return _joined([_joined([getattr(records[i], name) for i in group], 1) for group in groups], 0)

    return rebuilt(
        first,
        u=join("u"),
        y=join("y"),
        r=join("r"),
        q=None if first.q is None else _joined(firsts, 0),
        sources=tuple(s for x in records for s in x.sources),
        warnings=tuple(dict.fromkeys(w for x in records for w in x.warnings)),
    )


def _joined(parts, axis: int) -> np.ndarray:
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=axis)


def check_compatible(first: Experiment, other: Experiment) -> None:
    """Refuse records that cannot be one data set."""
    where = other.sources[0].name if other.sources else "a record"
    pairs = {
        "fs": (first.fs, first.fs if abs(other.fs / first.fs - 1.0) < _SAME_RATE else other.fs),
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
