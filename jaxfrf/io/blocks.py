"""Files as one data set that is read some positions at a time."""

import dataclasses
import os
import pathlib
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future

import numpy as np

from .._errors import InputError
from .._files import size_and_time
from ..experiment import Experiment, Source, check_compatible, grouped, places
from ..screening import ScreenedPart, refused, screen_part
from ._configurations import gathered
from ._container import check_file, load, positions_in
from ._joined import part_of
from ._variables import Given
from .record_arguments import check_factor, check_names, check_values
from .records import as_given, joinable, record_of, source_of

_SMALL = 1e8  # bytes of u in a file that is not read twice


@dataclasses.dataclass(frozen=True)
class Told:
    """What is to be said of some positions of a data set.

    **Fields:** `first`: number of the first position. `screened`: what screening found. `files`: numbers of those that
    hold them; `remarks`: by file, what is to be said of reading it.
    """

    first: int
    screened: ScreenedPart
    files: tuple[int, ...]
    remarks: tuple[tuple[str, ...], ...]


@dataclasses.dataclass(frozen=True)
class Block:
    """Some positions of a data set: the record, and what is to be said of it."""

    data: Experiment
    told: Told


@dataclasses.dataclass(frozen=True)
class _File:
    path: pathlib.Path
    source: Source  # without a digest until all are `named`
    n_pos: int
    sliced: bool


@dataclasses.dataclass(frozen=True)
class DataSet:
    """Files that `jaxfrf.io.read` would read as one record, and how (see `data_set`).

    **Fields:** `n_exp`, `period`; `bytes_each`: of the signals at one position.
    """

    files: tuple[_File, ...]
    groups: tuple[tuple[int, ...], ...]  # numbers of the files with experiments at the same positions; group by group
    n_exp: int
    period: int
    bytes_each: float
    given: Given
    kept: dict = dataclasses.field(default_factory=dict, compare=False)  # small files that were read as a whole
    digested: Future[tuple[Source, ...]] | None = dataclasses.field(default=None, compare=False)

    def __getstate__(self):
        return self.__dict__ | {"kept": {}, "digested": None}

    def named(self) -> "DataSet":
        """The same, with the digests of all files, which a thread has begun to make: of large files that lasts."""
        if self.digested is None:
            return self
        files = tuple(
            dataclasses.replace(f, source=source) for f, source in zip(self.files, self.digested.result(), strict=True)
        )
        of = {f.path: f.source for f in files}
        kept = {x: (dataclasses.replace(data, sources=(of[x],)), told) for x, (data, told) in self.kept.items()}
        return dataclasses.replace(self, files=files, kept=kept, digested=None)

    def as_found(self) -> str:
        """Names, sizes and times of the files: what is known of them before their digests."""
        return ", ".join(f"{f.path.name} ({size_and_time(f.path)})" for f in self.files)

    @property
    def n_pos(self) -> int:
        return sum(self.files[group[0]].n_pos for group in self.groups)

    @property
    def sources(self) -> tuple[Source, ...]:
        return tuple(f.source for f in self.files)

    def blocks(self, size: int) -> list[range]:
        """All positions in blocks of `size` or fewer that lie in one file each (in all of a group, where several hold
        experiments of the same positions); files that cannot be read in part are one block."""
        found, first = [], 0
        for group in self.groups:
            n = self.files[group[0]].n_pos
            step = size if all(self.files[i].sliced for i in group) else n
            found += [range(first + a, first + min(a + step, n)) for a in range(0, n, step)]
            first += n
        return found

    def read(self, positions: range) -> Block:
        """Some positions, screened.

        **Raises:** `jaxfrf.InputError` as `jaxfrf.io.read` does.
        """
        groups = self._where(positions)
        where = [x for group in groups for x in group]
        read = [self._one(self.files[i], local) for i, local in where]
        records = [data for data, _ in read]
        whole = _together(records, groups)
        files = [(x, local.start) for x, (_, local) in zip(records, where, strict=True)]
        screened = screen_part(files, whole, positions.start)
        numbers = tuple(i for i, _ in where)
        if not self.given.anyway:
            for i, found in zip(numbers, screened.found, strict=True):
                try:
                    refused(found)
                except InputError as error:
                    raise InputError(f"{self.files[i].path}: {error}") from None
            refused(screened.across)
        return Block(whole, Told(positions.start, screened, numbers, tuple(tuple(remarks) for _, remarks in read)))

    def unscreened(self, positions: range) -> Experiment:
        """The record at some positions."""
        groups = self._where(positions)
        return _together([self._one(self.files[i], local)[0] for group in groups for i, local in group], groups)

    def _where(self, positions: range) -> list[list[tuple[int, range]]]:
        """The files that hold these positions, by groups, and which positions of theirs these are."""
        first, found = 0, []
        for group in self.groups:
            n = self.files[group[0]].n_pos
            local = range(max(positions.start - first, 0), min(positions.stop - first, n))
            if local:
                found.append([(i, local) for i in group])
            first += n
        return found

    def _one(self, file: _File, local: range) -> tuple[Experiment, list[str]]:
        part = slice(local.start, local.stop) if file.sliced else None
        if file.path in self.kept:
            return self.kept[file.path]
        try:
            return record_of(file.path, self.given, file.source, part)[:2]
        except InputError as error:
            if not (part and local.start):
                raise
            raise InputError(f"{error} (Positions here count from number {local.start} of the file on.)") from None


