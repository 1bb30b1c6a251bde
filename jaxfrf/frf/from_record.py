"""Which spectra of a record a method needs."""

from .._arguments import as_band
from .._errors import input_error
from ..experiment import Experiment, seen_period, select_periods
from ..screening import screened
from ..spectra import Spectra, at_rest, dft, record_spectra, segment_spectra, select_band
from .aperiodic import asks_for_transients, takes_transients
from .method import AbstractMethod
from .welch import Welch


def spectra_of(
    data: Experiment, method: AbstractMethod, *, periods=None, band=None, robust: bool = False, silent: bool = False
) -> Spectra:
    """The spectra that `method` needs: of steady periods; of the whole record if it is not periodic and the method can
    have a transient term, or if it begins and ends at rest; of segments for `jaxfrf.Welch`. `periods` (from, to) and
    `band` (low, high, Hz) choose a part, `None` at an end: open. `robust`: weigh periods, `silent`: take lines without
    power, too (`jaxfrf.dft`). A record that shows a period, but states none, is taken whole only if the method was
    given a transient term.

    A record that was made in memory is screened first (`jaxfrf.screen`); one that was read from files has been.

    **Raises:** `jaxfrf.InputError` if the record is not periodic and the method needs that, or if it is useless.
    """
    if not data.sources:
        data = screened(data)
    if periods is not None:
        data = select_periods(data, periods[0] or 0, periods[1])
    if robust and (isinstance(method, Welch) or not data.period):
        found = "weights of periods, of which Welch's method takes none" if data.period else "no period to weigh"
        raise input_error("robust", found, "a periodic record, and a method that takes its periods", "Leave it out.")
    if isinstance(method, Welch):
        if periods is None and data.period and data.transient_periods:
            data = select_periods(data, 0)
        spectra = segment_spectra(data, method.segment, overlap=method.overlap, window=method.window)
    elif not data.period and _taken_whole(data, method):
        return record_spectra(data, band)
    else:
        spectra = dft(data, robust=robust, silent=silent)
    return spectra if band is None else select_band(spectra, *as_band(band))


def _taken_whole(data: Experiment, method: AbstractMethod) -> bool:
    if at_rest(data):
        return True
    if not takes_transients(method):
        return False
    return asks_for_transients(method) or seen_period(data.r, data.u, data.y) is None
