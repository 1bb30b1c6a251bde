"""References in files that a controller can play: `.nc`, `.mat` (v5, or v7.3 beyond 2 GB) and `.csv`.

**`.nc` and `.mat`** hold all experiments, under the names that experiment files use:

    r                      (experiment, time, input)   rad/s   speed reference
    r_position             (experiment, time, input)   rad     position reference, about the position at rest
    time                   (time,)                     s
    lines, amplitude       (line,), (line, input)      -, rad/s
    slow_lines, slow_amplitude, velocity_limit,        (input,), where the design has them
    travel_limit, acceleration_limit
    fs, period, transient_periods, r_quantity          as in an experiment file
    periods, blocks, seed, ramp, phases, version       the rest of the design

In MATLAB, `squeeze(r(e,:,:))` is the table (time, input) of experiment e.

**`.csv`** is one file per experiment, as a controller plays one at a time: `NAME_01.csv`, `NAME_02.csv`,
... (only `NAME.csv` where there is one), with the columns time, velocity1, velocity2, ..., position1,
position2, ... under one line of headings. What else is known stands in `NAME_design.json`.
"""

import contextlib
import json
import os
import pathlib
from typing import Any

import numpy as np

from .. import __version__
from .._arguments import expect, expect_path
from .._errors import InputError, input_error
from .._files import replacing
from ..excitation import LIMITS, PHASES, Multisine, Reference, SlowSine
from ._container import Variable, load, save

_KINDS = (".nc", ".mat", ".csv")
_ROWS = 4096  # of a table turned into text at a time
_NEEDED = (
    "r",
    "r_position",
    "lines",
    "amplitude",
    "fs",
    "period",
    "transient_periods",
    "periods",
    "blocks",
    "seed",
    "ramp",
    "phases",
)


def write_reference(path: str | os.PathLike, reference: Reference) -> tuple[pathlib.Path, ...]:
    """Write a reference for a controller; the extension says how.

    Every file is written beside its place and then renamed. CSV numbers have 12 significant digits.

    **Arguments:** `path`: `.nc` or `.mat`: one file; `.csv`: a table for each experiment (time in s, velocities in
    rad/s, positions in rad) and a description. `reference`: of `jaxfrf.reference`.

    **Returns:** the files written.

    **Raises:** `jaxfrf.InputError` if `reference` is none, the extension is not `.nc`, `.mat` or `.csv`, or the folder
    does not exist.
    """
    expect("reference", reference, Reference)
    path = pathlib.Path(path)
    if path.suffix.lower() not in _KINDS:
        raise input_error(
            str(path),
            f"the extension {path.suffix!r}",
            f"one of {', '.join(_KINDS)}",
            "Give the file one of these names.",
        )
    if path.suffix.lower() == ".csv":
        return _write_csv(path, reference)
    save(path, _variables(reference), _attributes(reference.design))
    return (path,)


def reference_files(path: str | os.PathLike, n_exp: int) -> tuple[pathlib.Path, ...]:
    """The files that `write_reference` writes under this name."""
    path = pathlib.Path(path)
    if path.suffix.lower() != ".csv":
        return (path,)
    digits = max(2, len(str(n_exp)))
    names = [path.with_stem(f"{path.stem}_{e:0{digits}d}") for e in range(1, n_exp + 1)] if n_exp > 1 else [path]
    return (*names, path.with_name(f"{path.stem}_design.json"))


def read_reference(path: str | os.PathLike) -> Reference:
    """Read a reference that `write_reference` wrote as `.nc` or `.mat`.

    **Arguments:** `path`: of the file.

    **Returns:** the `jaxfrf.Reference`, in rad and rad/s, with its design.

    **Raises:** `jaxfrf.InputError` naming the file if it is no reference.
    """
    expect_path("path", path)
    path = pathlib.Path(path)
    found = load(path)
    missing = [name for name in _NEEDED if name not in found]
    if missing:
        raise input_error(
            str(path),
            f"no {', '.join(missing)}",
            "a reference written by jaxfrf",
            "Write it again from its design.",
        )
    try:
        design = _design(found)
        # Only axes of length one come and go in files: the order of the samples stays.
        shape = (design.n_exp, -1, design.n_in)
        r, position = (np.asarray(found[name], float).reshape(shape) for name in ("r", "r_position"))
        return Reference(r=r, position=position, design=design)
    except (ValueError, TypeError) as error:  # InputError is a ValueError
        raise InputError(f"{path}: {error}") from error


