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
"""Asked in this order. The line of a channel says where it is: it needs no import."""


def channel_of(robot: Robot | None, data: Sequence[Any]) -> type[AbstractChannel] | None:
    """The first channel that takes these data; `None`: simulate the robot through the experiment."""
    return next((kind for kind in CHANNELS if kind.takes(robot, data)), None)
