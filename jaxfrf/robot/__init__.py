"""Robots with elastic joints: dynamics, operating point, linearisation, frequency response.

From a robot to its FRF at some arm angles:

    robot = jaxfrf.robot.r3x()
    point = jaxfrf.robot.operating_point(robot, arm_angles)
    G = jaxfrf.robot.frf(jaxfrf.robot.linearise(robot, point), frequency)
"""

from .chain import (
    Chain as Chain,
    Frames as Frames,
    bias_forces as bias_forces,
    forward_kinematics as forward_kinematics,
    gravity_forces as gravity_forces,
    inverse_dynamics as inverse_dynamics,
    mass_and_bias as mass_and_bias,
    mass_and_bias_columns as mass_and_bias_columns,
    mass_matrix as mass_matrix,
    potential_energy as potential_energy,
)
from .controller import Controller as Controller
from .drive import (
    AbstractFrictionLaw as AbstractFrictionLaw,
    AbstractSpring as AbstractSpring,
    Drives as Drives,
    Friction as Friction,
    Spring as Spring,
    ViscousFrictionLaw as ViscousFrictionLaw,
    effective_friction as effective_friction,
)
from .equations import (
    arm_inertia as arm_inertia,
    arm_inertia_and_bias as arm_inertia_and_bias,
    arm_inertia_and_bias_columns as arm_inertia_and_bias_columns,
    chain_angles as chain_angles,
    deflections as deflections,
    drive_forces as drive_forces,
    energy as energy,
    forward_dynamics as forward_dynamics,
    friction_effects as friction_effects,
    generalised_forces as generalised_forces,
    inertia as inertia,
    motor_directions as motor_directions,
    motor_inertia as motor_inertia,
    motor_values as motor_values,
    spring_directions as spring_directions,
)
from .jacobian import (
    ParametricResponse as ParametricResponse,
    frf_and_jacobian as frf_and_jacobian,
    parameter_names as parameter_names,
)
from .linearise import (
    LinearRobot as LinearRobot,
    OperatingPoint as OperatingPoint,
    describing_friction as describing_friction,
    gravity_stiffness as gravity_stiffness,
    linearise as linearise,
    local_stiffness as local_stiffness,
    operating_point as operating_point,
)
from .parameters import (
    PARAMETER_UNITS as PARAMETER_UNITS,
    parameter_unit as parameter_unit,
    parameters as parameters,
    with_parameters as with_parameters,
)
from .r3x import r3x as r3x, r3x_ripple as r3x_ripple
from .response import (
    ZeroOrderHold as ZeroOrderHold,
    frf as frf,
    hold_remainder as hold_remainder,
)
from .robot import Robot as Robot
from .schema import (
    robot_from_table as robot_from_table,
    table_from_robot as table_from_robot,
)
from .state_space import (
    StateSpace as StateSpace,
    discretise as discretise,
    state_space as state_space,
    state_space_frf as state_space_frf,
    to_control as to_control,
)
from .tolerances import (
    DEFAULTS as DEFAULTS,
    Tolerance as Tolerance,
    Tolerances as Tolerances,
    tolerances_from as tolerances_from,
)
