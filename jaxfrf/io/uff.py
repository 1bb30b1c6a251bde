"""Universal files, dataset 58: what modal-testing software exchanges."""

import collections
import os
import pathlib
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Complex

from .._arguments import expect, expect_path, said
from .._errors import input_error
from .._files import replacing
from .._text import number
from ..experiment import Source
from ..frf import FRF
from ..units import QUANTITIES, differentiated, input_unit, output_unit
from ._optional import require
from .responses import frf_from_arrays, source

_RESPONSE = 4  # function type: frequency response function
_DATA_TYPES = {"position": 8, "velocity": 11, "acceleration": 12}  # specific data types of the response
_FORCE, _FREQUENCY = 13, 18
_NAMES = {"position": "Receptance", "velocity": "Mobility", "acceleration": "Accelerance"}
_ALONG, _AXIS_OF_A_JOINT = 3, 6  # directions: along z, rotation about z
_NO_FORCE = (8, 11, 12)  # specific data types of a reference that is a motion: a transmissibility
_DIGITS = 5  # decimals that dataset 58 keeps of a frequency (E13.5)


def write_uff(path: str | os.PathLike, frf: FRF) -> None:
    """Write an FRF as universal file: one dataset 58 (function type 4) per operating point and element of G.

    Response node i+1 and reference node j+1 stand for output i and input j (rotations about z; motions in m and forces
    in N: along z), the version number counts the operating points from 1, and the response type says receptance,
    mobility or accelerance. Units are those of the FRF (dataset 164: SI).

    Biased: text with 12 digits of G and 6 of the frequency; a regular grid is stored as first value and step.
    The covariance has no place in the format; keep the `.nc` file.

    **Arguments:** `path`: of the file, `.uff` or `.unv`. `frf`: at two frequencies (Hz) or more.

    **Raises:** `ImportError` without pyuff; `jaxfrf.InputError` if there are fewer than two frequencies, or some cannot
    be told apart in 6 digits.
    """
    expect_path("path", path)
    expect("frf", frf, FRF)
    pyuff = require("pyuff", "io")
    frequency = np.asarray(frf.frequency)
    _check_frequencies(frequency, str(path))
    with replacing(pathlib.Path(path)) as draft:
        pyuff.UFF(str(draft)).write_sets([_si_units(), *_records(frf, frequency)], "overwrite")


def read_uff(path: str | os.PathLike) -> FRF:
    """Read the FRFs (datasets 58 of function type 4) of a universal file; see `frf_from_uff`.

    **Arguments:** `path`: of the file, `.uff` or `.unv`.

    **Returns:** an FRF, (pos, freq, out, in), without a covariance.

    **Raises:** `jaxfrf.InputError` if the file is missing, or holds no complete set of FRFs; `ImportError` without
    pyuff.
    """
    expect_path("path", path)
    pyuff = require("pyuff", "io")
    path = pathlib.Path(path)
    if not path.is_file():
        raise input_error(str(path), "no such file", "a universal file", "Check the name.")
    try:
        sets = pyuff.UFF(str(path)).read_sets()
    except Exception as error:  # pyuff raises bare Exception (AttributeError for a file without datasets)
        raise input_error(
            str(path),
            f"a file that cannot be read ({error})",
            "a universal file with datasets 58",
            "It is empty, truncated or of another format.",
        ) from error
    return frf_from_uff(sets if isinstance(sets, list) else [sets], sources=(source(path),), where=str(path))


