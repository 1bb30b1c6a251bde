"""The verb: robot and data to an `Identification`."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax.random as jr
import numpy as np

from .._arguments import as_band, expect
from .._errors import input_error
from .._types import require_x64
from ..calibration.heldout import heldout_numbers
from ..experiment import Experiment
from ..frf import FRF, AbstractMethod, Auto, describe_method, estimate
from ..frf.from_record import spectra_of
from ..graybox import (
    Fit,
    IndirectFit,
    RobotModel,
    Weights,
    fit,
    fit_indirectly,
    initial_guess,
    starting_near,
)
from ..graybox.in_motion import fit_in_motion
from ..graybox.indirect import default_method, measured_frf, tell
from ..graybox.quality import model_quality, quality, response_quality
from ..graybox.slow_motion import response_in_motion
from ..io.fits import plain_data
from ..parts import Parts
from ..robot import Robot
from ..simulation import replay
from ..simulation.checks import check_data
from ..spectra import with_output_quantity
from .model import QUANTITY, robot_model, why_direct
from .result import HeldOut, Identification
from .rounds import kept_rounds

Say = Callable[[str], None]


def identify_springs(
    robot: Robot,
    data: Experiment | FRF,
    *,
    method: AbstractMethod | None = None,
    weights: Weights | None = None,
    starts: int = 20,
    seed: int = 0,
    rounds: int = 12,
    direct: bool = False,
    guess: bool = False,
    fixed: Sequence[str] = (),
    freed: Sequence[str] = (),
    shared: Sequence[Sequence[str]] = (),
    heldout: Sequence[int] = (),
    band: tuple[float | None, float | None] | None = None,
    parts: Parts | None = None,
    say: Say | None = None,
) -> Identification:
    """Fit the stiffnesses and dampings of a robot to records or FRFs.

    Indirectly, by simulating the experiment, wherever that is possible: periodic records with references, and a robot
    with a controller; with the direct fit beside it. `why_direct` of the result says what was missing. Biased where
    each of the two is: see `jaxfrf.fit` and `jaxfrf.fit_indirectly`.

    **Arguments:**

    - `robot`: also says where the parameters start.
    - `data`: records or FRFs, with the arm configurations q.
    - `method`: estimator of the FRF; by default local fractions through the reference, or `jaxfrf.Auto()` without one.
    - `weights`: `jaxfrf.Weights()`. `starts`, `seed`: of the direct fit. `rounds`: of simulation, at most.
    - `direct`: the direct fit alone. `guess`: start from what the antiresonances of the FRF say (`initial_guess`), not
      from the robot's own stiffnesses and dampings.
    - `fixed`, `freed`: names of parameters to hold, or to fit though they are held otherwise; `*` stands for any text.
    - `shared`: groups of names that have one value.
    - `heldout`: numbers of positions, from 0, that are not fitted, and on which the result is judged.
    - `band`: (low, high), Hz; `None` at an end: open.
    - `parts`: keeps finished rounds (`jaxfrf.Parts`), so that those of an interrupted run of the same data and
      settings are not simulated again.
    - `say`: called with a line of progress.

    **Returns:** an `Identification`: fits, residuals and held-out errors, in the units of the parameters.

    **Raises:** `jaxfrf.InputError`, before anything long begins, if robot, data and arguments do not fit together.

    **Source:** as of `jaxfrf.fit_indirectly` and `jaxfrf.fit`.
    """
    expect("robot", robot, Robot)
    expect("data", data, Experiment, FRF)
    require_x64("identify_springs")
    held = heldout_numbers(heldout, data.n_pos)
    check_data(robot, data)
    why = why_direct(robot, data, direct)
    model = robot_model(robot, data, fixed=fixed, freed=freed, shared=shared, simulated=not why)
    weights = _within(Weights() if weights is None else weights, band)
    if starts < 1 or rounds < 1:
        raise input_error("starts and rounds", f"{starts} and {rounds}", "1 or more", "20 and 12 are the defaults.")
    positions = tuple(p for p in range(data.n_pos) if p not in held)
    part, rest = _at(data, positions), _at(data, held) if held else None
    used = (Auto() if isinstance(data, FRF) or data.r is None else default_method()) if method is None else method
    settings: dict[str, Any] = {
        "method": None if isinstance(data, FRF) else describe_method(used),
        **{"starts": starts, "seed": seed, "rounds": None if why else rounds},
        **{"fixed": list(fixed), "freed": list(freed), "shared": [list(names) for names in shared]},
        **{"guess": guess, "heldout": list(held), "band_hz": None if band is None else list(band)},
        "weights": {f.name: getattr(weights, f.name) for f in dataclasses.fields(weights)},
    }
    frf_of = (lambda frf: frf) if isinstance(data, FRF) else (lambda record: _frf_of_record(record, used, band))
    done, keep = ((), None) if parts is None else kept_rounds(parts, model, part, settings)
    if guess:
        model = _guessed(model, frf_of(part), say)
    key = jr.key(seed)
    indirect = None
    if why:
        tell(say, f"direct fit only: {why}")
        measured = frf_of(part)
        found = _direct(model, part, measured, weights, starts, key, say)
    else:
        indirect = fit_indirectly(
            model, part, used, weights=weights, starts=starts, key=key, rounds=rounds, done=done, keep=keep, say=say
        )
        measured, found = dataclasses.replace(indirect.measured, warnings=data.warnings), indirect.direct
    judged = None if rest is None else _judged(model, found, indirect, rest, frf_of(rest), held, used, weights)
    direct_quality = quality(found, measured, weights)
    own = direct_quality if indirect is None else quality(indirect.fit, measured, weights)
    return Identification(
        model, found, indirect, why, measured, positions, own, direct_quality, judged, plain_data(settings)
    )


def _within(weights: Weights, band) -> Weights:
    if band is None:
        return weights
    low, high = as_band(band)
    outside: list[tuple[float, float, float]] = []
    if low > 0:
        outside.append((0.0, float(np.nextafter(low, 0)), 0.0))
    if np.isfinite(high):
        outside.append((float(np.nextafter(high, np.inf)), np.inf, 0.0))
    return dataclasses.replace(weights, bands=(*weights.bands, *outside))


def _at(data: Experiment | FRF, positions: Sequence[int]):
    """The data at some positions; the record itself, not a copy, where these are all."""
    if len(positions) == data.n_pos:
        return data
    index = list(positions)
    names = {
        FRF: ("G", "cov", "dof", "status", "window", "cov_noise", "cov_total", "bias", "q"),
        Experiment: ("u", "y", "r", "q"),
    }
    cut = {n: getattr(data, n)[index] for n in names[type(data)] if getattr(data, n) is not None}
    if isinstance(data, FRF):
        return dataclasses.replace(data, **cut)
    return Experiment(**({f.name: getattr(data, f.name) for f in dataclasses.fields(data)} | cut))


def _frf_of_record(data: Experiment, method: AbstractMethod, band) -> FRF:
    if data.period:
        return dataclasses.replace(measured_frf(data, method, QUANTITY), warnings=data.warnings)
    return estimate(with_output_quantity(spectra_of(data, method, band=band), QUANTITY), method)


def _direct(model: RobotModel, data, measured: FRF, weights, starts: int, key, say) -> Fit:
    if isinstance(data, Experiment) and data.period:
        return fit_in_motion(model, data, measured, weights=weights, starts=starts, key=key, say=say)
    return fit(model, measured, weights=weights, starts=starts, key=key)


def _guessed(model: RobotModel, measured: FRF, say: Say | None) -> RobotModel:
    """The model at a guess that does not know the robot's springs and dampers."""
    found = initial_guess(model, measured)
    tell(say, f"first guess from the antiresonances: {found.error_db:.2f} dB off")
    for note in found.notes:
        tell(say, f"first guess: {note}")
    return starting_near(model, found.values)


def _judged(
    model: RobotModel, found: Fit, indirect: IndirectFit | None, rest, frf: FRF, held, method, weights
) -> HeldOut:
    """Errors at positions that were not fitted: of the linear model, and of the simulated experiment."""
    if isinstance(rest, Experiment) and rest.period:
        direct = response_quality(response_in_motion(model, found.values, frf.frequency, rest), frf, weights)
    else:
        direct = model_quality(found, frf, weights)
    if indirect is None:
        return HeldOut(held, direct, None)
    played = replay(model.at(indirect.fit.values), rest)
    simulated = measured_frf(played, method, QUANTITY)
    return HeldOut(held, direct, response_quality(simulated.G, frf, weights))
