"""What signals show by themselves: how long their period is, and which lines are excited. Arrays in, numbers out."""

from .lines import FoundLines as FoundLines, find_lines as find_lines
from .period import FoundPeriod as FoundPeriod, find_period as find_period, mismatch as mismatch
