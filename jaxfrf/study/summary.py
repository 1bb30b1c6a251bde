"""The tables of a study as text, for the command line and the README."""

from .claims import claims
from .settings import PUBLISHED_BIAS, PUBLISHED_PARAMETERS


def summary_lines(results: dict) -> list[str]:
    """Tables I and II beside the published ones, and how many of the paper's claims hold."""
    settings = results["settings"]
    head = (
        f"study {settings['name']}: {settings['positions']} positions, {6 * settings['blocks']} experiments of "
        f"{results['period_s']:g} s at each, {results['lines']} lines; seeds {_list(settings['seeds'])}; "
        f"{results['minutes']:.0f} min"
    )
    checked = [c for c in claims(results) if c.confirmed is not None]
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
    ]


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
