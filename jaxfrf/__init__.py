"""From an experiment to a model: frequency response functions with honest uncertainty.

Names are imported on first use, so that `import jaxfrf` costs nothing and opens no device.
"""

import importlib
from typing import TYPE_CHECKING

__version__ = "0.1.0"

# Every public name and the module that holds it; submodules that are namespaces of their own stand in _NAMESPACES.
_PUBLIC = {
    "InputError": "_errors",
    "Status": "_status",
    "Multisine": "excitation",
    "SlowSine": "excitation",
    "Reference": "excitation",
    "reference": "excitation",
    "RandomPhases": "excitation",
    "SchroederPhases": "excitation",
    "CrestOptimisedPhases": "excitation",
    "full_lines": "excitation",
    "odd_lines": "excitation",
    "random_odd_lines": "excitation",
    "log_odd_lines": "excitation",
    "detection_lines": "excitation",
    "band_lines": "excitation",
    "Experiment": "experiment",
    "Source": "experiment",
    "concatenate": "experiment",
    "select_periods": "experiment",
    "segments": "experiment",
    "screen": "screening.screen",
    "examine": "screening",
    "Finding": "screening",
    "example": "examples",
    "example_response": "examples",
    "Spectra": "spectra",
    "dft": "spectra",
    "unexcited_spectra": "spectra",
    "record_spectra": "spectra",
    "segment_spectra": "spectra",
    "excited_lines": "spectra",
    "select_band": "spectra",
    "select_positions": "spectra",
    "differentiate": "spectra",
    "with_output_quantity": "spectra",
    "FRF": "frf",
    "estimate": "frf.estimate",
    "AbstractMethod": "frf",
    "Auto": "frf",
    "H1": "frf",
    "H2": "frf",
    "Hv": "frf",
    "ArithmeticMean": "frf",
    "LogMean": "frf",
    "RobustMean": "frf",
    "JointInputOutput": "frf",
    "LPM": "frf",
    "LRM": "frf",
    "MisoLRM": "frf",
    "CommonDenominatorLRM": "frf",
    "Welch": "frf",
    "coherence": "frf.coherence",
    "multiple_coherence": "frf",
    "levels": "frf",
    "Levels": "frf",
    "distortion": "frf.distortion",
    "Distortion": "frf",
    "best_linear_approximation": "frf",
    "with_distortion": "frf",
    "features": "frf.features",
    "modal": "frf.modal",
    "ModalModel": "frf",
    "Mode": "frf",
    "Feature": "frf",
    "describe_method": "frf",
    "concatenate_positions": "frf",
    "replay": "simulation",
    "simulate": "simulation",
    "random_positions": "simulation",
    "Parameter": "graybox",
    "AbstractModel": "graybox",
    "GrayBox": "graybox",
    "RobotModel": "graybox",
    "Weights": "graybox",
    "LevenbergMarquardt": "graybox",
    "BFGS": "graybox",
    "Fit": "graybox",
    "fit": "graybox.fit",
    "IndirectFit": "graybox",
    "fit_in_motion": "graybox",
    "fit_indirectly": "graybox",
    "Quality": "graybox",
    "quality": "graybox.quality",
    "derived": "graybox.derived",
    "initial_guess": "graybox",
    "guessed": "graybox",
    "plan_positions": "graybox",
    "calibrate": "calibration.calibrate",
    "Calibration": "calibration",
    "identify_springs": "identification.identify",
    "Identification": "identification",
    "diagnose": "gap.diagnose",
    "Parts": "parts",
    "position_information": "graybox",
    "d_optimal": "graybox",
    "expected_accuracy": "graybox",
}
_NAMESPACES = (
    "batch",
    "calibration",
    "effects",
    "excitation",
    "frf",
    "gap",
    "graybox",
    "io",
    "machine",
    "plot",
    "report",
    "robot",
    "simulation",
    "study",
    "trajectory",
    "units",
)

__all__ = ["__version__", *_PUBLIC, *_NAMESPACES]

