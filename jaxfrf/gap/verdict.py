"""The verdict of a diagnosis, whatever was compared."""

from .settings import EXPLAINED

VERDICTS = ("sufficient", "named", "ambiguous", "unexplained", "inconclusive")
"""What `Diagnosis.verdict` may be."""


def verdict_of(*, stands: bool, rivals: bool, explained: float, systematic: bool, met: bool) -> str:
    """One of `VERDICTS`.

    **Arguments:** `stands`: whether an effect was found that shows where nothing was fitted. `rivals`: whether others
    explain it as well. `explained`: of what is systematic, that the effects take away there. `systematic`: whether more
    is left, of the robot without effects, or anywhere of the one with them, than numbers can account for. `met`:
    whether what is left is below the tolerance.
    """
    if systematic and not (stands and explained >= EXPLAINED):
        return "unexplained"
    if stands:
        return "ambiguous" if rivals else "named"
    return "sufficient" if met else "inconclusive"
