"""Experiment files: read from `.nc`, `.zarr`, `.mat`, `.npz`, `.csv` and more, under whatever names, and written."""

import contextlib
import dataclasses
import os
import pathlib
import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from .._arguments import expect, expect_path
from .._errors import InputError, input_error
from .._files import digest
from .._text import number
from ..experiment import UNITS, Experiment, Source, concatenate, rebuilt
from ..screening import ACROSS, CHECKS, screened
from ..units import DEFAULT_INPUT, input_unit, known_unit, output_unit
from ._configurations import gathered, logged, mean_configurations, stated_configurations
from ._container import Later, Leaf, Put, Variable, Variables, check_file, load, save, save_blocks
from ._joined import expanded, joined, part_of, propose_joined
from ._matlab import NAMELESS
from ._rate import sampling_frequency
from ._select import NOT_THERE, column, missing
from ._variables import File, Given, numbers, of_each, scalar, scaled, stated_quantity, text, unit_of
from .record_arguments import SIGNALS, check_factor, check_names, check_values

_CHANNEL = {"r": "input", "u": "input", "y": "output"}


def read(
    *paths: str | os.PathLike,
    names: Mapping[str, str] | None = None,
    values: Mapping[str, object] | None = None,
    factor: Mapping[str, float | tuple[float, ...]] | None = None,
    anyway: bool = False,
) -> Experiment:
    """Read experiment files; several are one data set (see `jaxfrf.concatenate`).

    **Arguments:**

    - `paths`: `.nc`, `.zarr` (folders), `.mat` (v5, v7.3), `.npz`, tables (`.csv`, `.txt`, `.tsv`, `.lvm`), and, with
      the extras `parquet` and `mdf`, `.parquet` and `.mf4` (`.mdf`, `.dat`) files holding `r`, `u`, `y`, `q`, `fs`,
      `period`, `lines`, `transient_periods`, `r_quantity`, `y_quantity` as in `jaxfrf.Experiment`. Only `u`, `y` and
      either `fs` or a time vector `t` (s) are needed. A file that says neither `y_quantity` nor the unit of y is taken
      to hold velocities, with a warning. Units that a file states (a line of units, `speed [deg/s]`, attributes) are
      converted to SI, unless `factor` says how; the SI units go with the record.
    - `names`: what they are called in the files, `{"u": "iq_adx", "y": "rec.act_vel'[0:3]"}` (see
      `parse_map`). Where one names its file, `{"u": "currents.csv:tau1", "y": "angles.csv:q1"}`, all files are one
      record.
      Where `q` names a record as long as the others, its mean is the configuration; files whose means agree within
      .02 rad, or half of the movement within one, are of one position.
    - `values`: what the files do not say or say wrongly, `{"fs": 2500, "period": 2500, "samples": slice(0,
      18720)}` (see `parse_values`). `samples` is the part of the record to keep.
    - `factor`: factors that make the units SI, `{"y": np.pi / 180}`, one for all or one for each channel.
    - `anyway`: read records, too, that `jaxfrf.examine` would have refused (a period that they contradict).

    What looks suspicious but can be used stands in `Experiment.warnings` (see `jaxfrf.screen`). A record of
    more than half the memory should be split into one file for each operating point, read and transformed one
    by one.

    **Returns:** one `jaxfrf.Experiment` of all files, in SI units.

    **Raises:** `jaxfrf.InputError` naming the file, the variable, what was found, what was expected and what
    to do; `ImportError` without the library that a format needs.
    """
    return _compared(concatenate(_each(paths, names, values, factor, anyway)), anyway)


def read_each(
    *paths: str | os.PathLike,
    names: Mapping[str, str] | None = None,
    values: Mapping[str, object] | None = None,
    factor: Mapping[str, float | tuple[float, ...]] | None = None,
    anyway: bool = False,
) -> list[Experiment]:
    """The same, one record a file, or one of all where `names` says which file a signal is in.

    **Arguments** and **Raises:** as `read`.
    """
    return [_compared(data, anyway) for data in _each(paths, names, values, factor, anyway)]


def _compared(data: Experiment, anyway: bool) -> Experiment:
    """With what shows where experiments are held against each other."""
    return screened(data, checks=ACROSS, anyway=anyway) if data.n_exp * data.n_pos > 1 else data


