"""Estimators of frequency response functions."""

from .average import ArithmeticMean as ArithmeticMean, LogMean as LogMean
from .classical import H1 as H1, H2 as H2, Hv as Hv
from .common import CommonDenominatorLRM as CommonDenominatorLRM
from .estimate import describe_method as describe_method, estimate as estimate
from .joint import JointInputOutput as JointInputOutput
from .local import LPM as LPM, LRM as LRM, MisoLRM as MisoLRM
from .method import AbstractMethod as AbstractMethod
from .response import FRF as FRF
