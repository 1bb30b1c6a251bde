"""A diagnosis in words: what the page and the command line say of it."""

import math
from collections.abc import Sequence

from .._text import NORMAL_95

_FAR = 0.3  # of the largest misfit: less is not what a diagnosis is about
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def headline(diagnosis) -> str:
    """The verdict in one sentence."""
    if diagnosis.verdict == "sufficient":
        return "Nothing is missing: the model explains the data."
    if diagnosis.verdict == "inconclusive":
        return "No missing effect shows, but these data could not rule one out."
    if diagnosis.verdict == "unexplained":
        where = joined(axes_of(diagnosis))
        return f"Something is missing{f' at {where}' if where else ''} that no known effect explains."
    told = lambda number: [what(x, diagnosis.verdict) for x in diagnosis.effects if x.is_number == number]
    missing, wrong = joined(told(False)), joined(told(True))
    return " ".join(
        f"{begins}: {names}." for begins, names in (("Missing", missing), ("A number is wrong", wrong)) if names
    )


def what(named, verdict: str) -> str:
    """An effect and its joint; with those that the data cannot tell from it where the verdict hangs on them."""
    names = (named.name, *named.equivalent) if verdict == "ambiguous" else (named.name,)
    text = " or ".join(plain(n) for n in names)
    return f"{text} of {named.joint}" if named.joint else text


def axes_of(diagnosis) -> list[str]:
    """Names of the axes that a diagnosis is about: those of its effects (of one without a joint: those whose torque it
    brought down), or of the cells where the model is far off."""
    names = diagnosis.axis_names
    if not diagnosis.effects:
        largest = max((cell.z for cell in diagnosis.where if math.isfinite(cell.z)), default=0.0)
        said = [axis_of_channel(cell.channel, names) for cell in diagnosis.where if not cell.z < _FAR * largest]
        return list(dict.fromkeys(x for x in said if x is not None))
    own = [x.joint for x in diagnosis.effects if x.joint in names]
    if len(own) < len(diagnosis.effects):
        own += _improved(diagnosis.gap, names)
    return list(dict.fromkeys(own))


def _improved(gap, names: Sequence[str]) -> list[str]:
    """Axes whose torque residual fell by a third or more, the largest fall first."""
    fallen = [(b - a, n) for n, b, a in zip(names, gap.torque_before, gap.torque_after, strict=True) if a < 0.67 * b]
    return [n for _, n in sorted(fallen, key=lambda x: -x[0])]


def axis_of_channel(channel: str, names: Sequence[str]) -> str | None:
    """The axis in the name of a channel: `torque of joint3`, `G33` (its column), or none."""
    whole = [n for n in names if n in channel]
    if whole:
        return max(whole, key=len)
    element = channel.removeprefix("G").replace(",", "")
    if channel.startswith("G") and element.isdigit() and 0 < int(element[-1]) <= len(names):
        return names[int(element[-1]) - 1]
    return None


def plain(name: str) -> str:
    """`coulomb_friction` as people write it."""
    words = name.replace("_", " ")
    return words.replace("coulomb", "Coulomb").replace("stribeck", "Stribeck")


def joined(texts: Sequence[str]) -> str:
    """a, b and c."""
    texts = list(texts)
    return texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} and {texts[-1]}" if texts else ""


def estimate(x) -> str:
    """A number with its 95 % interval and unit, rounded to what is known: `0.209 ± 0.012 N m`."""
    value, half, unit = float(x.value), NORMAL_95 * float(x.std), x.unit
    if unit == "s" and 0 < abs(value) < 0.1:
        value, half, unit = 1e3 * value, 1e3 * half, "ms"
    unit = "" if unit in ("", "1") else f" {unit}"
    scale = math.floor(math.log10(abs(value))) if value else 0
    if not -3 <= scale < 7:
        value, half = value / 10.0**scale, half / 10.0**scale
    known = math.isfinite(half) and half > 0
    places = max(0, (1 if known else 3) - math.floor(math.log10(half if known else abs(value) or 1.0)))
    text = f"{value:.{places}f}" + (f" ± {half:.{places}f}" if known else "")
    if not -3 <= scale < 7:
        power = f"10{str(scale).translate(_RAISED)}"
        text = f"({text}) × {power}" if known else f"{text} × {power}"
    return text + unit


def p_text(p: float) -> str:
    """A p-value: `p = 0.03`, `p < 1e-6`."""
    if not math.isfinite(p):
        return ""
    return f"p = {p:.2g}".replace("e-0", "e-") if p >= 1e-6 else "p < 1e-6"


def percent(part: float, signed: bool = False) -> str:
    """A part in per cent, `-` where it is not known."""
    if not math.isfinite(part):
        return "-"
    size = abs(100 * part)
    places = 0 if size >= 9.95 or size == 0 else 1
    return f"{100 * part:{'+' if signed else ''}.{places}f} %"


def gap_name(gap) -> str:
    """What the gap is, with its unit."""
    return f"{gap.quantity} (rms)" + (f", {gap.unit}" if gap.unit not in ("", "1") else "")


def closed(gap) -> str:
    """What became of the gap, in a few words."""
    if not math.isfinite(gap.shrink):
        return "no gap to close"
    if gap.after == gap.before:
        return "nothing was added to the model"
    return f"{percent(gap.shrink)} of the reducible gap is gone"


def ripple_written(diagnosis) -> str:
    """Ripple of the motors that is written with the robot though nobody misses it, in a sentence; "" for none."""
    if not diagnosis.ripple:
        return ""
    told = "; ".join(f"{joint}: {', '.join(map(str, orders))}" for joint, orders in diagnosis.ripple.items())
    return f"The robot is written with the ripple that its motors show (orders of {told})."