def frf_from_uff(sets: Iterable[Mapping], *, sources: Sequence[Source] = (), where: str = "universal file") -> FRF:
    """One FRF from the dataset dictionaries of pyuff (or sdypy.io.uff), without a covariance.

    Response (node, direction) pairs become outputs, reference pairs inputs, in ascending order. Datasets of
    the same element are told apart by their version number, which then counts operating points. Directions along axes
    are motions in m and forces in N, those about axes in rad and N m; where a dataset 164 states units, G of the sets
    that follow it, up to the next one, is converted to SI by its factors.

    **Arguments:** `sets`: dictionaries, of which those of type 58 and function type 4 count, `x` in Hz. `sources`: of
    the FRF. `where`: what errors call the sets.

    **Returns:** an FRF, (pos, freq, out, in), in the quantity that the datasets state.

    **Raises:** `jaxfrf.InputError` if there is no FRF, the matrix has holes, frequencies or quantities differ, and
    where the reference is a motion, or forces and torques (translations and rotations) are mixed.
    """
    given, sets = sets, list(sets) if isinstance(sets, Iterable) else [sets]
    if not all(isinstance(s, Mapping) for s in sets):
        raise input_error("sets", said(given), "a list of dataset dictionaries", "Of a file: jaxfrf.io.read_uff(path).")
    records = list(_responses(sets))
    if not records:
        raise input_error(where, "no FRF", "datasets 58 of function type 4", "Export frequency responses.")
    elements = collections.Counter((_response(s), _reference(s)) for s in records)
    several = max(elements.values()) > 1
    places = sorted({s.get("ver_num", 0) for s in records}) if several else [None]
    outputs, inputs = sorted({out for out, _ in elements}), sorted({ref for _, ref in elements})
    found = {(s.get("ver_num", 0) if several else None, _response(s), _reference(s)): s for s in records}
    expected = len(places) * len(outputs) * len(inputs)
    if len(found) != len(records) or len(found) != expected:
        raise input_error(
            where,
            f"{len(records)} FRFs: {len(outputs)} responses, {len(inputs)} references, {len(places)} places",
            f"each pair once at every place ({expected} FRFs)",
            "Leave out what is double, or select complete rows and columns.",
        )
    frequency = np.asarray(records[0]["x"], float)
    if any(not np.array_equal(s["x"], frequency) for s in records):
        raise input_error(where, "different frequencies", "the same ones in every dataset", "Resample or split it.")
    if any(np.shape(s["data"]) != frequency.shape for s in records):
        raise input_error(where, "fewer or more values than frequencies", "one at each", "Export it again.")
    if any(int(s.get("orddenom_spec_data_type", 0)) in _NO_FORCE for s in records):
        raise input_error(where, "a motion as reference (a transmissibility)", "a force or torque", "Leave it out.")
    linear = [
        _linear({d for _, d in pairs}, what, where) for pairs, what in ((outputs, "responses"), (inputs, "references"))
    ]
    G = np.array([[[_in_si(found[p, o, i], *linear) for i in inputs] for o in outputs] for p in places])
    quantity = _quantity(records, where)
    return frf_from_arrays(
        np.moveaxis(G, -1, 1),
        frequency,
        y_quantity=quantity,
        u_unit="N" if linear[1] else "",
        y_unit=differentiated("m", QUANTITIES[quantity]) if linear[0] else "",
        method=str(records[0].get("id2", "")).strip().removesuffix("NONE"),
        sources=sources,
    )


def _responses(sets: Sequence[Mapping]) -> Iterable[Mapping]:
    """The FRFs, each with what a length and a force of it are divided by: the dataset 164 before it says so, or the
    first of a file that begins without one."""
    units = next((s for s in sets if s.get("type") == 164), {})
    for s in sets:
        units = s if s.get("type") == 164 else units
        if s.get("type") == 58 and s.get("func_type") == _RESPONSE:
            yield {**s, **{name: float(units.get(name) or 1.0) for name in ("length", "force")}}


def _response(record: Mapping) -> tuple[int, int]:
    return int(record["rsp_node"]), int(record["rsp_dir"])


def _reference(record: Mapping) -> tuple[int, int]:
    return int(record["ref_node"]), int(record["ref_dir"])


def _linear(directions: set[int], what: str, where: str) -> bool:
    """Whether directions are along axes (1 to 3) or about them (4 to 6, and where a file does not say)."""
    kinds = {1 <= abs(d) <= _ALONG for d in directions}
    if len(kinds) > 1:
        raise input_error(
            where, f"{what} along and about axes", "one unit for all", "Select one kind in the program that wrote it."
        )
    return kinds.pop()


