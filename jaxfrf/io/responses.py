"""FRF files: the same names in `.nc`, `.mat` and `.npz`.

    G                          (position, frequency, output, input), complex
    frequency                  (frequency,), Hz
    cov, cov_noise, cov_total  (position, frequency, vec, vec), complex; vec(G) stacks the columns of G; of more than
                               two inputs and outputs the factors that they are made of: `_covariances.py`
    std                        (position, frequency, output, input), beside factors, for other readers
    dof, status, window        (position, frequency)
    q                          (position, joint), rad
    method, options            text; `options` is the part of `method` in brackets
    y_quantity, version        text
    u_unit, y_unit             text, SI; empty: N m, and rad, rad/s or rad/s^2 as y_quantity says
    provenance, warnings       JSON text: [{"name": ..., "sha256": ...}, ...] and ["...", ...]

`cov_noise`, `cov_total` and `q` are absent where they are unknown.

**NetCDF** has no complex numbers of its own. They are stored as the compound (r, i) that its community has
agreed on: valid NetCDF-4, still one variable `G`, complex again in xarray, h5py and netCDF4 (`auto_complex`),
and a pair of parts to every other reader. **MATLAB**: the axes stay as above, while `idfrd` wants (output,
input, frequency): `idfrd(permute(G(1,:,:,:), [3 4 2 1]), 2*pi*frequency, 0)`. MATLAB drops trailing axes of
length one when it saves; they are put back on reading. **NumPy**: no pickle.
"""

import contextlib
import dataclasses
import json
import os
import pathlib
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Complex, Float

from .._arguments import expect, expect_path
from .._errors import input_error
from .._files import digest, replacing
from .._memory import check_memory
from .._status import Status
from .._types import Array
from ..experiment import QUANTITIES, Source
from ..frf import FRF
from ..units import response_unit
from . import _netcdf, _zarr
from ._container import Later, Variable, load
from ._covariances import COVARIANCES, arrays_of, axes_of, covariance_in
from ._formats import UNIVERSAL
from ._netcdf import write_dataset
from ._optional import require
from ._shaped import as_complex, numbers, shaped

_AXES = {
    "G": ("position", "frequency", "output", "input"),
    "frequency": ("frequency",),
    **{part: axes for name in COVARIANCES for part, axes in axes_of(name).items()},
    "std": ("position", "frequency", "output", "input"),
    "bias": ("position", "frequency", "output", "input"),
    "dof": ("position", "frequency"),
    "status": ("position", "frequency"),
    "window": ("position", "frequency"),
    "q": ("position", "joint"),
}


_FIELDS = {field.name for field in dataclasses.fields(FRF)} - set(COVARIANCES)


def write_frf(path: str | os.PathLike, frf: FRF) -> None:
    """Write an FRF with everything that is known about it; the suffix `.nc`, `.zarr`, `.mat` or `.npz` says the
    format. `.uff` and `.unv` hold less: see `write_uff`.

    The file is there whole or not at all, and `read_frf` returns every field bit by bit.

    **Arguments:** `path`: of the file, or of the folder of a `.zarr`. `frf`: with G (pos, freq, out, in), frequencies
    in Hz.

    **Raises:** `jaxfrf.InputError` if `frf` is none, the suffix is another, or the folder is not there.
    """
    expect_path("path", path)
    expect("frf", frf, FRF)
    path = pathlib.Path(path)
    if path.suffix.lower() in UNIVERSAL:
        from .uff import write_uff

        return write_uff(path, frf)
    write = _WRITERS[_suffix(path)]
    with replacing(path) as draft:
        write(draft, _contents(frf))


