"""What a diagnosis was worth: rates with their intervals, the failures one by one, a picture.

A case *names* where its verdict is "named" or "ambiguous" and an effect stands first; any other verdict abstains.
"Clear" are single effects of twice the just visible level or more, and the error of a *number* that the robot states
only where the whole of it, the hidden part and the one that every number has, is more than `BELIEVED` of its default
tolerances: up to there a robot whose numbers are fitted explains the record, and to say so is right.
Intervals are Clopper and Pearson's, 95 %. Effects that the data cannot tell apart count as one class
(`_hidden_cases.CLASSES`), and so do those that the diagnosis itself calls equivalent to the one it names; how many
these are is told, for a diagnosis that calls everything equivalent is worth nothing.
"""

import collections
import dataclasses
import json
import math
import pathlib
import re

import numpy as np
import scipy.stats
from _gap_estimates import errors
from _gap_kept import kept
from _hidden_effects import MAIN
from _hidden_plan import class_of
from _outside_effects import OUTSIDE

NAMING, HONEST = ("named", "ambiguous"), ("unexplained", "ambiguous")
CLEAR = 2.0  # times the just visible level from which on a single effect should be found
BELIEVED = 2.0  # default tolerances of a number that may be believed
_OFF = "off by more than is known of them"  # what a diagnosis says of numbers, which are not where nothing is hidden
GROWS = 1.1  # times the torque that an axis is missed by on the held-out positions, where an effect is named


@dataclasses.dataclass(frozen=True)
class Judged:
    """A case with its truth and the diagnosis beside it."""

    truth: dict
    result: dict

    @property
    def kind(self) -> str:
        return self.truth["kind"]

    @property
    def names(self) -> bool:
        return self.result["verdict"] in NAMING and bool(self.result.get("effects"))

    @property
    def named(self) -> list[dict]:
        """The effects that it names, the strongest first."""
        return self.result["effects"] if self.names else []

    @property
    def level(self) -> float:
        """Of the weakest effect hidden."""
        return min((effect["level"] for effect in self.truth["effects"]), default=math.nan)

    @property
    def believed(self) -> bool:
        """Whether all that is hidden are errors of numbers that may be believed."""
        off = [effect.get("tolerances") for effect in self.truth["effects"]]
        return bool(off) and all(x is not None and x <= BELIEVED for x in off)

    @property
    def silent(self) -> bool:
        """Whether it says that nothing is missing, or that it cannot tell."""
        return self.result["verdict"] in ("sufficient", "inconclusive")

    @property
    def clear(self) -> bool:
        return self.kind == "single" and self.level >= CLEAR and not self.believed

    @property
    def grown(self) -> float | None:
        """By how much the torque that an axis is missed by on the held-out positions changes, the worst axis; `None`
        where that is not told."""
        gap = self.result.get("gap") or {}
        before, after = (gap.get(f"torque_{when}") or {} for when in ("before", "after"))
        return max((after[axis] / before[axis] for axis in before if before[axis]), default=None)

    def same_joint(self, a: str | None, b: str | None) -> bool:
        """Whether both are one joint; none and the last one both mean the payload at the last link."""
        return (a or "") == (b or "") or {a or "", b or ""} == {"", self.truth["last"]}

    @property
    def good(self) -> bool:
        """Whether it said what is to be said of such a case."""
        match self.kind:
            case "none":
                return self.silent
            case "outside":
                return self.result["verdict"] in HONEST
            case "single":
                return len(found(self, 1)) == 1 or (self.believed and self.silent)
            case _:
                return len(found(self)) == len(self.truth["effects"])


def load(*folders) -> list[Judged]:
    """All cases of these folders that have both truth and result, or of such files as `--keep` writes."""
    judged = []
    for folder in map(pathlib.Path, folders):
        judged += [Judged(case["truth"], case["result"]) for case in kept(folder).values()] if folder.is_file() else []
        for path in sorted((folder / "results").glob("*.json")):
            truth = json.loads((folder / "truth" / path.name).read_text())
            judged.append(Judged(truth, json.loads(path.read_text())))
    return judged


def alike(true: str, named: dict) -> bool:
    """Whether an effect that was named is the true one or of its class."""
    called = {re.match(r"[a-z_]*", text).group() for text in named.get("equivalent") or ()}
    return named["name"] in class_of(true) or true in called


def found(case: Judged, first: int | None = None) -> list[str]:
    """The hidden effects that were named, by class, on their joints (among the `first` few)."""
    left, hits = case.named[:first], []
    for effect in case.truth["effects"]:
        same = lambda n, true=effect: alike(true["name"], n) and case.same_joint(true["joint"], n.get("joint"))
        hit = next((n for n in left if same(n)), None)
        if hit is not None:
            left.remove(hit)
            hits.append(effect["name"])
    return hits


