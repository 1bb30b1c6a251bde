"""Evidence of one kind each, all searched alike; this list is all that names them."""

import importlib
from collections.abc import Sequence
from typing import Any

from ...robot import Robot
from .channel import AbstractChannel as AbstractChannel, State as State


def _in(module: str) -> Any:
    """A module of this room."""
    return importlib.import_module(f".{module}", __package__)


CHANNELS: list[type[AbstractChannel]] = [
    _in("torque").TorqueChannel,
    _in("deflection").DeflectionChannel,
    _in("distortion").DistortionChannel,
    _in("response").ResponseChannel,
]
"""The kinds of comparison: of those that take the data, `jaxfrf.diagnose` uses the first. One of your own goes before
any that would take the same data, `CHANNELS.insert(0, MyChannel)`. In the package its line says where it stands, and
needs no import."""


def channel_of(robot: Robot | None, data: Sequence[Any]) -> type[AbstractChannel] | None:
    """The first channel that takes these data; `None`: simulate the robot through the experiment."""
    return next((kind for kind in CHANNELS if kind.takes(robot, data)), None)
