"""The tables of a study as text, for the command line and the README."""

from .._text import number
from ..report.gap_words import plain
from .claims import claims
from .settings import PUBLISHED_BIAS, PUBLISHED_PARAMETERS
from .uncertain import MEASURED


def summary_lines(results: dict) -> list[str]:
    """Tables I and II beside the published ones, and how many of the paper's claims hold."""
    settings = results["settings"]
    head = (
        f"study {settings['name']}: {settings['positions']} positions, {6 * settings['blocks']} experiments of "
        f"{results['period_s']:g} s at each, {results['lines']} lines; seeds {_list(settings['seeds'])}; "
        f"{results['minutes']:.1f} min"
    )
    checked = claims(results)
    return [
        head,
        "",
        "Table I, amplitude bias (published in brackets; other units and weights: compare orders and ratios)",
        *table_one(results),
        "",
        "Table II, mean parameter bias, % (median and range over the seeds; published in brackets)",
        *table_two(results),
        "",
        f"{sum(c.confirmed for c in checked)} of {len(checked)} claims of the paper hold on R3X:",
        *(f"  {_word(c.confirmed)}: {c.says} (paper {c.paper}; here {c.found})" for c in checked),
        "",
        *uncertain_lines(results["uncertain"]["summary"]),
        f"An effect hidden in a small robot ({results['hidden']['robot']}):",
        *(f"  {line}" for line in hidden_lines(results["hidden"])),
    ]


def uncertain_lines(summary: list[dict]) -> list[str]:
    """Errors where nothing is known exactly, as given, of springs and dampers alone, and of the whole robot."""
    if not summary:
        return []
    first = summary[0]
    columns = {"given": "as given", "springs": "all else exact", "whole": "whole robot"}
    if not has_springs(first):
        del columns["springs"]
    lines = [
        f"Nothing known exactly: {first['robot']}, {first['positions']} positions, {first['period_s']:g} s, "
        f"{machines(first['machines'])}; mean error, %"
        + (" (all else exact: friction and masses taken as they were given)" if has_springs(first) else ""),
        f"  {'n_e':>3}  {'':40}" + "".join(f"{word:>20}" for word in columns.values()),
    ]
    for entry in summary:
        for kind, errors in entry["errors"].items():
            cells = "".join(f"{'-' if errors[k] is None else spread(errors[k]):>20}" for k in columns)
            lines.append(f"  {entry['experiments']:>3}  {MEASURED[kind]:40}{cells}")
        lines.append(f"       95 % intervals that hold: {held(entry['intervals'])}")
    return [*lines, ""]


def machines(count: int) -> str:
    """How many were drawn."""
    return "one machine" if count == 1 else f"{count} machines"


def has_springs(entry: dict) -> bool:
    """Whether springs and dampers were also fitted by themselves."""
    return entry["intervals"]["springs"]["of"] > 0


def held(intervals: dict) -> str:
    """How many intervals hold the truth."""
    springs, whole = intervals["springs"], intervals["whole"]
    alone = f"all else exact {springs['hold']} of {springs['of']}, " if springs["of"] else ""
    return f"{alone}whole robot {whole['hold']} of {whole['of']} (numbers that the data tell)"


def hidden_lines(hidden: dict) -> list[str]:
    """What was hidden, what the diagnosis says, and the gap before and after."""
    true, gap = hidden["true"], hidden["gap"]
    numbers = ", ".join(f"{name} {number(value)}" for name, value in true["parameters"].items())
    lines = [
        f"hidden: {plain(true['name'])} on {true['joint']}, {numbers}",
        f"verdict: {hidden['verdict']}. {hidden['says']}",
    ]
    for effect in hidden["effects"]:
        for name, x in effect["parameters"].items():
            true_value = true_parameter(hidden, effect, name)
            beside = "" if true_value is None else f"; true {number(true_value, 4)} {x['unit']}"
            lines.append(f"found: {plain(effect['name'])} on {effect['joint']}: {name} {interval(x)}{beside}")
    lines.append(
        f"gap on {gap['on']}: {gap['before']:.1f} before, {gap['after']:.2f} after, times the floor"
        + "".join(
            f"; torque of {name} off by {100 * x['before']:.1f} %, then {100 * x['after']:.1f} %"
            for name, x in hidden["torque"].items()
        )
    )
    return lines


def true_parameter(hidden: dict, effect: dict, name: str) -> float | None:
    """The true value of a parameter of an effect that was found, where that is the hidden one."""
    true = hidden["true"]
    same = (effect["name"], effect["joint"]) == (true["name"], true["joint"])
    return true["parameters"].get(name) if same else None


def interval(x: dict) -> str:
    """A value with its 95 % interval, where one is known."""
    if x["std"] is None:
        return f"{number(x['value'], 4)} {x['unit']}"
    return f"{number(x['value'], 4)} [{number(x['low'], 4)}, {number(x['high'], 4)}] {x['unit']}"


def _word(confirmed: bool) -> str:
    return "holds" if confirmed else "does not hold"


def table_one(results: dict) -> list[str]:
    bias = results["bias"]["bias"]["in motion"]
    names = list(dict.fromkeys(name for by in bias.values() for name in by))
    rows = ["  n_e " + "".join(f"{name:>19}" for name in names)]
    for count, by in bias.items():
        rows.append(f"  {count:>3} " + "".join(f"{_cell(by, name, int(count)):>19}" for name in names))
    return rows


def _cell(by: dict, name: str, count: int) -> str:
    if name not in by:
        return "-"
    published = PUBLISHED_BIAS.get(count, {}).get(name)
    return f"{by[name]['mean']:.1f}" + ("" if published is None else f" ({published:.1f})")


def table_two(results: dict) -> list[str]:
    rows = [f"  {'n_e':>3}  {'method':38}{'all parameters':>28}{'stiffness':>20}{'damping':>22}"]
    for entry in sorted(results["summary"], key=lambda e: -e["experiments"]):
        published = PUBLISHED_PARAMETERS.get(entry["experiments"], {}).get(entry["method"])
        bracket = "" if published is None else f" ({100 * published:.1f})"
        rows.append(
            f"  {entry['experiments']:>3}  {entry['method']:38}{spread(entry['mean_bias']) + bracket:>28}"
            f"{spread(entry['stiffness_bias']):>20}{spread(entry['damping_bias']):>22}"
        )
    return rows


def spread(value: dict) -> str:
    """Median and range, in %."""
    low, middle, high = (100 * value[k] for k in ("least", "median", "largest"))
    return f"{middle:.2f}" if low == high else f"{middle:.2f} [{low:.2f}-{high:.2f}]"


def _list(numbers) -> str:
    return ", ".join(str(n) for n in numbers)
