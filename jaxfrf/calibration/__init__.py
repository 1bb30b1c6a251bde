"""Whole robots from records: every number that is not exactly known, with what was known of it before."""

from .calibrate import calibrate as calibrate
from .numbers import Number as Number, numbers as numbers, with_numbers as with_numbers
from .result import Calibration as Calibration