def _in_si(record: Mapping, of_response: bool, of_reference: bool) -> Complex[np.ndarray, "freq"]:
    force = record["force"] if of_reference else record["force"] * record["length"]
    return np.asarray(record["data"], complex) * (force / (record["length"] if of_response else 1.0))


def _quantity(records: list[Mapping], where: str) -> str:
    types = {int(s.get("ordinate_spec_data_type", 0)) for s in records}
    names = [name for name, number in _DATA_TYPES.items() if types == {number}]
    if not names:
        raise input_error(
            where,
            f"response data types {sorted(types)}",
            "all of them 8 (displacement), 11 (velocity) or 12 (acceleration)",
            "Set the type of the responses in the program that wrote the file.",
        )
    return names[0]


def _check_frequencies(frequency: np.ndarray, where: str) -> None:
    if len(frequency) < 2:
        raise input_error(where, "one frequency", "at least two (pyuff needs a step)", "Write .nc or .mat.")
    stored = [f"{f:.{_DIGITS}e}" for f in frequency]
    if len(set(stored)) < len(stored):
        raise input_error(
            where,
            "neighbouring frequencies that agree in 6 digits",
            "frequencies that dataset 58 can tell apart",
            "Write .nc or .mat, or thin out the lines.",
        )


def _si_units() -> dict:
    return {
        "type": 164,
        "units_code": 1,
        "units_description": "SI: metre, newton",
        "temp_mode": 1,
        "length": 1.0,
        "force": 1.0,
        "temp": 1.0,
        "temp_offset": 273.15,
    }


def _records(frf: FRF, frequency: np.ndarray) -> Iterable[dict]:
    steps = np.diff(frequency)
    y_unit, u_unit = output_unit(frf), input_unit(frf)
    along = (y_unit == differentiated("m", QUANTITIES[frf.y_quantity]), u_unit == "N")
    common = {
        "type": 58,
        "func_type": _RESPONSE,
        "abscissa_spacing": int(np.allclose(steps, steps[0], rtol=1e-6)),
        "x": frequency,
        "id2": _line(frf.method),
        "id5": _line(f"jaxfrf {frf.version}"),
        "rsp_dir": _ALONG if along[0] else _AXIS_OF_A_JOINT,
        "ref_dir": _ALONG if along[1] else _AXIS_OF_A_JOINT,
        "abscissa_spec_data_type": _FREQUENCY,
        "abscissa_axis_lab": "Frequency",
        "abscissa_axis_units_lab": "Hz",
        "ordinate_spec_data_type": _DATA_TYPES[frf.y_quantity],
        "ordinate_axis_lab": frf.y_quantity.capitalize(),
        "ordinate_axis_units_lab": y_unit,
        "orddenom_spec_data_type": _FORCE,
        "orddenom_axis_lab": {"N m": "Torque", "N": "Force"}.get(u_unit, "Excitation"),
        "orddenom_axis_units_lab": u_unit,
    }
    for pos, out, ref in np.ndindex(frf.n_pos, frf.n_out, frf.n_in):
        yield common | {
            "id1": f"{_NAMES[frf.y_quantity]} G({out + 1},{ref + 1}), position {pos + 1}",
            "id4": _line(_configuration(frf, pos)),
            "ver_num": pos + 1,
            "rsp_node": out + 1,
            "ref_node": ref + 1,
            "data": np.asarray(frf.G[pos, :, out, ref], complex),
        }


def _configuration(frf: FRF, pos: int) -> str:
    if frf.q is None:
        return f"position {pos + 1}"
    return f"q = {', '.join(f'{number(x, 4)}' for x in np.asarray(frf.q[pos]))} rad"


def _line(text: str) -> str:
    """Text for an identification line: one line of at most 80 ASCII characters, never blank."""
    return " ".join(text.encode("ascii", "replace").decode().split())[:80] or "NONE"
