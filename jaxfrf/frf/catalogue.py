"""Methods by the names that the command line knows."""

import dataclasses
import importlib
import inspect
from collections.abc import Mapping
from typing import Any

from .._errors import input_error
from .average import ArithmeticMean, LogMean, RobustMean
from .classical import H1, H2, Hv
from .common import CommonDenominatorLRM
from .joint import JointInputOutput
from .local import LPM, LRM, MisoLRM
from .method import AbstractMethod


def _in(module: str) -> Any:
    """A module of this room: the line of a method in a file of its own says where it is, and needs no import above."""
    return importlib.import_module(f".{module}", __package__)


METHODS: dict[str, tuple[str, AbstractMethod]] = {
    "auto": ("stacked LRM through the reference, window chosen from the data", _in("select").Auto()),
    "h1": ("least squares over experiments, noise in y", H1()),
    "h2": ("least squares over experiments, noise in u", H2()),
    "hv": ("total least squares over experiments", Hv()),
    "arithmetic": ("mean over blocks of experiments", ArithmeticMean()),
    "log": ("logarithmic mean over blocks of experiments", LogMean()),
    "robust": ("mean over blocks of experiments in which odd ones do not count", RobustMean()),
    "robust-lrm-jio": (
        "local matrix fractions through the reference, mean in which odd experiments do not count",
        RobustMean(JointInputOutput(LRM())),
    ),
    "jio": ("ratio of the responses from the reference, by H1", JointInputOutput(H1())),
    "lpm": ("local polynomials, logarithmic mean over experiments", LogMean(LPM())),
    "lrm-miso": ("local fractions by output, logarithmic mean over experiments", LogMean(MisoLRM())),
    "lrm-mimo": ("local matrix fractions, logarithmic mean over experiments", LogMean(LRM())),
    "lrm-jio": (
        "local matrix fractions through the reference, logarithmic mean",
        LogMean(JointInputOutput(LRM())),
    ),
    "lpm-stacked": ("local polynomials, all experiments in one least squares", LPM()),
    "lrm-stacked": ("local matrix fractions, all experiments in one least squares", LRM()),
    "lrm-jio-stacked": ("the same through the reference", JointInputOutput(LRM())),
    "lrm-jio-common": (
        "one denominator for y and u, through the reference",
        JointInputOutput(CommonDenominatorLRM()),
    ),
    "welch": (
        "cross spectra averaged over segments of a record, as SciPy's csd/welch and MATLAB's tfestimate; also: spa",
        _in("welch").Welch(),
    ),
}
"""Name: what it is, and the method with its default options. The paper's are h1 to lrm-jio."""

ALIASES = {"spa": "welch", "tfestimate": "welch", "csd": "welch"}
"""What other programs call a method."""


def method(name: str, options: Mapping[str, object] | None = None) -> AbstractMethod:
    """A method by its command-line name, with options.

    Options of a nested method are given flat: `method("lrm-jio", {"order": 2, "width": 34})` sets the fields of the LRM
    inside. An average over a single experiment, or over records with other numbers of inputs and outputs, needs
    `elementwise` (see `LogMean`).

    **Raises:** `jaxfrf.InputError` naming an unknown method or option, and the known ones.
    """
    name = ALIASES.get(name, name)
    if name not in METHODS:
        raise input_error("method", repr(name), f"one of {', '.join(METHODS)}", "Choose one of them.")
    chosen, unused = _with_options(METHODS[name][1], dict(options or {}))
    if unused:
        known = sorted(_option_names(METHODS[name][1]))
        raise input_error(
            f"option of {name}",
            ", ".join(unused),
            f"some of {', '.join(known)}" if known else "no options for this method",
            "Correct the name, or choose a method that has it.",
        )
    return chosen


def _with_options(chosen: AbstractMethod, options: dict) -> tuple[AbstractMethod, dict]:
    changes = {}
    for field in dataclasses.fields(chosen):
        value = getattr(chosen, field.name)
        if isinstance(value, AbstractMethod):
            changes[field.name], options = _with_options(value, options)
        elif field.name in options and field.name != "method":
            changes[field.name] = _converted(chosen, field.name, options[field.name])
            options = {k: v for k, v in options.items() if k != field.name}
    return dataclasses.replace(chosen, **changes), options


def _option_names(chosen: AbstractMethod) -> set[str]:
    names = set()
    for field in dataclasses.fields(chosen):
        value = getattr(chosen, field.name)
        names |= _option_names(value) if isinstance(value, AbstractMethod) else {field.name}
    return names - {"method"}


def _converted(chosen: AbstractMethod, name: str, value):
    """A value from text, by what the field holds."""
    if not isinstance(value, str):
        return value
    annotation = inspect.get_annotations(_owner(type(chosen), name))[name]
    annotation = getattr(annotation, "__name__", None) or str(annotation)
    text = value.strip().lower()
    try:
        if "None" in annotation and text == "none":
            return None
        if "bool" in annotation:
            return {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}[text]
        if "tuple" in annotation:
            return tuple(int(x) for x in text.split(";"))
        if "int" in annotation:
            return int(text)
        if "float" in annotation:
            return float(text)
    except (ValueError, KeyError):
        several = " Each option has an --option of its own." if "=" in value else ""
        raise input_error(
            f"option {name}", repr(value), annotation, f"Give e.g. --option {name}={_sample(annotation)}.{several}"
        ) from None
    return value.strip()


def _owner(cls: type, name: str) -> type:
    return next(c for c in cls.__mro__ if name in inspect.get_annotations(c))


def _sample(annotation: str) -> str:
    if "bool" in annotation:
        return "true"
    return "12;24;48" if "tuple" in annotation else "2"