def _each(paths: Sequence[str | os.PathLike], names, values, factor, anyway: bool) -> list[Experiment]:
    """One record a file, screened; of measured configurations that are near each other the first is that of all."""
    for path in paths:
        if not isinstance(path, str | os.PathLike):
            several = "Give them one by one: read(*paths)." if isinstance(path, list | tuple) else "Name a file."
            raise input_error("files", f"{type(path).__name__} {path!r:.60}", "names of files", several)
    if not paths:
        raise input_error("files", "none", "at least one measurement file", "Name a file.")
    given = Given(check_names(names), check_values(values), check_factor(factor), anyway)
    files = [pathlib.Path(path) for path in paths]
    if len(files) > 1 and any(part_of(name, files) for name in given.names.values()):
        return [_read_one(files, dataclasses.replace(given, names=expanded(given.names, files)))[0]]
    with joinable(files):
        read = [_read_one([file], given) for file in files]
    places = gathered([data.q for data, _ in read], [near for _, near in read])
    return [data if q is data.q else rebuilt(data, q=q) for (data, _), q in zip(read, places, strict=True)]


def write(path: str | os.PathLike, data: Experiment) -> None:
    """Write an experiment file, `.nc`, `.mat`, `.npz` or a folder `.zarr`, whole or not at all.

    `.mat` is v5, or v7.3 where an array is too large for v5 (2 GiB). Provenance and warnings are not written:
    they belong to the files that the data came from.

    **Arguments:** `path`: of the file, or of the folder of a `.zarr`. `data`: with u, y and r, (pos, exp, time,
    channel), which are stored with their SI units.

    **Raises:** `jaxfrf.InputError` if `data` is no experiment, the folder does not exist or the extension is not known;
    `ImportError` without the library that the format needs.
    """
    expect_path("path", path)
    expect("data", data, Experiment)
    units = {"u": input_unit(data), "r": UNITS[data.r_quantity], "y": output_unit(data)}
    variables = {}
    for name in SIGNALS:
        x = getattr(data, name)
        if x is not None:
            channel = "reference" if name == "r" and x.shape[-1] != data.n_in else _CHANNEL[name]
            dims = ("position", "experiment", "time", channel)
            variables[name] = Variable(dims, np.asarray(x), units[name])
    if data.q is not None:
        variables["q"] = Variable(("position", "joint"), np.asarray(data.q), "rad")
    if data.lines is not None:
        variables["lines"] = Variable(("line",), np.asarray(data.lines))
    attributes: dict[str, float | int | str] = {
        "fs": data.fs,
        "period": data.period,
        "transient_periods": data.transient_periods,
        "r_quantity": data.r_quantity,
        "y_quantity": data.y_quantity,
    }
    said = {"u_unit": data.u_unit, "y_unit": data.y_unit}  # not every format has units of its own
    save(path, variables, attributes | {name: unit for name, unit in said.items() if unit})


@contextlib.contextmanager
def writing(
    path: str | os.PathLike, shapes: Mapping[str, tuple[int, ...]], q, lines, attributes: Mapping
) -> Iterator[Put]:
    """An experiment file whose signals come position by position: `put(name, first position, numbers)`.

    **Arguments:** `shapes` of r, u, y, (position, experiment, time, channel). `q`, `lines`: as of an experiment, or
    `None`. `attributes`: `fs`, `period`, `transient_periods`, `r_quantity`, `y_quantity`.
    """
    units = {"u": "N m", "r": UNITS[attributes["r_quantity"]], "y": UNITS[attributes["y_quantity"]]}
    variables = {
        name: Variable(("position", "experiment", "time", _CHANNEL[name]), Later(shape), units[name])
        for name, shape in shapes.items()
    }
    if q is not None:
        variables["q"] = Variable(("position", "joint"), np.asarray(q), "rad")
    if lines is not None:
        variables["lines"] = Variable(("line",), np.asarray(lines))
    with save_blocks(path, variables, attributes) as put:
        yield put


def _read_one(paths: Sequence[pathlib.Path], given: Given) -> tuple[Experiment, np.ndarray | None]:
    """The record in one file, or the one whose channels several files hold, screened; and, where its q is the mean of a
    record, how near others are of one position."""
    path = paths[0] if len(paths) == 1 else pathlib.Path(" + ".join(x.name for x in paths))
    variables = load(path) if len(paths) == 1 else joined({x: load(x) for x in paths}, given.anyway)
    sources = tuple(source_of(x) for x in paths)
    data, remarks, near = _record(File(path, _with_units(variables), given), sources)
    del variables  # the arrays live on in `data` alone
    with _naming(File(path, Variables({}), given)):
        data = screened(data, checks=CHECKS, anyway=given.anyway)
    warnings = tuple(f"{path}: {text}" for text in (*remarks, *data.warnings))
    return (dataclasses.replace(data, warnings=warnings) if warnings else data), near


@contextlib.contextmanager
def joinable(files: Sequence[pathlib.Path]) -> Iterator[None]:
    """Say how files become one record, where each holds a part of what one needs."""
    try:
        yield
    except InputError as error:
        example = propose_joined(files) if NOT_THERE in str(error) else None
        if example is None:
            raise
        raise InputError(f'{error} Parts of one record: --map "{example}" joins these files.') from None


