"""Experiments on simulated robots: robot, effects and excitation in, records out."""

from .experiment import replay as replay, simulate as simulate
from .motion import Motion as Motion, imposed_motion as imposed_motion, replay_motion as replay_motion
from .positions import (
    positions_of as positions_of,
    random_positions as random_positions,
    read_positions as read_positions,
)
from .steps import fine_steps as fine_steps, smoothing_factor as smoothing_factor
