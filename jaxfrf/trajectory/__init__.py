"""A robot along the motion of an experiment: its residual, and what every number and effect would add to its torque.

Both verbs that compare a whole robot with records stand on it: calibration, and the diagnosis of what is missing.
"""

from .evidence import Evidence as Evidence, Gram as Gram, Weighed as Weighed, weigh as weigh
from .measured import Measured as Measured, fewer as fewer, measured as measured
from .needed_torque import needed_torque as needed_torque
from .rigid_motion import MeasuredMotion as MeasuredMotion
from .signature import signature as signature
