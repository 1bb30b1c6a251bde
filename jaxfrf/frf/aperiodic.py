"""Methods made ready for records without a period, and for those with next to no lines."""

import dataclasses

from ..spectra import Spectra
from .average import AbstractAverage
from .joint import JointInputOutput
from .local import AbstractLocal
from .method import AbstractMethod
from .select import Auto


def adapted(method: AbstractMethod, spectra: Spectra) -> AbstractMethod:
    """The method as it is used on these spectra: on those of whole periods as it stands.

    On those of a record without a period local methods get a transient term of their own order where they have none and
    something leaks, count the distance between lines in Hz (a transient is smooth in frequency), and, where no width is
    given, choose their window at every line (`jaxfrf.Auto`): as wide as for a multisine is far too narrow for lines
    that lie as close as 1/duration and carry as little as a part of a sweep or of noise. Others stay as they are, and
    say what they need.

    **Arguments:** `method`: any. `spectra`: of `jaxfrf.dft`, `jaxfrf.record_spectra` or `jaxfrf.segment_spectra`.

    **Returns:** a method for `jaxfrf.estimate`: the same one, or one with a transient term and a window of its own
    choice.

    **Source:** transients that are smooth in frequency: Pintelon & Schoukens, System Identification: A Frequency Domain
    Approach, 2nd ed. 2012, chapter 7; when one is added is this project's own.
    """
    if spectra.segments:
        return method
    if not spectra.periodic:
        return _without_period(method, spectra.leaks)
    return method.without_windows(spectra) if isinstance(method, Auto) else method


def _without_period(method: AbstractMethod, leaks: bool) -> AbstractMethod:
    if isinstance(method, Auto):
        return dataclasses.replace(method, method=_whole(method.method, leaks))
    if isinstance(method, AbstractLocal):
        method = _whole(method, leaks)
        return method if method.width is not None else Auto(method, use_reference=False)
    if isinstance(method, JointInputOutput) and isinstance(method.method, AbstractLocal):
        inner = _whole(method.method, leaks)
        return JointInputOutput(inner) if inner.width is not None else Auto(inner)
    if isinstance(method, AbstractAverage) and takes_transients(method):
        return dataclasses.replace(method, **{"method": _without_period(method.inner, leaks)})
    return method


def _whole(method: AbstractLocal, leaks: bool) -> AbstractLocal:
    transient = method.order if method.transient is None and leaks else method.transient
    return dataclasses.replace(method, transient=transient, variable="frequency")


def takes_transients(method: AbstractMethod) -> bool:
    """Whether the method can have a transient term."""
    return bool(_locals(method))


def asks_for_transients(method: AbstractMethod) -> bool:
    """Whether the method was given one."""
    return any(x.transient is not None for x in _locals(method))


def uses_windows(method: AbstractMethod) -> bool:
    """Whether the method has a local window that it does not choose by itself."""
    if isinstance(method, Auto):
        return False
    return isinstance(method, AbstractLocal) or any(uses_windows(x) for x in _inner(method))


def has_fractions(method: AbstractMethod) -> bool:
    """Whether the local model has a denominator."""
    return any(x.has_denominator or x.shared_parameters(1) > 0 for x in _locals(method))


def uses_reference(method: AbstractMethod) -> bool:
    """Whether the response from the reference is estimated."""
    return isinstance(method, JointInputOutput) or any(uses_reference(x) for x in _inner(method))


def _inner(method: AbstractMethod) -> list[AbstractMethod]:
    parts = [getattr(method, f.name) for f in dataclasses.fields(method)]
    return [x for x in parts if isinstance(x, AbstractMethod)]


def _locals(method: AbstractMethod) -> list[AbstractLocal]:
    if isinstance(method, AbstractLocal):
        return [method]
    return [x for part in _inner(method) for x in _locals(part)]
