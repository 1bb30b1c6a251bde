"""Which spectra of a record a method needs."""

import dataclasses

from ..experiment import Experiment, select_periods
from ..screening import screened
from ..spectra import Spectra, dft, record_spectra, select_band
from .method import AbstractMethod


def spectra_of(data: Experiment, method: AbstractMethod, *, periods=None, band=None) -> Spectra:
    """The spectra that `method` needs: of steady periods, or of the whole record if it is not periodic and the method
    has a transient term. `periods` (from, to) and `band` (low, high, Hz) choose a part; `None` at an end: open.

    A record that was made in memory is screened first (`jaxfrf.screen`); one that was read from files has been.

    **Raises:** `jaxfrf.InputError` if the record is not periodic and the method needs that, or if it is useless.
    """
    if not data.sources:
        data = screened(data)
    if periods is not None:
        data = select_periods(data, periods[0] or 0, periods[1])
    if not data.period and _takes_transients(method):
        low, high = band or (None, None)
        whole = None if band is None else (low or 0.0, high or data.fs / 2)
        return record_spectra(data, whole)
    spectra = dft(data)
    return spectra if band is None else select_band(spectra, band[0] or 0.0, band[1] or data.fs / 2)


def _takes_transients(method: AbstractMethod) -> bool:
    inner = [getattr(method, f.name) for f in dataclasses.fields(method)]
    return getattr(method, "transient", None) is not None or any(
        _takes_transients(x) for x in inner if isinstance(x, AbstractMethod)
    )