def told(case: Judged) -> bool:
    """Whether the hidden effect of a single case is named on its joint, or, being a number of the robot that is wrong,
    is among those that are said to be off."""
    true = case.truth["effects"][0]
    of_numbers = case.result.get("says", "").partition(_OFF)[2]
    return len(found(case, 1)) == 1 or f" {true['joint']}.{true['name']} by " in of_numbers


def rate(hits) -> dict:
    """k of n, with the interval of Clopper and Pearson."""
    hits = [bool(x) for x in hits]
    k, n = sum(hits), len(hits)
    low = 0.0 if k == 0 else float(scipy.stats.beta.ppf(0.025, k, n - k + 1))
    high = 1.0 if k == n else float(scipy.stats.beta.ppf(0.975, k + 1, n - k))
    return {"k": k, "n": n, "rate": k / n if n else math.nan, "low": low, "high": high}


def summary(judged: list[Judged]) -> dict:
    """All figures of some cases."""
    of = lambda kind: [case for case in judged if case.kind == kind]
    singles, doubles, none, outside = of("single"), of("double"), of("none"), of("outside")
    clear, named = [case for case in singles if case.clear], [case for case in judged if case.names]
    alarms = [case for case in none if case.names]
    return {
        "cases": len(judged),
        "single": _top(singles),
        "single_clear": _top(clear),
        "single_clear_told": rate(map(told, clear)),
        "believed": rate(case.names for case in singles if case.believed),
        "double": {
            "both": rate(len(found(case)) == 2 for case in doubles),
            "one_or_both": rate(len(found(case)) >= 1 for case in doubles),
            "effects": rate(x < len(found(case)) for case in doubles for x in range(2)),
        },
        "false_alarm": rate(case.names for case in none),
        "false_alarm_ripple": sum("ripple" in case.named[0]["name"] for case in alarms),
        "false_alarm_number": sum(case.named[0].get("kind") == "a number is wrong" for case in alarms),
        "false_numbers": rate(_OFF in case.result.get("says", "") for case in none),
        "false_unexplained": rate(case.result["verdict"] == "unexplained" for case in none),
        "outside_honest": rate(case.good for case in outside),
        "outside_named": rate(case.result["verdict"] == "named" for case in outside),
        "abstained": rate(not case.names for case in singles + doubles),
        "abstained_clear": rate(not case.names for case in clear),
        "superfluous": _mean([max(len(case.named) - len(found(case)), 0) for case in singles + doubles if case.names]),
        "equivalents": _mean([len(case.named[0].get("equivalent") or ()) for case in judged if case.names]),
        "failed": sum(case.result["verdict"] == "failed" for case in judged),
        "shrink": _shrinks(singles + doubles),
        "grows": rate(case.grown > GROWS for case in named if case.grown is not None),
        "parameter_error": _parameters(singles + doubles),
        "again": rate(case.result["again"] == "sufficient" for case in named if "again" in case.result),
        "wall_s": _spread([case.result.get("wall_s") for case in judged]),
        "peak_mb": _spread([case.result.get("peak_mb") for case in judged]),
    }


def _top(cases: list[Judged]) -> dict:
    """How often the first effect named is the hidden one."""
    first = [(case, case.truth["effects"][0], case.named[0] if case.named else None) for case in cases]
    name = [n is not None and n["name"] == t["name"] for _, t, n in first]
    kind = [n is not None and alike(t["name"], n) for _, t, n in first]
    joint = [n is not None and case.same_joint(t["joint"], n.get("joint")) for case, t, n in first]
    ranked = [(case, case.truth["effects"][0], (case.result.get("ranking") or [{}])[0]) for case in cases]
    return {
        "effect": rate(name),
        "class": rate(kind),
        "effect_and_joint": rate(a and b for a, b in zip(name, joint, strict=True)),
        "class_and_joint": rate(a and b for a, b in zip(kind, joint, strict=True)),
        "ranked_first": rate(
            r.get("name") in class_of(t["name"]) and case.same_joint(t["joint"], r.get("joint"))
            for case, t, r in ranked
        ),
    }


