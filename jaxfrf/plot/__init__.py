"""Pictures: functions that take results and return matplotlib figures and axes."""

from ._style import save as save
from .bode import bode as bode, confidence_radius as confidence_radius
from .calibration import numbers_found as numbers_found
from .coherence import coherence as coherence
from .distortion import distortion as distortion
from .excitation import multisine as multisine
from .fit import (
    correlation_map as correlation_map,
    fit_bode as fit_bode,
    residual_maps as residual_maps,
    round_gaps as round_gaps,
    start_paths as start_paths,
)
from .gap import (
    gap_bode as gap_bode,
    gap_dumbbells as gap_dumbbells,
    gap_maps as gap_maps,
    torque_courses as torque_courses,
)
from .modes import stabilisation as stabilisation
from .plan import plan as plan
from .spectrum import spectrum as spectrum
