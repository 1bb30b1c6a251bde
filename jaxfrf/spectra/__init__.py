"""From records to spectra: steady periods, Fourier coefficients at the excited lines, noise between periods."""

from .aperiodic import record_spectra as record_spectra, segment_spectra as segment_spectra
from .fourier import period_weights as period_weights
from .lines import (
    added_power as added_power,
    excited_lines as excited_lines,
    found_lines as found_lines,
    known_lines as known_lines,
    line_power as line_power,
    lines_in as lines_in,
    weighed_power as weighed_power,
)
from .rest import at_rest as at_rest
from .spectra import (
    Spectra as Spectra,
    changed_signals as changed_signals,
    differentiate as differentiate,
    select_band as select_band,
    select_positions as select_positions,
    with_output_quantity as with_output_quantity,
)
from .steady import (
    check_power as check_power,
    dft as dft,
    period_advice as period_advice,
    silent_lines as silent_lines,
    unexcited_spectra as unexcited_spectra,
    without_power as without_power,
)
