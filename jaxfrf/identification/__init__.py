"""From FRFs or records to the parameters of a robot in one go, as `jaxfrf identify` does it."""

from .identify import identify_springs as identify_springs
from .model import robot_model as robot_model, why_direct as why_direct
from .result import HeldOut as HeldOut, Identification as Identification, model_response as model_response
