"""The FRF of a data set of any size: some positions at a time, here or on workers, each kept until the file stands."""

import dataclasses
import functools
import json
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np

from .. import __version__
from .._alive import alive
from .._errors import InputError, OutputError
from .._files import check_space, replacing
from .._memory import block_memory
from .._status import ADVICE, SERIOUS, describe
from .._text import number
from ..experiment import Experiment, segments, select_periods
from ..frf import FRF, AbstractMethod, adapted, concatenate_positions, describe_method, estimate
from ..frf.covariance import variances
from ..frf.distortion import with_distortion
from ..frf.from_record import spectra_of
from ..frf.scaled import Variances
from ..frf.welch import Welch
from ..io.blocks import Block, DataSet, Told, file_warnings
from ..io.responses import factors_of, kept_otherwise, read_frf, write_frf, writing_frf
from ..io.uff import write_uff
from ..parts import Parts, files_text
from ..screening import Finding, ScreenedPart, Severity, across_all
from ..spectra import (
    Spectra,
    added_power,
    check_power,
    lines_in,
    select_positions,
    silent_lines,
    weighed_power,
    without_power,
)
from .engine import Done, crew, outcomes, positions_text, raised

PART_FILES, BESIDE_PARTS = ("[0-9]" * 5 + ".npz",), ("[0-9]" * 5 + ".json",)
_BLOCK = 3.2e7  # bytes of signals: fewer positions at a time cost more in opening files than they save
_COPIES = 5  # of a block's signals, while it is read, screened and transformed

Progress = Callable[[float], None]


class Chosen(eqx.Module):
    """What of a record is taken, and how it is estimated.

    **Fields:** `method`: of `jaxfrf.estimate`. `periods`: first steady period and the one behind the last, as of
    `jaxfrf.select_periods`. `band`: lowest and highest frequency, Hz. `robust`: periods are weighed, as of
    `jaxfrf.dft`. `segment`: samples of the pieces that a record without a period is cut to.
    """

    method: AbstractMethod
    periods: tuple[int | None, int | None] | None = None
    band: tuple[float | None, float | None] | None = None
    robust: bool = False
    segment: int | None = None

    def spectra(self, data: Experiment, silent: bool = False) -> Spectra:
        data = data if self.segment is None else segments(data, self.segment)
        return spectra_of(data, self.method, periods=self.periods, band=self.band, robust=self.robust, silent=silent)

    def steady(self, data: Experiment) -> Experiment:
        data = data if self.segment is None else segments(data, self.segment)
        return data if self.periods is None else select_periods(data, self.periods[0] or 0, self.periods[1])


class Estimated(eqx.Module):
    """What was written.

    **Fields:** `frf`: with the variances of its covariances alone. `spectra`: of the first position, for what it says
    of all (experiments, periods, lines).
    """

    frf: FRF
    spectra: Spectra


class _EstimateJob(eqx.Module):
    """All that a worker needs to know."""

    data: DataSet
    chosen: Chosen
    lines: np.ndarray | None
    folder: pathlib.Path