def _shrinks(cases: list[Judged]) -> dict:
    """Of the cases in which something was named; of every case, where silence closes nothing; and for comparison."""
    shrunk = lambda case: (case.result.get("gap") or {}).get("shrink")
    there = [case for case in cases if case.names and shrunk(case) is not None and case.result.get("oracle")]
    return {
        "named": _spread([shrunk(case) for case in cases if case.names]),
        "every": _spread([shrunk(case) if case.names else 0.0 for case in cases]),
        "oracle": _spread([case.result.get("oracle") for case in cases]),
        "placebo": _spread([case.result.get("placebo") for case in cases]),
        "of_oracle": _spread([shrunk(case) / case.result["oracle"] for case in there]),
    }


def _parameters(cases: list[Judged]) -> dict:
    """Relative errors of main parameters where effect and joint are right, and how many of their intervals hold."""
    told = [
        (error, held)
        for case in cases
        for true in case.truth["effects"]
        for named in case.named
        if named["name"] == true["name"] and case.same_joint(true["joint"], named.get("joint"))
        for error, held in errors(true, named)
    ]
    return _spread([error for error, _ in told]) | {"covered": rate(held for _, held in told if held is not None)}


def _spread(values) -> dict:
    values = [float(x) for x in values if x is not None and math.isfinite(x)]
    if not values:
        return {"n": 0, "median": None, "low": None, "high": None}
    low, median, high = np.percentile(values, [10, 50, 90])
    return {"n": len(values), "median": float(median), "low": float(low), "high": float(high)}


def _mean(values) -> float | None:
    return float(np.mean(values)) if values else None


def score(judged: list[Judged]) -> dict:
    """Everything at once: all cases, by robot, log, simulator and part, the confusion matrix and the failures."""
    group = lambda key: {
        value: summary([case for case in judged if case.truth[key] == value])
        for value in sorted({case.truth[key] for case in judged})
    }
    return {
        "all": summary(judged),
        **{key: group(key) for key in _GROUPS},
        "confusion": confusion(judged),
        "failures": failures(judged),
        "cases": [_row(case) | _measured(case) for case in judged],
    }


_GROUPS = ("robot", "log", "simulator", "part")
_MEAN = """none: nothing hidden. clear: 2x or more, and beyond what a number's tolerance believes. Brackets: 95 %
interval of a rate, %; behind a median its 10 % quantile, of errors, times and memory the 90 % quantile."""


def confusion(judged: list[Judged]) -> dict[str, dict[str, int]]:
    """How often each truth (an effect alone, one outside, none) ended in which name or verdict."""
    table: dict[str, collections.Counter] = {}
    for case in judged:
        if case.kind == "double":
            continue
        truth = case.truth["effects"][0]["name"] if case.truth["effects"] else "none"
        end = case.named[0]["name"] if case.named else case.result["verdict"]
        table.setdefault(truth, collections.Counter())[end] += 1
    order = {name: k for k, name in enumerate((*MAIN, "none", *OUTSIDE))}
    return {truth: dict(table[truth]) for truth in sorted(table, key=order.__getitem__)}


def failures(judged: list[Judged]) -> list[dict]:
    """Every case of which the wrong thing was said."""
    return [_row(case) for case in judged if not case.good]


def _row(case: Judged) -> dict:
    hidden = case.truth["effects"]
    return {
        "part": case.truth["part"],
        "number": case.truth["number"],
        **{key: case.truth[key] for key in _GROUPS[:3]},
        "kind": case.kind,
        "truth": ", ".join(f"{e['name']} {e['joint']} {e['level']:.1f}x".replace("  ", " ") for e in hidden),
        "verdict": case.result["verdict"],
        "named": ", ".join(f"{n['name']} {n.get('joint') or ''}".strip() for n in case.named),
    }


def differences(judged: list[Judged], others: list[Judged]) -> list[str]:
    """How many cases both have, and those of them that end otherwise: another verdict, other names, or another answer
    to the robot that was written. What ends alike may differ in its numbers."""
    place = lambda case: (case.truth["part"], case.truth["number"])
    end = lambda case: (case.result["verdict"], _row(case)["named"], case.result.get("again"))
    before = {place(case): case for case in others}
    both = [(case, before[place(case)]) for case in judged if place(case) in before]
    other = [pair for pair in both if end(pair[0]) != end(pair[1])]
    told = lambda case: " ".join(x for x in (*end(case)[:2], f"({case.result.get('again', 'not asked again')})") if x)
    lines = [f"{now.truth['number']:03}: {told(now)}; before: {told(then)}" for now, then in other]
    return [f"{len(other)} of {len(both)} cases end otherwise", *lines]


def _measured(case: Judged) -> dict:
    gap = case.result.get("gap") or {}
    keys = ("oracle", "placebo", "again", "wall_s", "peak_mb")
    return {"shrink": gap.get("shrink"), "grown": case.grown} | {key: case.result.get(key) for key in keys}


