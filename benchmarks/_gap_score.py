"""What a diagnosis was worth: rates with their intervals, the failures one by one, a picture.

A case *names* where its verdict is "named" or "ambiguous" and an effect stands first; any other verdict abstains.
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
from _hidden_cases import class_of
from _hidden_effects import MAIN
from _outside_effects import OUTSIDE

NAMING, HONEST = ("named", "ambiguous"), ("unexplained", "ambiguous")
CLEAR = 2.0  # times the just visible level from which on a single effect should be found
_LAST = ("", "joint6")  # both mean the payload at the last link


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
    def good(self) -> bool:
        """Whether it said what is to be said of such a case."""
        match self.kind:
            case "none":
                return not self.names
            case "outside":
                return self.result["verdict"] in HONEST
            case "single":
                return len(found(self, 1)) == 1
            case _:
                return len(found(self)) == len(self.truth["effects"])


def load(*folders) -> list[Judged]:
    """All cases of these folders that have both truth and result."""
    judged = []
    for folder in map(pathlib.Path, folders):
        for path in sorted((folder / "results").glob("*.json")):
            truth = json.loads((folder / "truth" / path.name).read_text())
            judged.append(Judged(truth, json.loads(path.read_text())))
    return judged


def same_joint(a: str | None, b: str | None) -> bool:
    return (a or "") == (b or "") or {a or "", b or ""} == set(_LAST)


def alike(true: str, named: dict) -> bool:
    """Whether an effect that was named is the true one or of its class."""
    called = {re.match(r"[a-z_]*", text).group() for text in named.get("equivalent") or ()}
    return named["name"] in class_of(true) or true in called


def found(case: Judged, first: int | None = None) -> list[str]:
    """The hidden effects that were named, by class, on their joints (among the `first` few)."""
    left, hits = case.named[:first], []
    for effect in case.truth["effects"]:
        hit = next((n for n in left if alike(effect["name"], n) and same_joint(effect["joint"], n.get("joint"))), None)
        if hit is not None:
            left.remove(hit)
            hits.append(effect["name"])
    return hits


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
    clear = [case for case in singles if case.level >= CLEAR]
    alarms = [case for case in none if case.names]
    return {
        "cases": len(judged),
        "single": _top(singles),
        "single_clear": _top(clear),
        "double": {
            "both": rate(len(found(case)) == 2 for case in doubles),
            "one_or_both": rate(len(found(case)) >= 1 for case in doubles),
            "effects": rate(x < len(found(case)) for case in doubles for x in range(2)),
        },
        "false_alarm": rate(case.names for case in none),
        "false_alarm_ripple": sum("ripple" in case.named[0]["name"] for case in alarms),
        "outside_honest": rate(case.good for case in outside),
        "outside_named": rate(case.result["verdict"] == "named" for case in outside),
        "abstained": rate(not case.names for case in singles + doubles),
        "abstained_clear": rate(not case.names for case in clear),
        "superfluous": _mean([max(len(case.named) - len(found(case)), 0) for case in singles + doubles if case.names]),
        "equivalents": _mean([len(case.named[0].get("equivalent") or ()) for case in judged if case.names]),
        "failed": sum(case.result["verdict"] == "failed" for case in judged),
        "shrink": _shrinks(singles + doubles),
        "parameter_error": _parameters(singles),
        "wall_s": _spread([case.result.get("wall_s") for case in judged]),
    }


def _top(cases: list[Judged]) -> dict:
    """How often the first effect named is the hidden one."""
    first = [(case.truth["effects"][0], case.named[0] if case.named else None) for case in cases]
    name = [n is not None and n["name"] == t["name"] for t, n in first]
    kind = [n is not None and alike(t["name"], n) for t, n in first]
    joint = [n is not None and same_joint(t["joint"], n.get("joint")) for t, n in first]
    ranked = [(case.truth["effects"][0], (case.result.get("ranking") or [{}])[0]) for case in cases]
    return {
        "effect": rate(name),
        "class": rate(kind),
        "effect_and_joint": rate(a and b for a, b in zip(name, joint, strict=True)),
        "class_and_joint": rate(a and b for a, b in zip(kind, joint, strict=True)),
        "ranked_first": rate(
            r.get("name") in class_of(t["name"]) and same_joint(t["joint"], r.get("joint")) for t, r in ranked
        ),
    }


def _shrinks(cases: list[Judged]) -> dict:
    """Of the cases in which something was named; of every case, where silence closes nothing; and for comparison."""
    reported = lambda case: (case.result.get("gap") or {}).get("shrink")
    return {
        "named": _spread([reported(case) for case in cases if case.names]),
        "every": _spread([reported(case) if case.names else 0.0 for case in cases]),
        "oracle": _spread([case.result.get("oracle") for case in cases]),
        "placebo": _spread([case.result.get("placebo") for case in cases]),
    }


def _parameters(cases: list[Judged]) -> dict:
    """Relative error of the main parameter where effect and joint are right; of several amplitudes of their rms."""
    errors, covered = [], []
    for case in cases:
        true = case.truth["effects"][0]
        named = case.named[0] if case.named else {}
        if named.get("name") != true["name"] or not same_joint(true["joint"], named.get("joint")):
            continue
        main = MAIN[true["name"]]
        given = (named.get("parameters") or {}).get(main)
        if given is None or given.get("value") is None:
            continue
        value, expected = np.ravel(given["value"]).astype(float), np.ravel(true["parameters"][main]).astype(float)
        size = lambda x: float(x[0]) if x.size == 1 else float(np.linalg.norm(x))
        errors.append(abs(size(value) - size(expected)) / abs(size(expected)))
        std = given.get("std")
        if value.size == expected.size == 1 and std is not None and np.size(std) == 1:
            covered.append(abs(value[0] - expected[0]) <= 1.96 * float(np.ravel(std)[0]))
    return _spread(errors) | {"covered": rate(covered)}


def _spread(values) -> dict:
    values = [float(x) for x in values if x is not None and math.isfinite(x)]
    if not values:
        return {"n": 0, "median": None, "low": None, "high": None}
    low, median, high = np.percentile(values, [10, 50, 90])
    return {"n": len(values), "median": float(median), "low": float(low), "high": float(high)}


def _mean(values) -> float | None:
    return float(np.mean(values)) if values else None


def score(judged: list[Judged]) -> dict:
    """Everything at once: all cases, by simulator, by part, the confusion matrix and the failures."""
    group = lambda key: {
        value: summary([case for case in judged if case.truth[key] == value])
        for value in sorted({case.truth[key] for case in judged})
    }
    return {
        "all": summary(judged),
        "simulator": group("simulator"),
        "part": group("part"),
        "confusion": confusion(judged),
        "failures": failures(judged),
        "cases": [_row(case) | _measured(case) for case in judged],
    }


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
        "simulator": case.truth["simulator"],
        "kind": case.kind,
        "truth": ", ".join(f"{e['name']} {e['joint']} {e['level']:.1f}x".replace("  ", " ") for e in hidden),
        "verdict": case.result["verdict"],
        "named": ", ".join(f"{n['name']} {n.get('joint') or ''}".strip() for n in case.named),
    }


def _measured(case: Judged) -> dict:
    gap = case.result.get("gap") or {}
    return {"shrink": gap.get("shrink")} | {key: case.result.get(key) for key in ("oracle", "placebo", "wall_s")}


def report(scores: dict) -> str:
    """The scores as plain text."""
    groups = {"all": scores["all"], **scores["simulator"]}
    if len(scores["part"]) > 1:
        groups |= scores["part"]
    lines = [f"{'':34}" + "".join(f"{name:>22}" for name in groups)]
    lines += [f"{label:34}" + "".join(f"{_cell(get(s)):>22}" for s in groups.values()) for label, get in _LINES]
    lines += ["", "Failures", *_table(scores["failures"])]
    return "\n".join(lines)


_LINES = [
    ("cases", lambda s: s["cases"]),
    ("one effect: effect", lambda s: s["single"]["effect"]),
    ("  class", lambda s: s["single"]["class"]),
    ("  effect and joint", lambda s: s["single"]["effect_and_joint"]),
    ("  class and joint", lambda s: s["single"]["class_and_joint"]),
    ("  ranked first, class and joint", lambda s: s["single"]["ranked_first"]),
    ("one effect, 2x or more: effect", lambda s: s["single_clear"]["effect"]),
    ("  class", lambda s: s["single_clear"]["class"]),
    ("  effect and joint", lambda s: s["single_clear"]["effect_and_joint"]),
    ("  class and joint", lambda s: s["single_clear"]["class_and_joint"]),
    ("  ranked first, class and joint", lambda s: s["single_clear"]["ranked_first"]),
    ("two effects: both", lambda s: s["double"]["both"]),
    ("  at least one", lambda s: s["double"]["one_or_both"]),
    ("  of all effects", lambda s: s["double"]["effects"]),
    ("nothing hidden: false alarms", lambda s: s["false_alarm"]),
    ("  of which name a ripple", lambda s: s["false_alarm_ripple"]),
    ("outside: unexplained or ambiguous", lambda s: s["outside_honest"]),
    ("  named", lambda s: s["outside_named"]),
    ("abstained, effects hidden", lambda s: s["abstained"]),
    ("  one of 2x or more", lambda s: s["abstained_clear"]),
    ("superfluous effects a case", lambda s: s["superfluous"]),
    ("equivalents of the effect named", lambda s: s["equivalents"]),
    ("shrink where named, median (10 %)", lambda s: s["shrink"]["named"]),
    ("  of every case, silence as 0", lambda s: s["shrink"]["every"]),
    ("  true effect refitted", lambda s: s["shrink"]["oracle"]),
    ("  another effect refitted", lambda s: s["shrink"]["placebo"]),
    ("parameter error, median (90 %)", lambda s: _from_above(s["parameter_error"])),
    ("  within 95 % interval", lambda s: s["parameter_error"]["covered"]),
    ("wall time, s, median (90 %)", lambda s: _from_above(s["wall_s"])),
    ("diagnoses that failed", lambda s: s["failed"]),
]


def _from_above(spread: dict) -> dict:
    return spread | {"low": spread["high"]}


def _cell(value) -> str:
    match value:
        case None:
            return "-"
        case {"k": k, "n": n, "low": low, "high": high}:
            return f"{k}/{n} ({100 * low:.0f}-{100 * high:.0f} %)" if n else "-"
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