def as_given(names, values, factor, anyway: bool) -> Given:
    """What the caller says about the files, checked."""
    return Given(names, values, factor, anyway)


def source_of(path: pathlib.Path) -> Source:
    """Name and digest of a file, or of all files of a folder (Zarr)."""
    check_file(path)
    return Source(path.name, digest(path))


def record_of(
    path: pathlib.Path, given: Given, source: Source, part: slice | None = None
) -> tuple[Experiment, list[str], np.ndarray | None]:
    """The record in a file, or at some of its positions, not screened; what is to be said of reading it; and, where
    its q is the mean of a record, how near others are of one position (`gathered`)."""
    variables = load(path, part=part)
    values = dict(given.values)
    q = np.asarray(values.get("q", 0.0))
    if part is not None and q.ndim == 2 and len(q) >= part.stop:
        values["q"] = q[part]
    return _record(File(path, _with_units(variables), dataclasses.replace(given, values=values)), (source,))


def _record(file: File, sources: tuple[Source, ...]) -> tuple[Experiment, list[str], np.ndarray | None]:
    """The record as the file has it, what is to be said of that, and, where its q is the mean of a record, how near
    others are of one position."""
    u, y = (_signal(file, key) for key in ("u", "y"))
    r = _signal(file, "r") if file.get("r") is not None else None
    signals = {"r": r, "u": u, "y": y}
    fs, late = sampling_frequency(file, u.shape[-2])
    y_quantity, asked = _output_quantity(file)
    remarks = [*late, *_restored_axes(file, signals), *asked, *_conversions(file)]
    q: np.ndarray | None
    near: np.ndarray | None = None
    if logged(file, u.shape):
        q, near, said = mean_configurations(file, _steady(file, u.shape[-2]), len(u) if u.ndim == 4 else 1)
        remarks.append(said)
    else:
        q = stated_configurations(file)
    with _naming(file):
        data = Experiment(
            u=_cut(file, "u", u),
            y=_cut(file, "y", y),
            r=None if r is None else _cut(file, "r", r),
            q=q,
            lines=file.get("lines"),
            fs=fs,
            period=_count(file, "period"),
            transient_periods=_count(file, "transient_periods"),
            r_quantity=text(file, "r_quantity", stated_quantity(file, "r") or "velocity"),
            y_quantity=y_quantity,
            u_unit=_kept_unit(file, "u", DEFAULT_INPUT),
            y_unit=_kept_unit(file, "y", UNITS.get(y_quantity, "")),
            sources=sources,
        )
    return data, remarks, near


def _steady(file: File, n_time: int) -> slice:
    """The samples of a record that are neither cut off nor of transient periods."""
    kept = file.given.values.get("samples")
    start, stop, _ = (kept if isinstance(kept, slice) else slice(None)).indices(n_time)
    skip = int(_count(file, "period") * _count(file, "transient_periods"))
    return slice(start + skip, stop) if start + skip < stop else slice(start, stop)


def _signal(file: File, key: str) -> np.ndarray:
    """A record as the file has it, a vector made one channel, its units converted."""
    value = file.get(key)
    if value is None:
        raise missing(file.path, file.variables, key, key)
    x = column(numbers(file, key, value))
    if _lost_its_channel(file, x):
        x = x[..., None]
    if x.size == 0:
        raise file.error(key, f"no samples (shape {x.shape})", "a record", "Check the file, or name another variable.")
    if not 2 <= x.ndim <= 4:
        shapes = "(time, channel), (experiment, time, channel) or (position, experiment, time, channel)"
        raise file.error(key, f"the shape {x.shape}", shapes, "Name a record, or reshape it.")
    time = x.shape[-2]
    if time < max(x.shape):
        raise file.error(
            key,
            f"{time} samples along the time axis of shape {x.shape}",
            "time as the last axis but one, and the longest: ([position,] [experiment,] time, channel)",
            f"The axes look swapped. {_how_to_turn(file)}",
        )
    return scaled(file, key, x)


def _how_to_turn(file: File) -> str:
    """The `--map` that swaps the last two axes of every signal that asks for it, where that helps."""
    signals = {key: np.shape(file.get(key)) for key in SIGNALS if file.get(key) is not None}
    wrong = {key: shape for key, shape in signals.items() if len(shape) > 1 and shape[-2] < max(shape)}
    if any(shape[-1] != max(shape) for shape in wrong.values()):
        return "Reorder the axes."
    names = ",".join(f"{key}={file.given.names.get(key, key)}'" for key in wrong)
    return f'Transpose {"it" if len(wrong) == 1 else "them"}: --map "{names}".'


def _lost_its_channel(file: File, x: np.ndarray) -> bool:
    """MATLAB drops trailing axes of length one; of one channel it leaves (position, experiment, time)."""
    return file.path.suffix.lower() == ".mat" and x.ndim == 3 and x.shape[2] > max(x.shape[:2])


