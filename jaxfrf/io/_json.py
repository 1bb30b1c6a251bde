"""Plain data as JSON."""

import json
import math
import os
import pathlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._files import replacing


def write_json(path: str | os.PathLike, contents: Mapping[str, Any]) -> None:
    """Write plain data (numbers, texts, arrays, lists, dictionaries) as JSON without NaN, whole or not at all."""
    text = json.dumps(plain_data(contents), indent=1, allow_nan=False, ensure_ascii=False)
    with replacing(pathlib.Path(path)) as draft:
        draft.write_text(text + "\n", encoding="utf-8")


def plain_data(value: Any) -> Any:
    """Arrays as lists, NumPy's and JAX's numbers as Python's, and `None` for what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain_data(x) for key, x in value.items()}
    if isinstance(value, list | tuple):
        return [plain_data(x) for x in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    array = np.asarray(value)
    if array.ndim:
        return [plain_data(x) for x in array]
    item = array.item()
    return item if not isinstance(item, float) or math.isfinite(item) else None
