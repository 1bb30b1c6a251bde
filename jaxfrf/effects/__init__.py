"""Effects that a robot model may lack: friction, delay, ripple, play and others, each one module.

    truth = robot.with_effects(jaxfrf.effects.CoulombFriction("joint3", level=0.2))

`library()` lists them by name; the base classes say where an effect acts and how it appears in the linearised robot.
"""

from .actuator import (
    CurrentLoopLag as CurrentLoopLag,
    ElasticLoad as ElasticLoad,
    TorqueConstant as TorqueConstant,
    TorqueDelay as TorqueDelay,
    TorqueRipple as TorqueRipple,
    TorqueSaturation as TorqueSaturation,
)
from .catalogue import (
    effect_from_table as effect_from_table,
    effect_to_table as effect_to_table,
    library as library,
)
from .effect import (
    AbstractEffect as AbstractEffect,
    Candidate as Candidate,
    OwnNumber as OwnNumber,
    Reach as Reach,
    Swing as Swing,
)
from .friction import (
    ArmViscousFriction as ArmViscousFriction,
    CoulombFriction as CoulombFriction,
    FrictionAsymmetry as FrictionAsymmetry,
    LoadDependentFriction as LoadDependentFriction,
    StribeckFriction as StribeckFriction,
    ViscousFriction as ViscousFriction,
)
from .insertion import (
    AbstractActuator as AbstractActuator,
    AbstractArmTorque as AbstractArmTorque,
    AbstractFriction as AbstractFriction,
    AbstractGear as AbstractGear,
    AbstractGearCoupling as AbstractGearCoupling,
    AbstractGearError as AbstractGearError,
    AbstractGearTorque as AbstractGearTorque,
    AbstractLinkSensor as AbstractLinkSensor,
    AbstractMotorTorque as AbstractMotorTorque,
    AbstractSensor as AbstractSensor,
    AbstractStatelessActuator as AbstractStatelessActuator,
    AbstractStructure as AbstractStructure,
)
from .sensor import (
    EncoderQuantisation as EncoderQuantisation,
    ResolverRipple as ResolverRipple,
    SensorDelay as SensorDelay,
)
from .springs import (
    Backlash as Backlash,
    StiffnessHardening as StiffnessHardening,
)
from .structure import (
    Counterbalance as Counterbalance,
    DressPack as DressPack,
    ExtraFlexibility as ExtraFlexibility,
    MotorInertia as MotorInertia,
    Payload as Payload,
)
from .transmission import (
    GearHysteresis as GearHysteresis,
    StructuralDamping as StructuralDamping,
    TransmissionError as TransmissionError,
    WristCoupling as WristCoupling,
)