def report(scores: dict) -> str:
    """The scores as plain text."""
    groups = {"all": scores["all"]}
    for key in _GROUPS:
        groups |= scores[key] if len(scores[key]) > 1 else {}
    rows = [(label, [_cell(get(s)) for s in groups.values()]) for label, get in _LINES]
    rows = [("", list(groups)), *rows]
    width = [2 + max(len(cells[i]) for _, cells in rows) for i in range(len(groups))]
    lines = [f"{label:42}" + "".join(f"{c:>{w}}" for c, w in zip(cells, width, strict=True)) for label, cells in rows]
    lines += ["", _MEAN, "", "Failures", *_table(scores["failures"])]
    return "\n".join(lines)


_LINES = [
    ("cases", lambda s: s["cases"]),
    ("one effect: effect", lambda s: s["single"]["effect"]),
    ("  class", lambda s: s["single"]["class"]),
    ("  effect and joint", lambda s: s["single"]["effect_and_joint"]),
    ("  class and joint", lambda s: s["single"]["class_and_joint"]),
    ("  ranked first, class and joint", lambda s: s["single"]["ranked_first"]),
    ("one effect, clear: effect", lambda s: s["single_clear"]["effect"]),
    ("  class", lambda s: s["single_clear"]["class"]),
    ("  effect and joint", lambda s: s["single_clear"]["effect_and_joint"]),
    ("  class and joint", lambda s: s["single_clear"]["class_and_joint"]),
    ("  ranked first, class and joint", lambda s: s["single_clear"]["ranked_first"]),
    ("  named, or told as a number that is off", lambda s: s["single_clear_told"]),
    ("two effects: both", lambda s: s["double"]["both"]),
    ("  at least one", lambda s: s["double"]["one_or_both"]),
    ("  of all effects", lambda s: s["double"]["effects"]),
    ("believed numbers: named all the same", lambda s: s["believed"]),
    ("none: false alarms", lambda s: s["false_alarm"]),
    ("  of which name a ripple", lambda s: s["false_alarm_ripple"]),
    ("  of which call a number wrong", lambda s: s["false_alarm_number"]),
    ("  numbers off by more than is known", lambda s: s["false_numbers"]),
    ("  said to be unexplained", lambda s: s["false_unexplained"]),
    ("outside: unexplained or ambiguous", lambda s: s["outside_honest"]),
    ("  named", lambda s: s["outside_named"]),
    ("abstained, effects hidden", lambda s: s["abstained"]),
    ("  a clear one", lambda s: s["abstained_clear"]),
    ("superfluous effects a case", lambda s: s["superfluous"]),
    ("equivalents of the effect named", lambda s: s["equivalents"]),
    ("shrink where named, median (10 %)", lambda s: s["shrink"]["named"]),
    ("  of every case, silence as 0", lambda s: s["shrink"]["every"]),
    ("  true effect refitted", lambda s: s["shrink"]["oracle"]),
    ("  where named, over that", lambda s: s["shrink"]["of_oracle"]),
    ("  another effect refitted", lambda s: s["shrink"]["placebo"]),
    ("named: an axis is missed by more", lambda s: s["grows"]),
    ("named: sufficient when written", lambda s: s["again"]),
    ("parameter error, median (90 %)", lambda s: _from_above(s["parameter_error"])),
    ("  within 95 % interval", lambda s: s["parameter_error"]["covered"]),
    ("wall time, s, median (90 %)", lambda s: _from_above(s["wall_s"])),
    ("peak memory, MB, median (90 %)", lambda s: _from_above(s["peak_mb"])),
    ("diagnoses that failed", lambda s: s["failed"]),
]


def _from_above(spread: dict) -> dict:
    return spread | {"low": spread["high"]}


def _cell(value) -> str:
    match value:
        case None:
            return "-"
        case {"k": k, "n": n, "low": low, "high": high}:
            return f"{k}/{n} ({100 * low:.0f}-{100 * high:.0f})" if n else "-"
        case {"median": None}:
            return "-"
        case {"median": median, "low": low}:
            return f"{median:.3g} ({low:.3g})"
        case float():
            return f"{value:.2f}"
        case _:
            return str(value)


def _table(rows: list[dict]) -> list[str]:
    if not rows:
        return ["none"]
    texts = [{key: str(value) or "-" for key, value in row.items()} for row in rows]
    width = {key: max(len(key), *(len(row[key]) for row in texts)) for key in texts[0]}
    line = lambda row: "  ".join(f"{row[key]:{width[key]}}" for key in width).rstrip()
    return [line({key: key for key in width}), *map(line, texts)]
