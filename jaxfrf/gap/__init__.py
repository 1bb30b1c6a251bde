"""Where a model and its measurement disagree, which effect is missing, and what it is worth to add it."""

from .channels import CHANNELS as CHANNELS, AbstractChannel as AbstractChannel, State as State
from .channels.channel import Outcome as Outcome, makes_sense as makes_sense
from .diagnose import diagnose as diagnose
from .result import (
    Cell as Cell,
    Diagnosis as Diagnosis,
    EstimatedValue as EstimatedValue,
    Gap as Gap,
    Maps as Maps,
    Named as Named,
    Ranked as Ranked,
)
