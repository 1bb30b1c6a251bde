"""Pictures: functions that take results and return matplotlib figures and axes."""

from ._style import save as save
from .bode import bode as bode
from .coherence import coherence as coherence
from .excitation import multisine as multisine
from .plan import plan as plan
from .spectrum import spectrum as spectrum
