"""The record of an experiment, cut and put together."""

from ..units import QUANTITIES as QUANTITIES, UNITS as UNITS
from .experiment import (
    Experiment as Experiment,
    Source as Source,
    how_to_set as how_to_set,
    seen_period as seen_period,
)
from .selected import (
    check_compatible as check_compatible,
    concatenate as concatenate,
    grouped as grouped,
    places as places,
    rebuilt as rebuilt,
    same_numbers as same_numbers,
    segments as segments,
    select_periods as select_periods,
)
