"""From frequency responses to the physical parameters of a model: models, weights, fits and what is known of them."""

from .corrections import Correction as Correction
from .cost import Cost as Cost, cost_function as cost_function
from .deflections import robot_points as robot_points
from .derived import Derived as Derived, derived as derived
from .fit import Fit as Fit, Start as Start, fit as fit
from .guess import (
    Guess as Guess,
    guessed as guessed,
    initial_guess as initial_guess,
    starting_near as starting_near,
)
from .in_motion import fit_in_motion as fit_in_motion
from .indirect import (
    IndirectFit as IndirectFit,
    fit_indirectly as fit_indirectly,
)
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
    PositionPlan as PositionPlan,
    d_optimal as d_optimal,
    expected_accuracy as expected_accuracy,
    plan_positions as plan_positions,
    position_information as position_information,
)
from .quality import (
    Quality as Quality,
    model_quality as model_quality,
    quality as quality,
    response_quality as response_quality,
)
from .slow_motion import (
    moving_response as moving_response,
    response_in_motion as response_in_motion,
    slow_motion as slow_motion,
)
from .solver import (
    BFGS as BFGS,
    AbstractSolver as AbstractSolver,
    LevenbergMarquardt as LevenbergMarquardt,
)
from .target import Target as Target, Weights as Weights, focus_band as focus_band
from .uncertainty import Uncertainty as Uncertainty
