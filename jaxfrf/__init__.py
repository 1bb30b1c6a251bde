"""From an experiment to a model: frequency response functions with honest uncertainty.

Names are imported on first use, so that `import jaxfrf` costs nothing and opens no device.
"""

import importlib
from typing import TYPE_CHECKING

__version__ = "0.1.0"

# Every public name and the module that holds it; submodules that are namespaces of their own stand in _NAMESPACES.
_PUBLIC = {
    "InputError": "_errors",
    "InputWarning": "_errors",
    "Status": "_status",
    "Experiment": "experiment",
    "Source": "experiment",
    "concatenate": "experiment",
    "select_periods": "experiment",
    "Spectra": "spectra",
    "dft": "spectra",
    "unexcited_spectra": "spectra",
    "record_spectra": "spectra",
    "excited_lines": "spectra",
    "differentiate": "spectra",
    "with_output_quantity": "spectra",
    "screen": "screening",
    "FRF": "frf",
    "estimate": "frf",
    "H1": "frf",
    "H2": "frf",
    "Hv": "frf",
    "ArithmeticMean": "frf",
    "LogMean": "frf",
    "JointInputOutput": "frf",
    "LPM": "frf",
    "LRM": "frf",
    "MisoLRM": "frf",
    "CommonDenominatorLRM": "frf",
}
_NAMESPACES = ("excitation", "frf", "io", "plot")

__all__ = ["__version__", *_PUBLIC, *_NAMESPACES]

if TYPE_CHECKING:
    from . import excitation as excitation, frf as frf, io as io, plot as plot
    from ._errors import InputError as InputError, InputWarning as InputWarning
    from ._status import Status as Status
    from .experiment import (
        Experiment as Experiment,
        Source as Source,
        concatenate as concatenate,
        select_periods as select_periods,
    )
    from .frf import FRF as FRF
    from .spectra import (
        Spectra as Spectra,
        dft as dft,
        differentiate as differentiate,
        excited_lines as excited_lines,
        record_spectra as record_spectra,
        unexcited_spectra as unexcited_spectra,
        with_output_quantity as with_output_quantity,
    )


def __getattr__(name: str):
    if name in _NAMESPACES:
        return importlib.import_module(f".{name}", __name__)
    if name in _PUBLIC:
        value = getattr(importlib.import_module(f".{_PUBLIC[name]}", __name__), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'jaxfrf' has no attribute {name!r}")


def __dir__():
    return sorted(__all__)