def _variables(reference: Reference) -> dict[str, Variable]:
    signal = ("experiment", "time", "input")
    return {
        "r": Variable(signal, reference.r, "rad/s"),
        "r_position": Variable(signal, reference.position, "rad"),
        "time": Variable(("time",), reference.time, "s"),
        **_arrays(reference.design),
    }


def _arrays(design: Multisine) -> dict[str, Variable]:
    arrays = {
        "lines": Variable(("line",), design.lines),
        "amplitude": Variable(("line", "input"), design.amplitude, "rad/s"),
    }
    if design.slow is not None:
        arrays["slow_lines"] = Variable(("input",), design.slow.lines)
        arrays["slow_amplitude"] = Variable(("input",), design.slow.amplitude, "rad/s")
    limits = {name: getattr(design, name) for name in LIMITS}
    return arrays | {n: Variable(("input",), x, LIMITS[n]) for n, x in limits.items() if x is not None}


def _attributes(design: Multisine) -> dict[str, float | int | str]:
    return {
        "fs": design.fs,
        "period": design.period,
        "transient_periods": design.transient_periods,
        "periods": design.periods,
        "r_quantity": "velocity",
        "blocks": design.blocks,
        "seed": design.seed,
        "ramp": design.ramp,
        "phases": design.phases.name,
        "version": __version__,
    }


def _design(found) -> Multisine:
    def number(name):
        return np.asarray(found[name]).item()

    lines = np.ravel(found["lines"])
    amplitude = np.reshape(found["amplitude"], (len(lines), -1))
    slow = SlowSine(np.ravel(found["slow_lines"]), np.ravel(found["slow_amplitude"])) if "slow_lines" in found else None
    scalars = {
        name: number(name) for name in ("fs", "period", "periods", "transient_periods", "blocks", "seed", "ramp")
    }
    limits: dict[str, Any] = {name: np.ravel(found[name]) for name in LIMITS if name in found}
    phases = str(found["phases"])
    if phases not in PHASES:
        raise input_error("phases", repr(phases), f"one of {', '.join(PHASES)}", "Write the file again.")
    return Multisine(lines=lines, amplitude=amplitude, slow=slow, phases=PHASES[phases](), **limits, **scalars)


def _write_csv(path: pathlib.Path, reference: Reference) -> tuple[pathlib.Path, ...]:
    """All files are written before the first is renamed, so that a failure leaves none."""
    *names, description = reference_files(path, reference.n_exp)
    with contextlib.ExitStack() as stack:
        for exp, name in enumerate(names):
            _write_table(stack.enter_context(replacing(name)), reference, exp)
        text = json.dumps(_description(reference, names), indent=1)
        stack.enter_context(replacing(description)).write_text(text + "\n", encoding="utf-8")
    return (*names, description)


def _write_table(path: pathlib.Path, reference: Reference, exp: int) -> None:
    channels = range(1, reference.n_in + 1)
    headings = ["time", *(f"velocity{i}" for i in channels), *(f"position{i}" for i in channels)]
    table = np.column_stack([reference.time, reference.r[exp], reference.position[exp]])
    row = ",".join(["%.12g"] * table.shape[1]) + "\n"
    with path.open("w", encoding="ascii", newline="") as file:
        file.write(",".join(headings) + "\n")
        for start in range(0, len(table), _ROWS):
            part = table[start : start + _ROWS]
            file.write(row * len(part) % tuple(part.ravel().tolist()))


def _description(reference: Reference, names: list[pathlib.Path]) -> dict:
    arrays = {name: np.asarray(v.value).tolist() for name, v in _arrays(reference.design).items()}
    units = {"time": "s", "velocity": "rad/s", "position": "rad, about the position at rest"}
    return {"files": [name.name for name in names], "units": units, **_attributes(reference.design), **arrays}
