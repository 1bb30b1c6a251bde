"""Whether a MATLAB file of version 5 is whole: SciPy's compiled reader trusts what a file states of itself, and damaged
ones have brought the process down.

Source: MAT-File Format, The MathWorks, version 5 (level 5 MAT-files).
"""

import itertools
import math
import pathlib
import struct
import zlib
from collections.abc import Iterator

from .._memory import check_memory

_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}  # bytes, by data type
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED = 1, 5, 6, 14, 15
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_TEXTS = (1, 2, 3, 4, 16, 17, 18)  # data types of characters
_NUMERIC = range(6, 16)
_COMPLEX = 0x0800
_DEEPEST = 50  # structures within structures
_MOST_AXES = 32
_HEADER = 128


class DamagedError(ValueError):
    """What a file states does not fit what it holds."""


def check_whole(path: pathlib.Path) -> None:
    """Walk through all elements of a file without keeping any.

    **Raises:** `ValueError` where a length, a type or a number of elements does not fit the others;
    `jaxfrf.InputError` for what does not fit into memory.
    """
    data = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None or data[:4].count(0):
        _check_version_4(data)
        return
    expanded = 0
    for kind, part in _elements(memoryview(data)[_HEADER:], order, padded=False):
        if kind == _COMPRESSED:
            part = _expanded(path, part, expanded)
            expanded += len(part)
            inner = list(_elements(part, order, padded=False))
            if len(inner) != 1:
                raise DamagedError(f"{len(inner)} elements in a compressed one")
            kind, part = inner[0]
        if kind != _MATRIX:
            raise DamagedError(f"an element of type {kind} where a variable should be")
        _check_matrix(part, order, 0)


def _expanded(path: pathlib.Path, part: memoryview, before: int) -> memoryview:
    stream, pieces, size, left = zlib.decompressobj(), [], 0, part
    while not stream.eof:
        piece = stream.decompress(left, 2**26)
        left = memoryview(stream.unconsumed_tail)
        if not piece and not left:
            raise DamagedError("a compressed element that ends early")
        pieces.append(piece)
        size += len(piece)
        check_memory(str(path), 2.0 * (before + size), "Split the record into several files.")
    return memoryview(b"".join(pieces))


