"""Estimators of frequency response functions."""

from .aperiodic import adapted as adapted
from .average import ArithmeticMean as ArithmeticMean, LogMean as LogMean, RobustMean as RobustMean
from .classical import H1 as H1, H2 as H2, Hv as Hv
from .coherence import coherence as coherence, multiple_coherence as multiple_coherence
from .common import CommonDenominatorLRM as CommonDenominatorLRM
from .covariance import KroneckerSum as KroneckerSum, OuterSum as OuterSum
from .distortion import (
    Distortion as Distortion,
    Levels as Levels,
    best_linear_approximation as best_linear_approximation,
    distortion as distortion,
    distortion_of as distortion_of,
    levels as levels,
    with_distortion as with_distortion,
)
from .estimate import describe_method as describe_method, estimate as estimate
from .features import Feature as Feature, features as features
from .joint import JointInputOutput as JointInputOutput
from .local import LPM as LPM, LRM as LRM, MisoLRM as MisoLRM
from .method import AbstractMethod as AbstractMethod, Estimate as Estimate, Signals as Signals
from .modal import ModalModel as ModalModel, Mode as Mode, Stabilisation as Stabilisation, modal as modal
from .response import FRF as FRF, concatenate_positions as concatenate_positions
from .select import Auto as Auto
from .welch import Welch as Welch
