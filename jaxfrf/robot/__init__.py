"""Robots with elastic joints: dynamics, operating point, linearisation, frequency response.

robot = jaxfrf.robot.r3x()
point = jaxfrf.robot.operating_point(robot, arm_angles)
G = jaxfrf.robot.frf(jaxfrf.robot.linearise(robot, point), frequency)
"""

from .chain import (
    Chain as Chain,
)
from .chain import (
    Frames as Frames,
)
from .chain import (
    bias_forces as bias_forces,
)
from .chain import (
    forward_kinematics as forward_kinematics,
)
from .chain import (
    gravity_forces as gravity_forces,
)
from .chain import (
    inverse_dynamics as inverse_dynamics,
)
from .chain import (
    mass_and_bias as mass_and_bias,
)
from .chain import (
    mass_matrix as mass_matrix,
)
from .chain import (
    potential_energy as potential_energy,
)
from .drive import (
    AbstractFriction as AbstractFriction,
)
from .drive import (
    AbstractSpring as AbstractSpring,
)
from .drive import (
    Drives as Drives,
)
from .drive import (
    Friction as Friction,
)
from .drive import (
    Spring as Spring,
)
from .drive import (
    ViscousFriction as ViscousFriction,
)
from .drive import (
    effective_friction as effective_friction,
)
from .linearise import (
    LinearRobot as LinearRobot,
)
from .linearise import (
    OperatingPoint as OperatingPoint,
)
from .linearise import (
    gravity_stiffness as gravity_stiffness,
)
from .linearise import (
    linearise as linearise,
)
from .linearise import (
    local_stiffness as local_stiffness,
)
from .linearise import (
    operating_point as operating_point,
)
from .parameters import (
    PARAMETER_UNITS as PARAMETER_UNITS,
)
from .parameters import (
    parameters as parameters,
)
from .parameters import (
    with_parameters as with_parameters,
)
from .r3x import r3x as r3x
from .response import (
    ParametricResponse as ParametricResponse,
)
from .response import (
    ZeroOrderHold as ZeroOrderHold,
)
from .response import (
    frf as frf,
)
from .response import (
    frf_and_jacobian as frf_and_jacobian,
)
from .response import (
    hold_remainder as hold_remainder,
)
from .response import (
    parameter_names as parameter_names,
)
from .robot import (
    Controller as Controller,
)
from .robot import (
    EffectTable as EffectTable,
)
from .robot import (
    Robot as Robot,
)
from .robot import (
    arm_inertia as arm_inertia,
)
from .robot import (
    arm_inertia_and_bias as arm_inertia_and_bias,
)
from .robot import (
    chain_angles as chain_angles,
)
from .robot import (
    deflections as deflections,
)
from .robot import (
    drive_forces as drive_forces,
)
from .robot import (
    energy as energy,
)
from .robot import (
    forward_dynamics as forward_dynamics,
)
from .robot import (
    generalised_forces as generalised_forces,
)
from .robot import (
    inertia as inertia,
)
from .robot import (
    motor_directions as motor_directions,
)
from .robot import (
    motor_inertia as motor_inertia,
)
from .robot import (
    motor_values as motor_values,
)
from .robot import (
    spring_directions as spring_directions,
)
from .schema import robot_from_table as robot_from_table
from .schema import table_from_robot as table_from_robot
from .state_space import (
    StateSpace as StateSpace,
)
from .state_space import (
    discretise as discretise,
)
from .state_space import (
    state_space as state_space,
)
from .state_space import (
    state_space_frf as state_space_frf,
)
from .state_space import (
    to_control as to_control,
)