def _elements(data: memoryview, order: str, padded: bool = True) -> Iterator[tuple[int, memoryview]]:
    """Type and contents of all elements, one after the other."""
    at = 0
    while at < len(data):
        if len(data) - at < 8:
            raise DamagedError("an element that ends early")
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # a small one: type and size in one word, the contents in the other
            kind, size, start, at = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            if size > 4:
                raise DamagedError(f"a small element of {size} bytes")
        else:
            start = at + 8
            at = start + (-(-size // 8) * 8 if padded and kind != _COMPRESSED else size)
        if start + size > len(data):
            raise DamagedError(f"an element of {size} bytes where {len(data) - start} follow")
        yield kind, data[start : start + size]


class _Parts:
    """The elements of one variable, taken in order."""

    def __init__(self, data: memoryview, order: str):
        self._left, self.order = _elements(data, order), order

    def take(self, *kinds: int) -> memoryview:
        kind, part = next(self._left, (0, memoryview(b"")))
        if kind not in kinds:
            raise DamagedError(f"an element of type {kind} in a variable where {kinds} should be")
        return part

    def whole_numbers(self) -> tuple[int, ...]:
        part = self.take(_INT32, _UINT32)  # some programs write the one for the other
        if len(part) % 4:
            raise DamagedError(f"{len(part)} bytes of numbers of 4 bytes")
        return struct.unpack(f"{self.order}{len(part) // 4}i", part)

    def numbers(self, count: int, kinds=tuple(_SIZES)) -> None:
        kind, part = next(self._left, (0, memoryview(b"")))
        if kind not in kinds or len(part) != count * _SIZES[kind]:
            raise DamagedError(f"{len(part)} bytes of type {kind} for {count} numbers")

    def check_empty(self) -> None:
        if next(self._left, None) is not None:
            raise DamagedError("more elements than the variable states")


def _check_matrix(data: memoryview, order: str, depth: int) -> None:
    if depth > _DEEPEST:
        raise DamagedError("structures within structures, too deep to be a record")
    if not len(data):
        return  # an empty one
    parts = _Parts(data, order)
    flags = parts.whole_numbers()
    if len(flags) != 2:
        raise DamagedError("no flags of an array")
    kind, is_complex = flags[0] & 0xFF, bool(flags[0] & _COMPLEX)
    if kind == _OPAQUE:
        for _ in range(3):
            parts.take(_INT8)
        _check_matrix(parts.take(_MATRIX), order, depth + 1)
        return
    shape = parts.whole_numbers()
    if not 2 <= len(shape) <= _MOST_AXES or min(shape) < 0:
        raise DamagedError(f"the shape {shape}")
    count = math.prod(shape)
    parts.take(_INT8, 2, 16)  # the name
    if kind in (_STRUCT, _OBJECT):
        count *= _fields(parts, kind)
    if kind in (_CELL, _STRUCT, _OBJECT):
        if count > len(data):
            raise DamagedError(f"{count} elements in {len(data)} bytes")
        for _ in range(count):
            _check_matrix(parts.take(_MATRIX), order, depth + 1)
    elif kind == _FUNCTION:
        _check_matrix(parts.take(_MATRIX), order, depth + 1)
    elif kind == _SPARSE:
        _check_sparse(parts, shape, is_complex)
    elif kind == _CHAR:
        _check_text(parts, count)
    elif kind in _NUMERIC:
        for _ in range(2 if is_complex else 1):
            parts.numbers(count)
    else:
        raise DamagedError(f"an array of class {kind}")
    parts.check_empty()


def _fields(parts: _Parts, kind: int) -> int:
    """The number of fields of a structure; an object names its class before."""
    if kind == _OBJECT:
        parts.take(_INT8)
    length = parts.whole_numbers()
    names = parts.take(_INT8)
    if len(length) != 1 or length[0] < 1 or len(names) % length[0]:
        raise DamagedError(f"{len(names)} bytes of names of {length} bytes")
    return len(names) // length[0]


def _check_sparse(parts: _Parts, shape, is_complex: bool) -> None:
    rows, columns = parts.whole_numbers(), parts.whole_numbers()
    rising = all(a <= b for a, b in itertools.pairwise(columns))
    if len(shape) != 2 or len(columns) != shape[1] + 1 or not rising or columns[0] != 0 or columns[-1] > len(rows):
        raise DamagedError("columns of a sparse array that are no columns")
    if any(not 0 <= row < max(shape[0], 1) for row in rows):
        raise DamagedError("rows of a sparse array beyond its end")
    for _ in range(2 if is_complex else 1):
        parts.take(*_SIZES)


def _check_text(parts: _Parts, count: int) -> None:
    kind, part = next(parts._left, (0, memoryview(b"")))
    if kind not in _TEXTS or (kind not in (16, 17) and len(part) not in (0, count * _SIZES[kind])):
        raise DamagedError(f"{len(part)} bytes of type {kind} for {count} letters")


def _check_version_4(data: bytes) -> None:
    """Version 4: twenty bytes before every variable, no mark at the beginning."""
    at = 0
    while at < len(data):
        if len(data) - at < 20:
            raise DamagedError("no header of a MATLAB file")
        little = struct.unpack_from("<5i", data, at)
        order, header = ("<", little) if 0 <= little[0] < 5000 else (">", struct.unpack_from(">5i", data, at))
        kind, rows, columns, imaginary, name = header
        thousands, hundreds, tens, ones = (kind // 10**k % 10 for k in (3, 2, 1, 0))
        sizes = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}
        sound = 0 <= kind < 5000 and thousands == (order == ">") and hundreds == 0 and tens in sizes and ones < 3
        if not sound or min(rows, columns, name - 1) < 0 or name > 4096 or imaginary not in (0, 1):
            raise DamagedError("no header of a MATLAB file")
        count = rows * columns * (2 if imaginary and ones != 2 else 1)
        if ones == 2:
            _check_version_4_sparse(data, at + 20 + name, order, rows, columns, sizes[tens])
        at += 20 + name + count * sizes[tens]
    if at > len(data):
        raise DamagedError("a variable that ends early")


def _check_version_4_sparse(data: bytes, at: int, order: str, rows: int, columns: int, size: int) -> None:
    if size != 8 or columns not in (3, 4) or rows < 1 or at + 8 * rows * columns > len(data):
        raise DamagedError("a sparse array that is none")
    places = struct.unpack_from(f"{order}{2 * rows}d", data, at)
    top = places[rows - 1], places[-1]
    inside = all(1 <= i <= max(top[0], 1) for i in places[: rows - 1]) and all(
        1 <= i <= max(top[1], 1) for i in places[rows:-1]
    )
    if not inside or not all(math.isfinite(x) and x < 2**31 for x in top):
        raise DamagedError("places of a sparse array beyond its end")