@contextlib.contextmanager
def writing_frf(
    path: str | os.PathLike, like: FRF, n_pos: int, written_out: Collection[str] = ()
) -> Iterator[Callable[[int, FRF], None]]:
    """`write_frf` of `n_pos` positions that come one after the other: `put(first, frf)` in the block.

    NetCDF and Zarr go to the disk as they come, other formats at the end. `like`: the FRF of some of them, with what is
    said of all (method, sources, warnings). `written_out`: covariances that are kept otherwise at other positions.

    **Raises:** as `write_frf`.
    """
    path = pathlib.Path(path)
    suffix, names = _suffix(path), _contents(like, written_out)
    arrays = {
        name: Later((n_pos, *x.shape[1:]), x.dtype) if axes[0] == "position" else x
        for name, axes in _AXES.items()
        if (x := names.get(name)) is not None
    }

    def put(first: int, frf: FRF) -> None:
        for name, x in _contents(frf, [name for name in COVARIANCES if name in arrays]).items():
            if isinstance(arrays.get(name), Later):
                store(name, first, x)

    with replacing(path) as draft:
        if suffix in (".nc", ".zarr"):
            texts = {name: x for name, x in names.items() if name not in _AXES}
            notes = _notes(names)
            variables = {name: Variable(_AXES[name], x, "", notes.get(name, {})) for name, x in arrays.items()}
            with (_netcdf if suffix == ".nc" else _zarr).blocks(draft, variables, texts) as store:
                yield put
            return
        check_memory(str(path), 3 * sum(x.nbytes for x in arrays.values()), "Write .nc, which needs one position.")
        whole = names | {name: np.empty(x.shape, x.dtype) for name, x in arrays.items() if isinstance(x, Later)}
        store = lambda name, first, x: whole[name].__setitem__(slice(first, first + len(x)), x)
        yield put
        _WRITERS[suffix](draft, whole)


def read_frf(path: str | os.PathLike) -> FRF:
    """Read what `write_frf` wrote, or any `.nc`, `.zarr`, `.mat` or `.npz` file that holds at least `G` and
    `frequency`; universal files (`.uff`, `.unv`) as `read_uff` does.

    What such a file does not hold is unknown: no `cov` means NaN and `Status.NO_COVARIANCE`.

    **Arguments:** `path`: of the file, or of the folder of a `.zarr`.

    **Returns:** the FRF, frequencies in Hz.

    **Raises:** `jaxfrf.InputError` if the file is missing, empty, truncated, of another format, or holds no
    FRF; `ImportError` without the library that the format needs.
    """
    expect_path("path", path)
    path = pathlib.Path(path)
    if path.suffix.lower() in UNIVERSAL:
        from .uff import read_uff

        return read_uff(path)
    _suffix(path)
    return _frf(load(path), str(path))


def kept_otherwise(parts: Sequence[Mapping[str, Any]]) -> list[str]:
    """Covariances of which positions keep other factors. `parts`: of every position, what `factors_of` tells."""
    return [name for name in COVARIANCES if any(part.get(name) != parts[0].get(name) for part in parts)]


def factors_of(frf: FRF) -> dict[str, Any]:
    """What the covariances are kept as, and in which shape."""
    held = {name: getattr(frf, name) for name in COVARIANCES}
    arrays = {name: arrays_of(name, cov) for name, cov in held.items() if cov is not None}
    return {name: {part: x.shape[1:] for part, x in parts.items()} for name, parts in arrays.items()}


def frf_from_arrays(
    G: Complex[Array, "*pos freq out in"] | Complex[Array, "freq"],
    frequency: Float[Array, "freq"],
    *,
    y_quantity: str = "velocity",
    q: Float[Array, "pos joint"] | None = None,
    method: str = "",
    u_unit: str = "",
    y_unit: str = "",
    sources: Sequence[Source] = (),
    warnings: Sequence[str] = (),
) -> FRF:
    """An FRF from bare numbers, without a covariance: `cov` is NaN, `dof` 0 and `status` says
    `NO_COVARIANCE`.

    **Arguments:**

    - `G`: (freq,), (freq, out, in) or (pos, freq, out, in).
    - `frequency`: (freq,), Hz, in any order.
    - `y_quantity`: `position`, `velocity` or `acceleration`.
    - `q`: (pos, joint), rad, or `None`.
    - `u_unit`, `y_unit`: SI units, where they are not N m and rad, rad/s or rad/s^2.
    - `method`: by what the numbers were estimated, in words. `sources`: files that they came from. `warnings`: what is
      to be told with them.

    **Returns:** an FRF, (pos, freq, out, in).

    **Raises:** `jaxfrf.InputError` naming what does not fit.
    """
    contents = {"G": G, "frequency": frequency, "method": method, "y_quantity": y_quantity}
    contents |= {"u_unit": u_unit, "y_unit": y_unit}
    if q is not None:
        contents["q"] = q
    bare = _frf(contents, "FRF")
    return dataclasses.replace(bare, sources=tuple(sources), warnings=tuple(warnings))