def estimate_to(
    path: str | os.PathLike,
    data: DataSet,
    chosen: Chosen,
    *,
    parts: Parts,
    about: Mapping[str, object],
    memory: float | None = None,
    workers: int = 1,
    cluster: str | None = None,
    client: Any = None,
    patience: float | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> Estimated:
    """`jaxfrf.estimate` of a data set, with `jaxfrf.with_distortion`, to a file: `.nc`, `.mat`, `.npz`.

    One position is estimated after the other, whatever `memory` and `workers` are: the numbers are the same. A record
    without a period, or of which `jaxfrf.Welch` takes segments, is taken whole.

    **Arguments:**

    - `path`: of the file. `data`: of `jaxfrf.io.data_set`. `chosen`: what is taken of it, and how. `about`: what the
      caller read it by, for `parts`, which keep what is finished.
    - `memory`: bytes that every process may take, `None`: by what is free.
    - `workers`, `cluster`, `client`, `patience`: as of `jaxfrf.batch.outcomes`; on other machines paths must mean
      the same files.
    - `progress`: called with the part that is done. `say`: called with a line of text.

    **Returns:** `Estimated`: what was written, without the covariances.

    **Raises:** `jaxfrf.InputError` as `jaxfrf.io.read` and `jaxfrf.estimate` do; nothing is kept then.
    """
    here = workers == 1 and cluster is None and client is None
    pieces = _pieces(data, chosen, memory)
    first = data.read(pieces[0]) if here else None
    head, lines = _unscreened_head(data, chosen, pieces) if first is None else _head(data, chosen, pieces, first.data)
    method = adapted(chosen.method, head)
    method.check(head)
    with crew(len(pieces), workers=workers, cluster=cluster, client=client, say=say) as client:
        slow = None if data.digested is None else (data.as_found(), data.digested)
        parts.begin(_about(data, head, method, about), PART_FILES, BESIDE_PARTS, slow)
        _check_room(path, data, head)
        job = _EstimateJob(data, chosen, lines, parts.folder)
        told = {piece.start: found for piece in pieces if (found := _finished(parts, piece)) is not None}
        waiting = [piece for piece in pieces if piece.start not in told]
        done = data.n_pos - sum(map(len, waiting))

        def advanced(count: int) -> None:
            nonlocal done
            done += count
            if progress is not None:
                progress(done / data.n_pos)

        work = functools.partial(_work, job, read=[first], advanced=advanced) if here else functools.partial(_work, job)
        del first  # nobody else holds its memory
        for outcome in outcomes(work, waiting, client=client, patience=patience, say=say):
            piece = waiting[outcome.number]
            told[piece.start] = _checked(outcome, piece, parts)
            parts.settle(wait=False)
            if not here:
                advanced(len(piece))
    parts.settle()
    data = data.named()
    frf = _assembled(path, data, parts, [told[piece.start] for piece in pieces])
    return Estimated(frf, dataclasses.replace(head, sources=data.sources))


def _pieces(data: DataSet, chosen: Chosen, memory: float | None) -> list[range]:
    if isinstance(chosen.method, Welch) or not data.period:
        return [range(data.n_pos)]
    most = int(block_memory(memory) / (_COPIES * data.bytes_each))
    return data.blocks(max(1, min(int(_BLOCK / data.bytes_each), most)))


def _head(data: DataSet, chosen: Chosen, pieces, first: Experiment) -> tuple[Spectra, np.ndarray | None]:
    """Spectra of the first positions, and the lines where no file lists them: all positions speak for these, and for
    lines that carry nothing at the first."""
    if len(pieces) == 1:
        return chosen.spectra(first), None
    lines = _found(data, chosen, pieces) if first.lines is None else None
    others = pieces[1:]
    silent, spectra = _silent(chosen, _with_lines(first, lines))
    while without_power(silent).any() and others:
        silent = silent & _silent(chosen, _with_lines(data.unscreened(others[0]), lines))[0]
        others = others[1:]
    check_power(first, spectra, silent)
    return spectra, lines


def _unscreened_head(data: DataSet, chosen: Chosen, pieces) -> tuple[Spectra, np.ndarray | None]:
    """The same where workers screen the record; what screening says of one that is refused comes first."""
    try:
        return _head(data, chosen, pieces, data.unscreened(pieces[0]))
    except InputError:
        data.read(pieces[0])
        raise


def _silent(chosen: Chosen, data: Experiment) -> tuple[np.ndarray, Spectra]:
    spectra = chosen.spectra(data, silent=True)
    return silent_lines(chosen.steady(data), spectra), spectra


def _found(data: DataSet, chosen: Chosen, pieces) -> np.ndarray:
    """The excited lines, as `jaxfrf.excited_lines` finds them in the whole."""
    power = noise = None
    for piece in pieces:
        part = chosen.steady(data.unscreened(piece))
        k = np.arange(1, (part.period - 1) // 2 + 1)
        power, noise = added_power(part, k, power, noise)
    return lines_in(k, *weighed_power(part, k, power, noise), part).lines


def _with_lines(data: Experiment, lines) -> Experiment:
    return data if lines is None else dataclasses.replace(data, lines=lines)


def _about(data: DataSet, head: Spectra, method: AbstractMethod, about: Mapping[str, object]) -> dict:
    """What the estimate and everything that is stored with it depend on."""
    f = head.frequency
    return {
        "method": describe_method(method),
        "data": files_text(data.sources),
        "output": head.y_quantity,
        "periods": head.n_periods,
        "lines": f"{len(f)} from {number(f[0], 6)} to {number(f[-1], 6)} Hz",
        "positions": data.n_pos,
        **about,
    }


def _check_room(path, data: DataSet, head: Spectra) -> None:
    """Of three dense covariances, in the parts and in the file."""
    check_space(path, 2 * 3 * 16.0 * data.n_pos * len(head.lines) * (head.n_in * head.n_out) ** 2)


def _name(position: int, suffix: str = ".npz") -> str:
    return f"{position:05d}{suffix}"


def _finished(parts: Parts, piece: range) -> Told | None:
    """What was told of a piece of which every part is there and whole; what is damaged is deleted."""
    whole = [parts.read(_name(pos), read_frf) is not None for pos in piece]
    for pos, good in zip(piece, whole, strict=True):
        if not good:
            parts.path(_name(pos)).unlink(missing_ok=True)
    return parts.read(_name(piece.start, ".json"), _read_told) if all(whole) else None


def _work(job: _EstimateJob, piece: range, read: list[Block | None] | None = None, advanced=None) -> Told | InputError:
    """Estimate some positions, in whatever process; what was told of their record, or what is wrong with it. `read`:
    the first block, if it was read already."""
    try:
        first = read.pop() if read else None
        block = first if first is not None and piece.start == 0 else job.data.read(piece)
        data = job.chosen.steady(_with_lines(block.data, job.lines))
        told = block.told
        del first, block
        chosen = dataclasses.replace(job.chosen, periods=None, segment=None)
        spectra = chosen.spectra(data, silent=len(piece) < job.data.n_pos)
        method = adapted(chosen.method, spectra)
        for i, pos in enumerate(piece):
            place = job.folder / _name(pos)
            if not place.is_file():
                one, record = (spectra, data) if len(piece) == 1 else _position(spectra, data, i)
                frf = estimate(one, method)
                if one.periodic:  # segments have lines of their own
                    frf = with_distortion(frf, record, None if chosen.robust else one)
                write_frf(place, frf)
            alive()
            if advanced is not None:
                advanced(1)
    except InputError as error:
        return error
    with replacing(job.folder / _name(piece.start, ".json")) as draft:
        draft.write_text(json.dumps(_told(told), default=lambda x: x.item()), encoding="utf-8")
    return told


def _position(spectra: Spectra, data: Experiment, i: int) -> tuple[Spectra, Experiment]:
    signals = {name: getattr(data, name) for name in "uyrq"}
    part: dict[str, Any] = {name: None if x is None else x[i : i + 1] for name, x in signals.items()}
    return select_positions(spectra, [i]), dataclasses.replace(data, **part)


def _told(told: Told) -> dict:
    """What is kept beside the parts, as JSON."""
    screened = told.screened
    found = [[_finding(f) for f in of] for of in screened.found]
    across = [_finding(f) for f in screened.across]
    return {
        "first": told.first,
        "files": told.files,
        "remarks": told.remarks,
        "found": found,
        "across": across,
        "marks": screened.marks,
    }


def _finding(finding: Finding) -> dict:
    return dataclasses.asdict(finding) | {"severity": finding.severity.value}


def _read_told(path: pathlib.Path) -> Told:
    said = json.loads(path.read_text(encoding="utf-8"))
    back = lambda x: Finding(**x | {"severity": Severity(x["severity"])})
    found = tuple(tuple(map(back, of)) for of in said["found"])
    screened = ScreenedPart(found, tuple(map(back, said["across"])), said["marks"])
    return Told(said["first"], screened, tuple(said["files"]), tuple(map(tuple, said["remarks"])))


def _checked(outcome: Done, piece: range, parts: Parts) -> Told:
    """What came of a piece. Bad input leaves nothing: it would be refused again."""
    if isinstance(outcome.result, InputError) and not isinstance(outcome.result, OutputError):
        parts.discard()
    return raised(outcome, positions_text(piece))


def _assembled(path, data: DataSet, parts: Parts, told: Sequence[Told]) -> FRF:
    """The file from its parts; what is returned holds variances only."""
    light, kept = [], []
    for pos in range(data.n_pos):
        part = read_frf(parts.path(_name(pos)))
        light.append(_light(part))
        kept.append(factors_of(part))
    frf = concatenate_positions(light)
    warnings = [
        *file_warnings(data.files, told),
        *(across_all([x.screened for x in told]) if len(data.files) * data.n_pos * data.n_exp > 1 else ()),
        *(text for text in frf.warnings if text.partition(" estimates: ")[2] not in ADVICE.values()),
        *describe(frf.status & int(SERIOUS)),
    ]
    frf = dataclasses.replace(frf, sources=data.sources, warnings=tuple(dict.fromkeys(warnings)), version=__version__)
    like = _as_told(read_frf(parts.path(_name(0))), frf)
    if pathlib.Path(path).suffix.lower() in (".uff", ".unv"):
        write_uff(path, concatenate_positions([read_frf(parts.path(_name(pos))) for pos in range(data.n_pos)]))
        return frf
    with writing_frf(path, like, data.n_pos, kept_otherwise(kept)) as put:
        for pos in range(data.n_pos):
            put(pos, read_frf(parts.path(_name(pos))))
    return frf


def _light(frf: FRF) -> FRF:
    names = [name for name in ("cov", "cov_noise", "cov_total") if getattr(frf, name) is not None]
    light: dict[str, Any] = {name: Variances(np.asarray(variances(getattr(frf, name)))) for name in names}
    return dataclasses.replace(frf, **light)


def _as_told(part: FRF, whole: FRF) -> FRF:
    """A part with what is said of all, without what others lack."""
    lacking: dict[str, Any] = {
        name: None for name in ("cov_noise", "cov_total", "bias", "q") if getattr(whole, name) is None
    }
    return dataclasses.replace(part, sources=whole.sources, warnings=whole.warnings, **lacking)
