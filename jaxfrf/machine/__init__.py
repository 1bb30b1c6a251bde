"""Machines of your own, M q'' + D q' + K q = B u, that effects of the library act on: springs that harden, friction,
play. Simulated and fitted through the experiment."""

from .diagnose import MachineDiagnosis as MachineDiagnosis, diagnose_machine as diagnose_machine
from .fit import (
    MachineFit as MachineFit,
    RankedEffect as RankedEffect,
    fit_machine as fit_machine,
    rank_effects as rank_effects,
)
from .forces import CubicSpring as CubicSpring, force as force
from .model import Machine as Machine
from .simulate import simulate_machine as simulate_machine