def source(path) -> Source:
    """The name of a file and the sha256 of its bytes."""
    path = pathlib.Path(path)
    return Source(path.name, digest(path))


# --- between an FRF and the names of the file ---


def _contents(frf: FRF, written_out: Collection[str] = ()) -> dict[str, Any]:
    named = [x for x in _AXES if x in _FIELDS]
    arrays = {name: np.asarray(getattr(frf, name)) for name in named if getattr(frf, name) is not None}
    for name in COVARIANCES:
        cov = getattr(frf, name)
        if cov is not None:
            arrays |= {name: np.asarray(cov)} if name in written_out else arrays_of(name, cov)
    if "cov" not in arrays:
        arrays["std"] = np.asarray(frf.std)
    options = re.search(r"\((.*)\)\s*$", frf.method, re.DOTALL)
    return arrays | {
        "method": frf.method,
        "options": options.group(1) if options else "",
        "y_quantity": frf.y_quantity,
        "u_unit": frf.u_unit,
        "y_unit": frf.y_unit,
        "unit": response_unit(frf),
        "version": frf.version,
        "provenance": json.dumps([{"name": s.name, "sha256": s.sha256} for s in frf.sources]),
        "warnings": json.dumps(list(frf.warnings)),
    }


def _frf(names: Mapping, where: str) -> FRF:
    if "G" not in names or "frequency" not in names:
        raise _no_frf(names, where)
    frequency = np.atleast_1d(numbers(names["frequency"], f"{where}: frequency")).ravel()
    if np.iscomplexobj(frequency) or not np.isfinite(frequency).all():
        raise input_error(f"{where}: frequency", "complex, NaN or Inf values", "finite frequencies, Hz", "Repair it.")
    order = np.argsort(frequency, kind="stable")
    if np.any(np.diff(frequency[order]) == 0) or np.any(frequency < 0):
        found = "one below zero" if np.any(frequency < 0) else "one of them twice"
        raise input_error(f"{where}: frequency", found, "every frequency once, 0 Hz or more", "Leave it out.")
    G = _response(numbers(names["G"], f"{where}: G"), len(frequency), f"{where}: G")
    per_line, vec = G.shape[:2], G.shape[2] * G.shape[3]
    held = {name: covariance_in(name, names, G.shape, where) for name in COVARIANCES}
    lines: dict[str, Any] = {name: cov for name, cov in held.items() if cov is not None}
    bare = {"dof": np.zeros(per_line), "status": _bare_status(G, "cov" in lines), "window": np.ones(per_line)}
    lines.setdefault("cov", np.full((*per_line, vec, vec), np.nan, complex))
    lines |= {name: shaped(names.get(name, of), per_line, f"{where}: {name}") for name, of in bare.items()}
    if "bias" in names:
        lines["bias"] = np.real(shaped(names["bias"], G.shape, f"{where}: bias"))
    y_quantity = _text(names, "y_quantity") or "velocity"
    if y_quantity not in QUANTITIES:
        raise input_error(f"{where}: y_quantity", repr(y_quantity), f"one of {', '.join(QUANTITIES)}", "Correct it.")
    return FRF(
        G=G[:, order],
        frequency=frequency[order],
        q=_configurations(names["q"], len(G), f"{where}: q") if "q" in names else None,
        method=_text(names, "method"),
        y_quantity=y_quantity,
        u_unit=_text(names, "u_unit"),
        y_unit=_text(names, "y_unit"),
        sources=tuple(Source(s["name"], s["sha256"]) for s in _json(names, "provenance", where)),
        warnings=tuple(_json(names, "warnings", where)),
        version=_text(names, "version"),
        **{name: jax.tree.map(lambda x: x[:, order], whole) for name, whole in lines.items()},
    )


def _bare_status(G: np.ndarray, has_covariance: bool) -> np.ndarray:
    """The status of a response about which nothing else is known."""
    finite = np.isfinite(G).all(axis=(2, 3))
    status = np.where(finite, Status.OK, Status.NOT_FINITE)
    return status if has_covariance else status | Status.NO_COVARIANCE


def _no_frf(names: Mapping, where: str):
    if {"u", "y"} <= set(names):
        return input_error(
            where,
            "an experiment file (it holds u and y)",
            "an FRF file (G and frequency)",
            "Estimate first: jaxfrf estimate DATA -o frf.nc.",
        )
    held = ", ".join(sorted(names)) or "nothing"
    return input_error(where, f"no FRF: it holds {held}", "at least G and frequency", "Name another file.")


