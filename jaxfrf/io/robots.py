"""Robots from and to TOML files; `jaxfrf/robot/r3x.toml` is the schema by example."""

import json
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

from .._arguments import expect, expect_path
from .._errors import input_error
from .._files import check_readable, replacing
from ..effects import AbstractEffect
from ..robot.robot import Robot
from ..robot.schema import robot_from_table, table_from_robot
from ._toml import read_toml


def read_robot(path: str | os.PathLike, own: Sequence[type[AbstractEffect]] = ()) -> Robot:
    """The robot that a TOML file describes; with `urdf = "arm.urdf"` in it, links and joints are those of that file
    beside it (`read_urdf`). Of a `.urdf`, the drive trains are those of the TOML file of the same name beside it.

    **Arguments:** `path`: of the `.toml` or `.urdf` file. `own`: effects of your own that the file may name, beside the
    library's.

    **Returns:** the `jaxfrf.robot.Robot`, in SI units.

    **Raises:** `jaxfrf.InputError` naming file and key: not TOML, a key that is unknown (with the nearest
    known one), missing, or of the wrong type. `OSError` if the file cannot be opened.
    """
    expect_path("path", path)
    path = pathlib.Path(path)
    if path.suffix.lower() == ".urdf":
        from .urdf import drives_beside, read_urdf

        return read_urdf(path, drives_beside(path), own)
    if path.suffix.lower() in (".xacro", ".xml"):
        raise input_error(
            path.name, "a file to make others from, or of another program", "a .toml or .urdf", "Export it as URDF."
        )
    check_readable(path, "a robot, .toml or .urdf")
    table = read_robot_toml(path)
    if "urdf" in table:
        from .urdf import read_urdf

        return read_urdf(path.parent / str(table["urdf"]), path, own)
    return robot_from_table(table, path.name, own)


def write_robot(path: str | os.PathLike, robot: Robot) -> None:
    """Write a TOML file that `read_robot` reads back to the same robot. Nothing half written is left.

    **Arguments:** `path`: of the TOML file. `robot`: with its effects and tolerances, in SI units.

    **Raises:** `jaxfrf.InputError` if `robot` is none, a file cannot state it, or the folder is not there.
    """
    expect_path("path", path)
    expect("robot", robot, Robot)
    with replacing(pathlib.Path(path)) as draft:
        draft.write_text(toml_text(table_from_robot(robot)), encoding="utf-8")


def read_robot_toml(path: pathlib.Path) -> dict[str, Any]:
    return read_toml(path, "a robot in TOML", "`jaxfrf example -o run.nc --robot-out ROBOT.toml` writes one.")


def toml_text(table: Mapping[str, Any]) -> str:
    """A table of numbers, texts, lists, tables and lists of tables as TOML."""
    lines, tables = [], []
    for key, value in table.items():
        if isinstance(value, Mapping):
            tables += ["", f"[{key}]", *(f"{_key(k)} = {_value(v)}" for k, v in value.items())]
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            for row in value:
                tables += ["", f"[[{key}]]", *(f"{k} = {_value(v)}" for k, v in row.items())]
        else:
            lines.append(f"{key} = {_value(value)}")
    return "\n".join([*lines, *tables, ""])


def _key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() and key.isascii() else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(x) for x in value)}]"
    return repr(value)  # a float keeps every digit; inf is TOML's inf
