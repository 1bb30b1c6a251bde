"""From frequency responses to the physical parameters of a model: models, weights, fits and what is known of them."""

from .cost import Target as Target, Weights as Weights, focus_band as focus_band
from .fit import Fit as Fit, Start as Start, evaluate as evaluate, fit as fit
from .model import (
    AbstractModel as AbstractModel,
    GrayBox as GrayBox,
    RobotModel as RobotModel,
    RobotPoint as RobotPoint,
    fix as fix,
    free as free,
    share as share,
    starting_at as starting_at,
)
from .parameter import Coordinates as Coordinates, Parameter as Parameter
from .positions import (
    Accuracy as Accuracy,
    d_optimal as d_optimal,
    expected_accuracy as expected_accuracy,
    position_information as position_information,
)
from .solver import (
    BFGS as BFGS,
    AbstractSolver as AbstractSolver,
    LevenbergMarquardt as LevenbergMarquardt,
)
from .swing import robot_points as robot_points
from .through import (
    Correction as Correction,
    ThroughFit as ThroughFit,
    fit_through_experiment as fit_through_experiment,
)
from .uncertainty import Uncertainty as Uncertainty
