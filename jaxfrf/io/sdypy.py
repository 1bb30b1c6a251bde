"""What the libraries of SDyPy pass around: FRFs of pyFRF and EMA, time series by SEP 5."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .._arguments import said
from .._errors import input_error
from .._text import number
from ..experiment import Experiment
from ..frf import FRF
from ..units import QUANTITIES, differentiated, known_unit, quantity_of
from .responses import frf_from_arrays

_FORMS = {"receptance": "position", "mobility": "velocity", "accelerance": "acceleration"}
_MEASURED = {
    "d": "receptance",
    "v": "mobility",
    "a": "accelerance",
}  # pyFRF's response types, and SEP 5's quantities
_REVERSED = 3.0  # how much more energy may stand before time zero than after it


def from_sdypy(data: Mapping[str, Any] | Any, *, conjugated: bool = False) -> FRF:
    """An FRF, without a covariance, from what pyFRF and sdypy.EMA call one.

    **Arguments:**

    - `data`: a dictionary with the names of SDyPy: `frf` of shape (freq,), (response, freq) or
      (response, excitation, freq); `freq` in Hz (or `freq_rad` in rad/s); `frf_form` (or `frf_type`), one of
      `receptance`, `mobility`, `accelerance`. Or a `pyFRF.FRF` object, which is asked for the form it was
      measured in.
    - `conjugated`: whether the numbers are the complex conjugate of the FRF, as from pyFRF up to version 1.1.
      That was the *measured* quantity's conjugate: a receptance that such a version made from velocities has
      the wrong sign besides, so pass the form that was measured.

    A conjugated FRF runs backwards in time. Where the frequencies are regular, that is looked for, and said
    in `warnings`; nothing is turned round unasked. Motions are taken as those in m, forces in N.

    **Raises:** `jaxfrf.InputError` if a name is missing, or shapes do not fit.
    """
    if not isinstance(data, Mapping):
        data = _of_pyfrf(data)
    G = np.asarray(_named(data, "frf"))
    frequency = np.asarray(data["freq_rad"]) / (2 * np.pi) if "freq_rad" in data else np.asarray(_named(data, "freq"))
    G = G[None] if G.ndim == 1 else G
    G = G[:, None] if G.ndim == 2 else G
    if G.ndim != 3 or frequency.ndim != 1 or G.shape[-1] != len(frequency):
        raise input_error(
            "frf",
            f"shape {np.shape(data['frf'])} with {frequency.size} frequencies",
            "(response, freq) or (response, excitation, freq)",
            "Transpose it.",
        )
    G = G.conj() if conjugated else G
    quantity = _form(data)
    return frf_from_arrays(
        np.moveaxis(G, -1, 0),
        frequency,
        y_quantity=quantity,
        u_unit="N",
        y_unit=differentiated("m", QUANTITIES[quantity]),
        warnings=_backwards(G, frequency),
    )


def from_sep005(
    channels: Mapping | Sequence[Mapping],
    *,
    u: Sequence[str] | None = None,
    y: Sequence[str] | None = None,
    r: Sequence[str] = (),
    period: int = 0,
    transient_periods: int = 0,
    y_quantity: str | None = None,
) -> Experiment:
    """One experiment from SDyPy's unified time series (SEP 5): dictionaries with `data`, `name`, `unit_str`,
    `fs`.

    **Arguments:**

    - `channels`: one dictionary per channel; `time` in place of `fs` is accepted where it is regular.
    - `u`, `y`, `r`: names of the channels that are input, output and reference. Without `u` and `y`: the
      channels whose `quantity` is `f`, and those whose `quantity` is `d`, `v` or `a`.
    - `period`, `transient_periods`: as in `jaxfrf.Experiment`.
    - `y_quantity`: what the outputs are; by default what their `quantity` says.

    Numbers are converted to SI where `unit_str` says from what, as `jaxfrf.io.read` does, and `warnings` say so; a unit
    that is not known is kept as a name. Where `quantity` says nothing, the unit of the outputs does.

    **Raises:** `jaxfrf.InputError` if a channel is missing, lengths or sampling frequencies differ, the units of a
    signal are of several quantities, or `quantity` does not tell inputs from outputs.
    """
    channels = [channels] if isinstance(channels, Mapping) else channels
    if not isinstance(channels, Sequence) or not all(isinstance(c, Mapping) for c in channels):
        raise input_error("channels", said(channels), "dictionaries of SEP 5", "Give data, name, unit_str, fs of each.")
    by_name = {str(_named(c, "name")): c for c in channels}
    u = _of_quantity(by_name, "f") if u is None else u
    y = _of_quantity(by_name, "dva") if y is None else y
    if not u or not y:
        raise input_error(
            "channels",
            f"{len(u)} inputs and {len(y)} outputs among {', '.join(by_name) or 'none'}",
            "at least one of each",
            "Name them (u=[...], y=[...]), or set `quantity` to f, d, v or a.",
        )
    used = [_channel(by_name, name) for name in (*u, *y, *r)]
    rates = {_sampling_frequency(c) for c in used}
    if len(rates) > 1:
        raise input_error("fs", f"{sorted(rates)}", "one sampling frequency", "Resample the channels.")
    signals = {key: _signal(by_name, names, key) for key, names in (("u", u), ("y", y), ("r", r)) if names}
    unit = {key: signal.unit for key, signal in signals.items()}
    return Experiment(
        signals["u"].x,
        signals["y"].x,
        rates.pop(),
        period,
        r=signals["r"].x if r else None,
        transient_periods=transient_periods,
        r_quantity=quantity_of(unit.get("r", "")) or "velocity",
        y_quantity=_quantity(by_name, y, unit["y"]) if y_quantity is None else y_quantity,
        u_unit=unit["u"],
        y_unit=unit["y"],
        warnings=[text for signal in signals.values() for text in signal.remarks],
    )


# --- frequency responses ---


def _of_pyfrf(measurement) -> dict:
    """The dictionary of a pyFRF object; its arguments have changed names, so they are passed by position."""
    if not hasattr(measurement, "get_FRF"):
        raise input_error(
            "data",
            type(measurement).__name__,
            "a dictionary with frf, freq and frf_form, or a pyFRF.FRF object",
            "Pass dict(frf=..., freq=..., frf_form=...).",
        )
    form = _MEASURED.get(measurement.resp_type)
    if measurement.exc_type != "f" or form is None:
        raise input_error(
            "pyFRF object",
            f"response {measurement.resp_type!r} to excitation {measurement.exc_type!r}",
            "a motion (d, v or a) in response to a force (f)",
            "Set exc_type and resp_type.",
        )
    G = measurement.get_FRF("default", form)
    return {"frf": G, "freq": measurement.get_f_axis(), "frf_form": form}


def _form(data: Mapping) -> str:
    form = str(data.get("frf_form", data.get("frf_type")))
    if form not in _FORMS:
        raise input_error("frf_form", form, f"one of {', '.join(_FORMS)}", "Say what the FRF is.")
    return _FORMS[form]


def _backwards(G: np.ndarray, frequency: np.ndarray) -> tuple[str, ...]:
    """A warning if the impulse responses of G (..., freq) stand mostly before time zero.

    The inverse DFT of a band of the FRF is the impulse response seen through a band pass; negative times
    stand in its second half. A window over the band keeps its edges from smearing into both halves alike.
    """
    steps = np.diff(frequency)
    if len(frequency) < 32 or not np.allclose(steps, steps[0], rtol=1e-6):
        return ()
    known = np.where(np.isfinite(G), G, 0)
    impulse = np.abs(np.fft.ifft(known * np.hanning(len(frequency)))) ** 2
    edge, middle = 2, len(frequency) // 2  # the samples at time zero belong to neither half
    after, before = impulse[..., edge:middle].sum(), impulse[..., middle : 1 - edge].sum()
    if before <= _REVERSED * after:
        return ()
    return (
        f"the impulse response holds {number(before / after)} times more energy before time zero than after it: "
        "like the complex conjugate of an FRF (which pyFRF gave up to version 1.1); change `conjugated`",
    )


# --- time series ---


def _named(mapping: Mapping, name: str):
    if name not in mapping:
        raise input_error("dictionary", f"the keys {', '.join(map(str, mapping))}", f"a key {name!r}", "Add it.")
    return mapping[name]


def _of_quantity(by_name: Mapping[str, Mapping], quantities: str) -> list[str]:
    return [name for name, channel in by_name.items() if str(channel.get("quantity", "?")) in tuple(quantities)]


class _Signal(NamedTuple):
    """Numbers (time, channel) in SI units, their unit ("": none, or several), and what is said of the conversion."""

    x: np.ndarray
    unit: str
    remarks: list[str]


def _signal(by_name: Mapping[str, Mapping], names: Sequence[str], key: str) -> _Signal:
    stated = [str(by_name[name].get("unit_str") or "").strip().replace("?", "") for name in names]
    found = [known_unit(text) or (text, 1.0) for text in stated]
    units = sorted({unit for unit, _ in found})
    if len({quantity_of(unit) for unit in units} - {None}) > 1:
        raise input_error(
            f"unit_str of {key}", ", ".join(stated), "one quantity in all channels", "Make an experiment of each."
        )
    unknown = sorted({text for text in stated if text and known_unit(text) is None})
    remarks = [f"{key}: {text!r} is no unit that is known here; its numbers are as they were." for text in unknown]
    x, factors = _stack(by_name, names), [factor for _, factor in found]
    if len(units) > 1:
        written = ", ".join(unit or "none" for unit in units)
        remarks.append(f"{key}: its channels are of several units ({written}), and none is kept.")
    if set(factors) != {1.0}:
        each = ", ".join(number(factor, 6) for factor in factors)
        remarks.append(f"{key}: converted to SI, as unit_str states the units (factors {each}).")
        x = x * np.array(factors)
    return _Signal(x, units[0] if len(units) == 1 else "", remarks)


def _quantity(by_name: Mapping[str, Mapping], names: Sequence[str], unit: str) -> str:
    found = {str(by_name[name].get("quantity", "unknown")) for name in names}
    if found == {"unknown"} and (by_unit := quantity_of(unit)) is not None:
        return by_unit
    if len(found) != 1 or not found <= set(_MEASURED):
        raise input_error(
            "quantity of the outputs",
            ", ".join(sorted(found)),
            "d, v or a, the same in all",
            "Give y_quantity.",
        )
    return _FORMS[_MEASURED[found.pop()]]


def _channel(by_name: Mapping[str, Mapping], name: str) -> Mapping:
    if name not in by_name:
        raise input_error("channels", f"no {name!r} among {', '.join(by_name)}", "a channel of that name", "Check it.")
    return by_name[name]


def _sampling_frequency(channel: Mapping) -> float:
    if channel.get("fs") is not None:
        return float(channel["fs"])
    time = np.asarray(_named(channel, "time"), float)
    steps = np.diff(time)
    if not len(steps) or not np.allclose(steps, steps.mean(), rtol=1e-3):
        raise input_error(f"{channel['name']}: time", "irregular sampling", "a regular one", "Resample it.")
    return 1 / float(steps.mean())


def _stack(by_name: Mapping[str, Mapping], names: Sequence[str]) -> np.ndarray:
    """The named channels as (time, channel)."""
    columns = [np.asarray(_named(by_name[name], "data")) for name in names]
    shapes = {c.shape for c in columns}
    if len(shapes) > 1 or columns[0].ndim != 1:
        raise input_error("data", f"shapes {sorted(shapes)}", "one-dimensional channels of equal length", "Cut them.")
    return np.stack(columns, axis=-1)