def _response(G: np.ndarray, n_freq: int, where: str) -> np.ndarray:
    """(pos, freq, out, in), where the first axis, or trailing ones of length one, may have been dropped."""
    shape = G.shape
    if G.ndim == 4:
        pass
    elif G.ndim == 3 and shape[0] == n_freq:
        shape = (1, *shape)
    elif G.ndim in (2, 3) and shape[1] == n_freq:
        shape = (*shape, *(1,) * (4 - G.ndim))
    elif G.size == n_freq:
        shape = (1, n_freq, 1, 1)
    if len(shape) != 4 or shape[1] != n_freq:
        raise input_error(
            where,
            f"shape {G.shape} with {n_freq} frequencies",
            "(position, frequency, output, input), or (frequency, output, input)",
            "Transpose it: MATLAB's idfrd and python-control keep (output, input, frequency).",
        )
    return as_complex(G.reshape(shape))


def _configurations(value, n_pos: int, where: str) -> np.ndarray:
    q = np.atleast_2d(numbers(value, where))
    if q.ndim != 2 or len(q) != n_pos:
        raise input_error(where, f"shape {q.shape}", f"(position, joint) with {n_pos} positions", "Transpose it.")
    return q


def _text(names: Mapping, name: str) -> str:
    value = names.get(name, "")
    return str(value) if np.size(value) else ""  # MATLAB has no empty text, only empty arrays


def _json(names: Mapping, name: str, where: str) -> list:
    text = _text(names, name)
    try:
        return json.loads(text) if text else []
    except json.JSONDecodeError as error:
        raise input_error(f"{where}: {name}", f"text that is no JSON ({error})", "a JSON list", "Repair it.") from error


# --- formats: each writes a dictionary of arrays and texts ---


def _write_nc(path: pathlib.Path, names: Mapping) -> None:
    xarray = require("xarray", "io")
    require("h5netcdf", "io")
    notes = _notes(names)
    arrays = {name: (axes, names[name], notes.get(name, {})) for name, axes in _AXES.items() if name in names}
    texts = {name: value for name, value in names.items() if name not in _AXES}
    write_dataset(path, xarray.Dataset(arrays, attrs=texts))


def _notes(names: Mapping[str, Any]) -> dict[str, dict]:
    """Attributes of the variables."""
    return {
        "G": {"units": names["unit"], "long_name": "frequency response function"},
        "frequency": {"units": "Hz"},
        "cov": {"long_name": "covariance of vec(G), columns stacked"},
        "dof": {"long_name": "residual degrees of freedom behind cov"},
        "q": {"units": "rad"},
        "status": {
            "flag_masks": np.array([flag.value for flag in Status], names["status"].dtype),
            "flag_meanings": " ".join(str(flag.name).lower() for flag in Status),
        },
    }


def _write_mat(path: pathlib.Path, names: Mapping) -> None:
    import scipy.io
    from scipy.io.matlab import MatWriteError

    try:
        scipy.io.savemat(path, dict(names), oned_as="column", appendmat=False)
    except MatWriteError as error:
        raise input_error(str(path), "2 GB or more in one array", "less (the limit of .mat)", "Write .nc.") from error


def _write_npz(path: pathlib.Path, names: Mapping) -> None:
    with path.open("wb") as file:  # given a name, NumPy may add a suffix
        np.savez(file, allow_pickle=False, **names)


def _write_zarr(path: pathlib.Path, names: Mapping) -> None:
    notes = _notes(names)
    arrays = {
        name: Variable(axes, names[name], "", notes.get(name, {})) for name, axes in _AXES.items() if name in names
    }
    _zarr.save(path, arrays, {name: x for name, x in names.items() if name not in _AXES})


_WRITERS: dict[str, Callable] = {".nc": _write_nc, ".mat": _write_mat, ".npz": _write_npz, ".zarr": _write_zarr}


def _suffix(path: pathlib.Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in _WRITERS:
        found = f"the suffix {suffix!r}" if suffix else "no suffix"
        raise input_error(
            str(path), found, f"one of {', '.join((*_WRITERS, *UNIVERSAL))}", "Name the file accordingly."
        )
    return suffix
