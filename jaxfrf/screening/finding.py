"""What a check says."""

import dataclasses
import enum
import re

import numpy as np


class Severity(enum.Enum):
    """What becomes of a record with such a finding."""

    REFUSED = "refused"  # no FRF of it would mean anything
    WARNED = "warned"  # the FRF is biased or its interval too small until the finding is dealt with
    TOLD = "told"  # the FRF stands, with what is said in mind


@dataclasses.dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or suspicious.

    **Fields:**

    - `kind`: a word or two by which findings are grouped. `severity`: refused, warned or told.
    - `size`: how much, in the unit of its kind: the worst finding of a kind is the one that is printed.
    - `says`: one or two sentences: where, what was found, what it does to the FRF, what to do.
    - `sure`: standard deviations from chance; infinite where chance is ruled out.
    - `effect`: how far the FRF may be off for it, relative; `None` where that cannot be told.
    - `signal`, `channel`, `pos`, `exp`, `samples` (first, last + 1): where, as far as it is in one place.
    """

    kind: str
    severity: Severity
    size: float
    says: str
    sure: float = np.inf
    effect: float | None = None
    signal: str = ""
    channel: int | None = None
    pos: int | None = None
    exp: int | None = None
    samples: tuple[int, int] | None = None


def shifted(finding: Finding, by: int) -> Finding:
    """The same finding in a record of which this one is a part, from position `by` on."""
    if not by or finding.pos is None:
        return finding
    says = re.sub(r"\bposition (\d+)", lambda found: f"position {int(found[1]) + by}", finding.says)
    return dataclasses.replace(finding, pos=finding.pos + by, says=says)