def _restored_axes(file: File, signals: Mapping[str, np.ndarray | None]) -> list[str]:
    """A remark where a single channel was assumed, unless the number of configurations confirms it."""
    for key, x in signals.items():
        if x is None or not _lost_its_channel(file, np.asarray(file.get(key))):
            continue
        q = file.get("q")
        if q is None or len(np.atleast_2d(q)) != len(x):
            return [
                f"{file.label(key)}: its shape {x.shape[:3]} was taken as (position, experiment, time) of "
                "one channel, as MATLAB drops a last axis of length one. If it is (experiment, channel, "
                "time), permute it."
            ]
    return []


def _output_quantity(file: File) -> tuple[str, list[str]]:
    """What y is, and a remark where that is not sure."""
    by_unit = stated_quantity(file, "y")
    if file.get("y_quantity") is not None:
        stated = text(file, "y_quantity", "")
        if by_unit in (None, stated):
            return stated, []
        if unit_of(file, "y")[0]:
            return stated, []  # the record says so itself
        return stated, [f"{file.label('y')}: its units are those of a {by_unit}, y_quantity says {stated}."]
    if by_unit is not None:
        return by_unit, []
    if NAMELESS in file.variables:
        return "velocity", [
            "some variables are MATLAB objects whose names cannot be read, and y was taken as a velocity. If one "
            "of them is y_quantity (text in double quotes), set it: --set y_quantity=position."
        ]
    return "velocity", [
        f"{file.label('y')}: the file does not say what y is; it was taken as a velocity. Say it: --set "
        "y_quantity=position (or velocity, acceleration), or y_unit=deg."
    ]


def _with_units(variables: Mapping[str, Leaf]) -> Variables:
    return variables if isinstance(variables, Variables) else Variables(variables)


def _kept_unit(file: File, key: str, usual: str) -> str:
    unit, _ = unit_of(file, key)
    return "" if unit == usual else unit


def _conversions(file: File) -> list[str]:
    """What was converted because the file says its unit, and what was not, because nobody knows it."""
    said = []
    for key in (*SIGNALS, "q"):
        unit, factor = unit_of(file, key)
        if unit and known_unit(unit) is None and key not in file.given.factor and file.get(key) is not None:
            said.append(
                f"{file.label(key)}: {unit!r} is no unit that is known here. It is kept as a name, and the numbers are "
                f"as they were: --factor {key}=FACTOR converts them."
            )
        stated = f"{key}_unit" in file.given.values
        each = of_each(file, key) if key in SIGNALS and key not in file.given.factor and unit else None
        if each is not None and file.get(key) is not None:
            said.append(
                f"{file.label(key)}: converted to {unit}, as the file states the units of its channels (factors "
                f"{', '.join(number(x, 6) for x in each)})."
            )
        if factor != 1.0 and key not in file.given.factor and not stated and file.get(key) is not None:
            said.append(
                f"{file.label(key)}: converted to {unit}, as the file states its unit (factor {number(factor, 6)})."
            )
    return said


def _cut(file: File, key: str, x: np.ndarray) -> np.ndarray:
    """The part of the record that `samples` keeps."""
    kept = file.given.values.get("samples")
    if not isinstance(kept, slice):
        return x
    n = x.shape[-2]
    start, stop = kept.start or 0, n if kept.stop is None else kept.stop
    if not 0 <= start < stop <= n:
        raise file.error(
            key,
            f"samples {start}:{stop} of a record of {n}",
            f"a part of 0:{n}",
            "Correct --set samples=START:STOP.",
        )
    return x[..., start:stop, :]


@contextlib.contextmanager
def _naming(file: File) -> Iterator[None]:
    """Put the file, and its own names, into the messages of `jaxfrf.Experiment`."""
    try:
        yield
    except InputError as error:
        what, colon, rest = str(error).partition(": ")
        what = re.sub(r"\w+", lambda word: file.label(word[0]), what)
        if "a whole number of periods" in rest and "Cut the record" in rest:
            rest += _cut_advice(file)
        raise InputError(f"{file.path}: {what}{colon}{rest}") from error


def _count(file: File, key: str) -> float:
    """A number of samples or periods, as it is written; 0 where nothing is."""
    found = scalar(file, key, 0.0)
    return 0.0 if found is None else found


def _cut_advice(file: File) -> str:
    """The cut that keeps all whole periods."""
    samples = file.given.values.get("samples")
    kept = samples if isinstance(samples, slice) else slice(0, None)
    period = int(_count(file, "period"))
    n_time = column(np.asarray(file.get("u"))).shape[-2]
    start, stop, _ = kept.indices(n_time)
    whole = (stop - start) // period * period
    return f" This keeps them: --set samples={start}:{start + whole}." if whole else ""
