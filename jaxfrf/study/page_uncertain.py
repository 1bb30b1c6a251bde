"""The part of a study's page about machines of which nothing is known exactly."""

from ..report.gap_words import plain
from ..report.page import beside, choice, figure, listing, paragraph, section, table
from .figures import errors_of_numbers
from .summary import has_springs, held, machines, spread
from .uncertain import MEASURED

_DRAWN = 3  # machines whose numbers the page draws, so that it stays below 3 MB


def in_a_sentence(entry: dict) -> str:
    """What came out, for the head of the page."""
    told = lambda what: ", ".join(
        f"{kind} {spread(entry['errors'][kind][what])} %" for kind in ("stiffness", "damping")
    )
    alone = f"; {told('springs')} where friction and masses are taken as exact" if has_springs(entry) else ""
    return (
        f"nothing known exactly ({entry['robot']}, n_e = {entry['experiments']}), mean error: {told('whole')} where "
        f"the whole robot is calibrated, {told('given')} before{alone}"
    )


def uncertain_section(uncertain: dict) -> str:
    """Errors by kind, as given and by both fits; nothing where a study leaves them out."""
    summary = uncertain["summary"]
    if not summary:
        return ""
    most = max(row["experiments"] for row in uncertain["machines"])
    shown = [row for row in uncertain["machines"] if row["experiments"] == most][:_DRAWN]
    springs = has_springs(summary[0])
    headers = ["n_e", "mean error, %", "as given", *(["all else taken as exact"] if springs else []), "whole robot"]
    return section(
        "When nothing is known exactly",
        paragraph(_setting(summary[0], uncertain["off"])),
        table([*headers, "its largest"], [row for entry in summary for row in _rows(entry, springs)]),
        listing([f"95 % intervals that hold, n_e = {e['experiments']}: {held(e['intervals'])}" for e in summary]),
        _drawn(shown),
        paragraph(
            f"Error of every number of {_which(shown)}, n_e = {most}: grey crosses as given, "
            + ("orange squares where all else is taken as exact, " if springs else "")
            + "blue dots where the whole robot is calibrated. Bars are half of the 95 % interval: where a dot stands "
            "beyond its bar, the interval does not hold the truth. What is smaller than the axis stands at its edge."
        ),
    )


def _drawn(machines: list[dict]) -> str:
    """The numbers of one machine at a time."""
    blocks = {
        f"machine {row['seed']}": beside(*(figure(drawn) for drawn in errors_of_numbers(row["numbers"])))
        for row in machines
    }
    return choice("machine", blocks) if len(blocks) > 1 else "".join(blocks.values())


def _which(machines: list[dict]) -> str:
    if len(machines) == 1:
        return f"one machine (seed {machines[0]['seed']})"
    return f"one machine at a time (seeds {', '.join(str(row['seed']) for row in machines)})"


def _setting(entry: dict, off: dict[str, float]) -> str:
    by: dict[float, list[str]] = {}
    for kind, most in off.items():
        by.setdefault(most, []).append(_WORDS.get(kind, plain(kind)))
    how_far = ", ".join(f"{100 * most:g} % ({', '.join(kinds)})" for most, kinds in by.items())
    drawn = f"{machines(entry['machines'])} {'is' if entry['machines'] == 1 else 'are'} drawn"
    return (
        "So far everything but stiffness and damping was known: masses, rotors, friction, the shape of the springs, as "
        f"in the paper. Here {drawn} around the robot ({entry['robot']}), every number off by up to {how_far}; "
        f"{entry['positions']} positions, experiments of {entry['period_s']:g} s, ripple and noise on. The fits are "
        "given the robot as its maker states it; what the calibration is told of its tolerances are the defaults, not "
        "what the machines were drawn from. Torque constants are left as stated, though the calibration holds them for "
        "known to 3 % only, which makes its intervals wide. Records are made by jaxfrf's own simulator, so that no "
        "physics is missing from the model; benchmarks/bench_calibration.py does the same with MuJoCo's."
    )


_WORDS = {"com": "centres of mass", "mass": "masses", "inertia": "inertias", "motor_inertia": "rotors"}


def _rows(entry: dict, springs: bool) -> list[list]:
    cell = lambda errors: None if errors is None else spread(errors)
    return [
        [
            entry["experiments"],
            MEASURED[kind],
            *(cell(errors[what]) for what in ("given", *(["springs"] if springs else []), "whole")),
            f"{100 * errors['whole']['worst']:.2f}",
        ]
        for kind, errors in entry["errors"].items()
    ]
