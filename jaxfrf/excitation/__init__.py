"""Excitation: line grids, phases, orthogonal multisines, and the references that a controller plays."""

from .level import (
    ExcitationLevels as ExcitationLevels,
    crest_factor as crest_factor,
    line_power as line_power,
    reference_levels as reference_levels,
    rms as rms,
)
from .lines import (
    band_lines as band_lines,
    detection_lines as detection_lines,
    full_lines as full_lines,
    log_odd_lines as log_odd_lines,
    odd_lines as odd_lines,
    random_odd_lines as random_odd_lines,
)
from .multisine import (
    LIMITS as LIMITS,
    Multisine as Multisine,
    SlowSine as SlowSine,
    reference_spectra as reference_spectra,
    shaped_amplitude as shaped_amplitude,
)
from .phases import (
    PHASES as PHASES,
    AbstractPhases as AbstractPhases,
    CrestOptimisedPhases as CrestOptimisedPhases,
    RandomPhases as RandomPhases,
    SchroederPhases as SchroederPhases,
    optimise_crest as optimise_crest,
    random_phases as random_phases,
    schroeder_phases as schroeder_phases,
)
from .signals import Reference as Reference, one_period as one_period, reference as reference