def data_set(
    *paths: str | os.PathLike,
    names: Mapping[str, str] | None = None,
    values: Mapping[str, object] | None = None,
    factor: Mapping[str, float | tuple[float, ...]] | None = None,
    anyway: bool = False,
) -> DataSet | None:
    """What `jaxfrf.io.read` would read, to be read some positions at a time; `None` where it cannot be: where the
    channels of one record come from several files.

    NetCDF and Zarr files are read in part; of others only whole ones can be left for later.

    **Arguments:** `paths`, `names`, `values`, `factor`, `anyway`: as of `jaxfrf.io.read`.

    **Returns:** the data set, whose records are `jaxfrf.Experiment`s, or `None`.

    **Raises:** as `jaxfrf.io.read`.
    """
    given = as_given(check_names(names), check_values(values), check_factor(factor), anyway)
    files = [pathlib.Path(path) for path in paths]
    if len(files) > 1 and any(part_of(name, files) for name in given.names.values()):
        return None
    found, heads, at, nears, kept = [], [], [], [], {}
    for path in files:
        check_file(path)
    digested = _begun(files)
    with joinable(files):
        for path in files:
            n_pos = positions_in(path)
            source = Source(path.name)
            head, remarks, near = record_of(path, given, source, slice(0, 1) if n_pos else None)
            if n_pos is None and 8 * head.u.size < _SMALL:
                kept[path] = head, remarks
            if near is not None and n_pos is not None and n_pos > 1:
                return None  # of all positions the whole record must be seen
            found.append(_File(path, source, n_pos or head.n_pos, n_pos is not None))
            heads.append(_short(head))
            at.append(_places(path, given, n_pos, head))
            nears.append(near)
    for other in heads[1:]:
        check_compatible(heads[0], other)
    groups = places(gathered(at, nears), [h.n_exp for h in heads])
    experiments = [sum(heads[i].n_exp for i in group) for group in groups]
    if len(set(experiments)) > 1 or any(len({found[i].n_pos for i in group}) > 1 for group in groups):
        return None  # reading it whole says what is wrong
    bytes_each = experiments[0] * heads[0].u[0, 0].nbytes * _width(heads[0]) / heads[0].n_in
    return DataSet(tuple(found), tuple(groups), experiments[0], heads[0].period, bytes_each, given, kept, digested)


def _begun(paths: Sequence[pathlib.Path]) -> Future[tuple[Source, ...]]:
    """`source_of` of files, one after the other, beside what else is done; a program that ends does not wait for it."""
    found: Future[tuple[Source, ...]] = Future()

    def work() -> None:
        try:
            found.set_result(tuple(source_of(path) for path in paths))
        except Exception as error:
            found.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    return found


def _width(data: Experiment) -> int:
    """Channels of all signals."""
    return data.n_in + data.n_out + (0 if data.r is None else data.r.shape[-1])


class Held:
    """A record in memory as a data set of one block, read and screened already."""

    digested = None

    def __init__(self, data: Experiment):
        self.data, self.files, self.sources, self.n_pos = data, (), data.sources, data.n_pos
        self.n_exp, self.period, self.bytes_each = data.n_exp, data.period, data.u[0].nbytes * _width(data) / data.n_in

    def named(self) -> "Held":
        return self

    def blocks(self, size: int) -> list[range]:
        return [range(self.n_pos)]

    def read(self, positions: range) -> Block:
        return Block(self.data, Told(0, ScreenedPart((), (), []), (), ()))


in_memory = Held


def _places(path: pathlib.Path, given: Given, n_pos: int | None, head: Experiment) -> np.ndarray | None:
    """The configurations at all positions of a file."""
    if n_pos is None or n_pos == 1 or head.q is None or "q" in given.values:
        return None if head.q is None else np.asarray(head.q)
    small = load(path, part=slice(0, n_pos), without="time")
    q = small.get(given.names.get("q", "q"))
    return np.asarray(head.q if q is None else q, float)


def _together(records: Sequence[Experiment], groups: Sequence[Sequence]) -> Experiment:
    """Records one after the other as one, those of a group as experiments of the same positions."""
    numbers = iter(range(len(records)))
    return grouped(records, [tuple(next(numbers) for _ in group) for group in groups])


def _short(data: Experiment) -> Experiment:
    """What is compared and counted of a record, without its memory."""
    still = lambda x: None if x is None else np.broadcast_to(0.0, (1, *x.shape[1:]))
    cut = {name: still(getattr(data, name)) for name in "uyr"} | {"q": None if data.q is None else data.q[:1].copy()}
    return Experiment(**{f.name: getattr(data, f.name) for f in dataclasses.fields(data)} | cut)


def file_warnings(files: Sequence[_File], told: Sequence[Told]) -> tuple[str, ...]:
    """What `jaxfrf.io.read` says of the files, of all blocks in their order."""
    from ..screening import sentences

    warnings = []
    for i, file in enumerate(files):
        of = [(x, x.files.index(i)) for x in told if i in x.files]
        remarks = dict.fromkeys(text for x, at in of for text in x.remarks[at])
        said = sentences([f for x, at in of for f in x.screened.found[at]])
        warnings += [f"{file.path}: {text}" for text in (*remarks, *said)]
    return tuple(dict.fromkeys(warnings))
