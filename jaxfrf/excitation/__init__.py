"""Excitation: line grids, phases, orthogonal multisines, and the references that a controller plays."""

from .level import Levels as Levels
from .level import crest_factor as crest_factor
from .level import levels as levels
from .level import line_power as line_power
from .level import rms as rms
from .lines import band_lines as band_lines
from .lines import detection_lines as detection_lines
from .lines import full_lines as full_lines
from .lines import log_odd_lines as log_odd_lines
from .lines import odd_lines as odd_lines
from .lines import random_odd_lines as random_odd_lines
from .multisine import Multisine as Multisine
from .multisine import SlowSine as SlowSine
from .multisine import reference_spectra as reference_spectra
from .multisine import shaped_amplitude as shaped_amplitude
from .phases import PHASES as PHASES
from .phases import AbstractPhases as AbstractPhases
from .phases import CrestOptimisedPhases as CrestOptimisedPhases
from .phases import RandomPhases as RandomPhases
from .phases import SchroederPhases as SchroederPhases
from .phases import optimise_crest as optimise_crest
from .phases import random_phases as random_phases
from .phases import schroeder_phases as schroeder_phases
from .signals import Reference as Reference
from .signals import one_period as one_period
from .signals import reference as reference
