"""Files: records, references and designs, FRFs, and what other programs read.

Names are imported on first use: what is wrong with a name or a file is said before JAX is there.
"""

import importlib
from typing import TYPE_CHECKING

_PUBLIC = {
    "from_control": "control",
    "to_control": "control",
    "data_set": "blocks",
    "design_from_table": "designs",
    "read_design": "designs",
    "read_fit": "fits",
    "write_fit": "fits",
    "read_gap": "gaps",
    "write_gap": "gaps",
    "mjcf": "mjcf",
    "write_mjcf": "mjcf",
    "write_positions": "positions",
    "parse_map": "record_arguments",
    "parse_factor": "record_arguments",
    "parse_values": "record_arguments",
    "read": "records",
    "write": "records",
    "read_reference": "references",
    "write_reference": "references",
    "frf_from_arrays": "responses",
    "read_frf": "responses",
    "write_frf": "responses",
    "read_robot": "robots",
    "write_robot": "robots",
    "from_sdypy": "sdypy",
    "from_sep005": "sdypy",
    "frf_from_uff": "uff",
    "read_uff": "uff",
    "write_uff": "uff",
    "read_urdf": "urdf",
}

__all__ = [*_PUBLIC]

if TYPE_CHECKING:
    from .blocks import data_set as data_set
    from .control import from_control as from_control, to_control as to_control
    from .designs import design_from_table as design_from_table, read_design as read_design
    from .fits import read_fit as read_fit, write_fit as write_fit
    from .gaps import read_gap as read_gap, write_gap as write_gap
    from .mjcf import mjcf as mjcf, write_mjcf as write_mjcf
    from .positions import write_positions as write_positions
    from .record_arguments import parse_factor as parse_factor, parse_map as parse_map, parse_values as parse_values
    from .records import read as read, write as write
    from .references import read_reference as read_reference, write_reference as write_reference
    from .responses import (
        frf_from_arrays as frf_from_arrays,
        read_frf as read_frf,
        write_frf as write_frf,
    )
    from .robots import read_robot as read_robot, write_robot as write_robot
    from .sdypy import from_sdypy as from_sdypy, from_sep005 as from_sep005
    from .uff import frf_from_uff as frf_from_uff, read_uff as read_uff, write_uff as write_uff
    from .urdf import read_urdf as read_urdf


def __getattr__(name: str):
    if name in _PUBLIC:
        value = getattr(importlib.import_module(f".{_PUBLIC[name]}", __name__), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    return sorted(__all__)
