"""Arm configurations to a text file that `jaxfrf.simulation.read_positions` reads."""

import os
import pathlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .._annotated import checked
from .._errors import input_error
from .._files import replacing
from .._types import Array


@checked
def write_positions(
    path: str | os.PathLike,
    q: Float[Array, "pos axis"],
    axis_names: Sequence[str] | None = None,
    comments: Sequence[str] = (),
    units: Sequence[str] = (),
) -> None:
    """Write arm angles, rad, one row for each position, separated by commas, whole or not at all.

    **Arguments:** `path`: of the file. `q`: arm angles, (pos, axis), rad. `axis_names`: over the columns, as a comment.
    `comments`: lines above everything. `units`: of the axes, rad where they are left out.

    **Raises:** `jaxfrf.InputError` if the angles are no finite table, or the folder does not exist.
    """
    q = np.asarray(q, float)
    if q.ndim != 2 or not np.isfinite(q).all():
        raise input_error("q", f"shape {q.shape}", "(position, axis), finite", "Give one row for each position.")
    head = [line for text in comments for line in text.splitlines()]
    if axis_names is not None:
        one = not units or set(units) == {"rad"}
        each = axis_names if one else [f"{name} ({unit})" for name, unit in zip(axis_names, units, strict=True)]
        head.append(", ".join(each) + (" (rad)" if one else ""))
    rows = [", ".join(repr(x) for x in row) for row in q.tolist()]
    with replacing(pathlib.Path(path)) as draft:
        draft.write_text("\n".join([*(f"# {line}" for line in head), *rows, ""]), encoding="utf-8")
