"""All checks, and what becomes of what they find."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence

from .._arguments import expect
from .._errors import InputError
from .._threads import one_blas_thread
from ..experiment import Experiment
from .belongs import copied, foreign, halves, marked_twice, marks, twice
from .clock import clock
from .finding import Finding, Severity, shifted
from .follows import other_unit
from .gain import gain_drift
from .glitch import glitch
from .levels import clipped, coarse, dead, held, saturated
from .period import contradicted, quiet_lines
from .record import OfChannels, Record
from .samples import disturbed, lost, spikes
from .steadiness import drift, noise, odd_period
from .timing import jitter, noncausal
from .wrapped import wrapped

Check = Callable[[Record], Iterator[Finding]] | OfChannels

# A check is one function and one line here. What an earlier one explains is not told once more by a later one.
CHECKS: tuple[Check, ...] = (
    contradicted,
    dead,
    wrapped,
    held,
    clock,
    lost,
    clipped,
    saturated,
    coarse,
    glitch,
    odd_period,
    disturbed,
    spikes,
    drift,
    gain_drift,
    jitter,
    noise,
    quiet_lines,
    other_unit,
    noncausal,
)
ACROSS: tuple[Check, ...] = (copied, twice, foreign)
"""Checks that compare experiments, which may come from several files."""

_OF_ALL = (contradicted, quiet_lines)  # look at the record as a whole: its first part speaks for it

_ANY_CHANNEL = {"foreign", "noncausal"}  # of which another channel may be the cause

_UNLIKE = {"odd period", "unsteady", "disturbed", "gain", "jitter", "noise"}  # periods that differ

# Kinds that a fault of the first kind brings along in the same channel.
_EXPLAINS = {
    "clock": {*_UNLIKE, "lost", "spikes", "noncausal", "foreign"},
    "lost": {*_UNLIKE, "spikes", "noncausal", "foreign"},
    "held": {"spikes", "odd period", "unsteady", "disturbed", "gain", "jitter", "glitch", "clipped", "foreign"},
    "wrapped": {
        "spikes",
        "odd period",
        "unsteady",
        "disturbed",
        "gain",
        "jitter",
        "glitch",
        "lost",
        "foreign",
        "noncausal",
    },
    "period length": _UNLIKE,
    "odd period": {"spikes", "disturbed", "gain", "jitter"},
    "unsteady": {"spikes", "disturbed", "gain", "jitter"},
    "disturbed": {"spikes", "gain", "jitter"},
    "slow update": {"coarse", "jitter"},
    "coarse": {"jitter", "foreign"},
    "clipped": {"saturated", "noncausal", "jitter", "foreign"},
    "saturated": {"noncausal", "jitter", "foreign"},
    "copied": {"twice", "foreign"},
    "dead": {"foreign", "noise", "noncausal"},
}


def examine(data: Experiment, checks: tuple[Check, ...] = CHECKS + ACROSS) -> tuple[Finding, ...]:
    """Everything that the checks find, each in its place.

    Two steady periods are enough for most of it; with one, or none, only the values and habits of the single channels
    and the experiments beside each other are looked at. Nonlinear distortion repeats with the period and is no fault.
    What no record shows: a sign, a gain, a delay of some samples or an exchange of channels that is the same in all
    experiments.

    **Arguments:** `data`: the record, (pos, exp, time, channel). `checks`: which to make, in this order; all by
    default.

    **Returns:** the findings (`jaxfrf.Finding`); none where nothing was found.

    **Raises:** `jaxfrf.InputError` if `data` is no experiment.

    **Source:** this project's own; the checks say how they look. That of clocks: a delay d of a period turns line w by
    -w d, a closed form.
    """
    expect("data", data, Experiment)
    return _examined(Record(data), checks)


def _examined(record: Record, checks: Sequence[Check]) -> tuple[Finding, ...]:
    of_channels = [check for check in checks if isinstance(check, OfChannels)]
    at_once: dict[OfChannels, list[Finding]] = {}
    found: list[Finding] = []
    for check in checks:
        if isinstance(check, OfChannels):
            at_once = at_once or _by_channel(record, of_channels)
            found += at_once[check]
        else:
            found += check(record)
        if any(f.severity is Severity.REFUSED and f.kind == "period" for f in found):
            break  # what comes after would be about the wrong period
    return tuple(f for f in found if not any(_explained(f, by) for by in found))


def _by_channel(record: Record, checks: Sequence[OfChannels]) -> dict[OfChannels, list[Finding]]:
    found: dict[OfChannels, list[Finding]] = {check: [] for check in checks}
    for channel in record.channels():
        for check in checks:
            if channel.signal in check.signals:
                found[check] += check.check(channel)
    return found


def _explained(finding: Finding, by: Finding) -> bool:
    if finding.kind not in _EXPLAINS.get(by.kind, ()):
        return False
    same = finding.pos == by.pos and (finding.exp is None or by.exp in (None, finding.exp))
    channel = by.signal in ("", finding.signal) and by.channel in (None, finding.channel)
    return same and (channel or finding.kind in _ANY_CHANNEL)


@dataclasses.dataclass(frozen=True)
class ScreenedPart:
    """What was found in a part of a record: what `screened` would say of the whole comes of all of them.

    **Fields:** `found`: by file. `across`: between the files' experiments. `marks`: of every experiment, (pos, exp).
    """

    found: tuple[tuple[Finding, ...], ...]
    across: tuple[Finding, ...]
    marks: list[list[str]]


def screen_part(files: Sequence[tuple[Experiment, int]], whole: Experiment, first: int) -> ScreenedPart:
    """Screen some positions of a data set.

    **Arguments:** `files`: what each of the files holds of them, and the number of its first one there. `whole`: these
    joined, from position `first` of the data set on.
    """
    found, joined = [], Record(whole)
    for data, start in files:
        checks = CHECKS if start == 0 else tuple(x for x in CHECKS if x not in _OF_ALL)
        record = joined if data is whole else Record(data)
        found.append(tuple(shifted(f, start) for f in _examined(record, checks)))
    across = tuple(shifted(f, first) for f in _examined(joined, (copied, halves, foreign)))
    return ScreenedPart(tuple(found), across, marks(whole))


def refused(findings: Iterable[Finding]) -> None:
    """**Raises:** `jaxfrf.InputError` for findings that make a record useless."""
    useless = [f for f in findings if f.severity is Severity.REFUSED]
    if useless:
        raise InputError(" ".join(sentences(useless)))


def across_all(parts: Sequence[ScreenedPart]) -> tuple[str, ...]:
    """What is told of the experiments beside each other, of all parts in their order."""
    marked = [row for part in parts for row in part.marks]
    return sentences([*marked_twice(marked), *(f for part in parts for f in part.across)])


@one_blas_thread
def screen(data: Experiment) -> tuple[str, ...]:
    """What looks wrong in a record: one sentence a kind, with the worst place; `jaxfrf.examine` gives every finding.

    Looks at periods and lines that the signals contradict; at clipped, limited, coarsely quantised, held, wrapped and
    dead channels; at clocks that differ; at samples lost or doubled, odd or disturbed periods, drifting means and
    gains, jitter and low signal-to-noise ratios between periods; at outputs that lead their inputs; at experiments that
    do not belong to the others or are given twice.

    A fault that is the same in all periods and experiments is not seen, see `jaxfrf.examine`.

    **Arguments:** `data`: the record, (pos, exp, time, channel).

    **Returns:** sentences; none where nothing was found.

    **Raises:** `jaxfrf.InputError` if `data` is no experiment.

    **Source:** as of `jaxfrf.examine`: this project's own.
    """
    return sentences(examine(data))


def sentences(findings) -> tuple[str, ...]:
    kinds: dict[str, list[Finding]] = {}
    for finding in findings:
        kinds.setdefault(finding.kind, []).append(finding)
    told = []
    for same in kinds.values():
        worst = max(same, key=lambda finding: (finding.severity is Severity.WARNED, finding.size))
        more = f" This is the worst of {len(same)} such places." if len(same) > 1 else ""
        told.append(worst.says + more)
    return tuple(told)


@one_blas_thread
def screened(data: Experiment, *, checks: tuple[Check, ...] = CHECKS + ACROSS, anyway: bool = False) -> Experiment:
    """The record with what was found among its `warnings`.

    **Arguments:** `anyway`: what would be refused is a warning, too.

    **Raises:** `jaxfrf.InputError` for a finding that makes the record useless, unless `anyway`.
    """
    expect("data", data, Experiment)
    findings = examine(data, checks)
    if not anyway:
        refused(findings)
    warnings = tuple(dict.fromkeys((*data.warnings, *sentences(findings))))
    return dataclasses.replace(data, warnings=warnings)
