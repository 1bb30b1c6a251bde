"""Covariances in files: written out, or as the factors that they are made of, where these take less than half of it.

    cov                  (position, frequency, vec, vec), complex: written out
    cov_left, cov_right  (position, frequency, term, input, input) and (position, frequency, term, output, output),
                         complex: sum over the terms of the Kronecker products left (x) right
    cov_columns          (position, frequency, vec, term), complex: sum over the terms of d d^H
    cov_variance         (position, frequency, vec): the diagonal, of one of which no more is known
    cov_scale            (position, frequency, vec): whatever stands above times the scale of its row and its column
    cov_added            (position, frequency, vec): added to the diagonal after that

`cov_noise` and `cov_total` likewise.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..frf.covariance import AbstractFactors, KroneckerSum, OuterSum
from ..frf.scaled import Scaled, Variances, Widened
from ._shaped import as_complex, numbers, shaped

COVARIANCES = ("cov", "cov_noise", "cov_total")
_LESS = 0.5  # of the room of the covariance written out
_PER_LINE = ("position", "frequency")


def axes_of(name: str) -> dict[str, tuple[str, ...]]:
    """What may stand in a file for one covariance, with its axes."""
    term = f"{name}_term"
    return {
        name: (*_PER_LINE, "vec", "vec_conj"),
        f"{name}_left": (*_PER_LINE, term, "input", "input_conj"),
        f"{name}_right": (*_PER_LINE, term, "output", "output_conj"),
        f"{name}_columns": (*_PER_LINE, "vec", term),
        f"{name}_variance": (*_PER_LINE, "vec"),
        f"{name}_scale": (*_PER_LINE, "vec"),
        f"{name}_added": (*_PER_LINE, "vec"),
    }


def arrays_of(name: str, cov) -> dict[str, np.ndarray]:
    """What is written of a covariance."""
    parts = _factors(cov) or {}
    room = sum(np.asarray(x).nbytes for x in parts.values())
    if not parts or room > _LESS * math.prod(cov.shape) * np.dtype(complex).itemsize:
        return {name: np.asarray(cov)}
    return {f"{name}_{part}": np.asarray(x) for part, x in parts.items()}


def _factors(cov) -> dict[str, Any] | None:
    """Its parts; `None` for a covariance that is no such factors."""
    if isinstance(cov, KroneckerSum):
        return {"left": cov.left, "right": cov.right}
    if isinstance(cov, OuterSum):
        return {"columns": cov.columns}
    if isinstance(cov, Variances):
        return {"variance": cov.v}
    for kind, part, before in ((Scaled, "scale", ("scale", "added")), (Widened, "added", ("added",))):
        if isinstance(cov, kind):
            inner = _factors(cov.of)
            return None if inner is None or set(inner) & set(before) else inner | {part: _outer(cov)}
    return None


def _outer(cov: Scaled | Widened):
    return cov.scale if isinstance(cov, Scaled) else cov.more


def covariance_in(
    name: str, names: Mapping[str, Any], shape: tuple[int, ...], where: str
) -> AbstractFactors | np.ndarray | None:
    """The covariance of this name; `None` where the file has none. `shape`: of G."""
    n_out, n_in = shape[2:]
    per_line, vec = shape[:2], n_out * n_in
    held = {part: names[f"{name}_{part}"] for part in _PARTS if f"{name}_{part}" in names}
    place = lambda part: f"{where}: {name}_{part}"
    if name in names:
        return as_complex(shaped(names[name], (*per_line, vec, vec), f"{where}: {name}"))
    cov: AbstractFactors
    if {"left", "right"} <= set(held):
        left = _terms(held["left"], per_line, (n_in, n_in), place("left"))
        right = _terms(held["right"], per_line, (n_out, n_out), place("right"))
        cov = KroneckerSum(left, shaped(right, (*left.shape[:3], n_out, n_out), place("right")))
    elif "columns" in held:
        count = np.asarray(held["columns"]).size // max(math.prod(per_line) * vec, 1)
        cov = OuterSum(as_complex(shaped(held["columns"], (*per_line, vec, count), place("columns"))))
    elif "variance" in held:
        cov = Variances(shaped(held["variance"], (*per_line, vec), place("variance")))
    else:
        return None
    if "scale" in held:
        cov = Scaled(cov, shaped(held["scale"], (*per_line, vec), place("scale")))
    return Widened(cov, shaped(held["added"], (*per_line, vec), place("added"))) if "added" in held else cov


_PARTS = ("left", "right", "columns", "variance", "scale", "added")


def _terms(value, per_line: tuple[int, ...], each: tuple[int, int], where: str) -> np.ndarray:
    count = numbers(value, where).size // max(math.prod(per_line) * math.prod(each), 1)
    return as_complex(shaped(value, (*per_line, count, *each), where))
