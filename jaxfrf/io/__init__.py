"""Files: records, references and designs, FRFs, and what other programs read."""

from .control import from_control as from_control, to_control as to_control
from .designs import design_from_table as design_from_table, read_design as read_design
from .fits import read_fit as read_fit, write_fit as write_fit
from .gaps import read_gap as read_gap, write_gap as write_gap
from .mjcf import mjcf as mjcf, write_mjcf as write_mjcf
from .positions import write_positions as write_positions
from .record_arguments import parse_map as parse_map, parse_scale as parse_scale, parse_values as parse_values
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
