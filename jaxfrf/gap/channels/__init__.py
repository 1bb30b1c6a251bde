"""Evidence of one kind each, all searched alike; this list is all that names them."""

from collections.abc import Sequence
from typing import Any

from ...robot import Robot
from .channel import AbstractChannel as AbstractChannel, State as State
from .deflection import DeflectionChannel
from .distortion import DistortionChannel
from .response import ResponseChannel
from .torque import TorqueChannel

CHANNELS: list[type[AbstractChannel]] = [TorqueChannel, DeflectionChannel, DistortionChannel, ResponseChannel]


def channel_of(robot: Robot | None, data: Sequence[Any]) -> type[AbstractChannel] | None:
    """The first channel that takes these data; `None`: simulate the robot through the experiment."""
    return next((kind for kind in CHANNELS if kind.takes(robot, data)), None)
