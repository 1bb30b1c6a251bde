"""Parquet tables through pyarrow: columns of numbers, their units from `unit` or `units` of a field's metadata."""

import pathlib

from .._memory import check_memory
from ._container import Leaf, Unreadable, Variables
from ._optional import require

KIND = "a Parquet table"


def load(path: pathlib.Path) -> dict[str, Leaf]:
    """Every column; one with holes has NaN there, lists and texts stay closed."""
    parquet = require("pyarrow.parquet", "parquet")
    with parquet.ParquetFile(path) as file:
        about = file.metadata
        check_memory(str(path), 8.0 * about.num_rows * about.num_columns, "Split the record into several files.")
        table = file.read()
    columns = {name: _leaf(table.column(name)) for name in table.column_names}
    return Variables(columns, {field.name: _unit(field.metadata or {}) for field in table.schema})


def _leaf(column) -> Leaf:
    kind = str(column.type)
    if kind.startswith(("timestamp", "duration")):  # ns, us, ms, s since whenever
        unit = kind.split("[")[1].split("]")[0].split(",")[0]
        ticks = column.cast("int64").to_numpy()
        return (ticks - ticks[0]) * {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
    x = column.to_numpy()
    return x if x.dtype.kind in "biuf" else Unreadable(f"a column of {kind}")


def _unit(metadata: dict[bytes, bytes]) -> str:
    return next((metadata[key].decode(errors="replace") for key in (b"unit", b"units") if key in metadata), "")