if TYPE_CHECKING:
    from . import (
        batch as batch,
        calibration as calibration,
        effects as effects,
        excitation as excitation,
        frf as frf,
        gap as gap,
        graybox as graybox,
        io as io,
        machine as machine,
        plot as plot,
        report as report,
        robot as robot,
        simulation as simulation,
        study as study,
        trajectory as trajectory,
        units as units,
    )
    from ._errors import (
        InputError as InputError,
    )
    from ._status import (
        Status as Status,
    )
    from .calibration import Calibration as Calibration
    from .calibration.calibrate import calibrate as calibrate
    from .examples import (
        example as example,
        example_response as example_response,
    )
    from .excitation import (
        CrestOptimisedPhases as CrestOptimisedPhases,
        Multisine as Multisine,
        RandomPhases as RandomPhases,
        Reference as Reference,
        SchroederPhases as SchroederPhases,
        SlowSine as SlowSine,
        band_lines as band_lines,
        detection_lines as detection_lines,
        full_lines as full_lines,
        log_odd_lines as log_odd_lines,
        odd_lines as odd_lines,
        random_odd_lines as random_odd_lines,
        reference as reference,
    )
    from .experiment import (
        Experiment as Experiment,
        Source as Source,
        concatenate as concatenate,
        segments as segments,
        select_periods as select_periods,
    )
    from .frf import (
        FRF as FRF,
        H1 as H1,
        H2 as H2,
        LPM as LPM,
        LRM as LRM,
        AbstractMethod as AbstractMethod,
        ArithmeticMean as ArithmeticMean,
        Auto as Auto,
        CommonDenominatorLRM as CommonDenominatorLRM,
        Distortion as Distortion,
        Feature as Feature,
        Hv as Hv,
        JointInputOutput as JointInputOutput,
        Levels as Levels,
        LogMean as LogMean,
        MisoLRM as MisoLRM,
        ModalModel as ModalModel,
        Mode as Mode,
        RobustMean as RobustMean,
        Welch as Welch,
        best_linear_approximation as best_linear_approximation,
        concatenate_positions as concatenate_positions,
        describe_method as describe_method,
        levels as levels,
        multiple_coherence as multiple_coherence,
        with_distortion as with_distortion,
    )
    from .frf.coherence import coherence as coherence
    from .frf.distortion import distortion as distortion
    from .frf.estimate import estimate as estimate
    from .frf.features import features as features
    from .frf.modal import modal as modal
    from .gap.diagnose import diagnose as diagnose
    from .graybox import (
        BFGS as BFGS,
        AbstractModel as AbstractModel,
        Fit as Fit,
        GrayBox as GrayBox,
        IndirectFit as IndirectFit,
        LevenbergMarquardt as LevenbergMarquardt,
        Parameter as Parameter,
        Quality as Quality,
        RobotModel as RobotModel,
        Weights as Weights,
        d_optimal as d_optimal,
        expected_accuracy as expected_accuracy,
        fit_in_motion as fit_in_motion,
        fit_indirectly as fit_indirectly,
        guessed as guessed,
        initial_guess as initial_guess,
        plan_positions as plan_positions,
        position_information as position_information,
    )
    from .graybox.derived import derived as derived
    from .graybox.fit import fit as fit
    from .graybox.quality import quality as quality
    from .identification import (
        Identification as Identification,
    )
    from .identification.identify import identify_springs as identify_springs
    from .parts import Parts as Parts
    from .screening import (
        Finding as Finding,
        examine as examine,
    )
    from .screening.screen import screen as screen
    from .simulation import (
        random_positions as random_positions,
        replay as replay,
        simulate as simulate,
    )
    from .spectra import (
        Spectra as Spectra,
        dft as dft,
        differentiate as differentiate,
        excited_lines as excited_lines,
        record_spectra as record_spectra,
        segment_spectra as segment_spectra,
        select_band as select_band,
        select_positions as select_positions,
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
