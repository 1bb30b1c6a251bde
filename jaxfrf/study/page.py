"""The page of a study: tables and figures beside the published ones."""

import os
from collections.abc import Mapping

import numpy as np

from ..excitation import reference
from ..io._json import plain_data
from ..plot.excitation import multisine
from ..plot.gap import torque_courses
from ..report.gap_words import plain
from ..report.page import (
    facts,
    figure,
    listing,
    page,
    paragraph,
    section,
    table,
    verdict,
    write_page,
)
from .claims import claims
from .figures import diagonals, enlargement, picture_of
from .page_uncertain import in_a_sentence, uncertain_section
from .parameters import STACKED
from .settings import PAPER, PUBLISHED_BIAS, PUBLISHED_PARAMETERS, design
from .summary import hidden_lines, interval, spread, true_parameter

_PAPER = "S. A. Zimmermann and S. Moberg, Experimental Evaluation of Methods for Estimating FRFs of a 6-axes Robot"


def study_page(results: dict, curves: Mapping[str, np.ndarray], courses: Mapping[str, np.ndarray]) -> str:
    """One self-contained page. `results` as in `study.json`; `curves`: what the figures show; `courses`: of the torque
    residual of the robot that hides an effect."""
    settings = results["settings"]
    title = f"R3X: from experiments to parameters ({settings['name']} study)"
    subtitle = (
        f"{settings['positions']} positions, {6 * settings['blocks']} experiments of {results['period_s']:g} s each, "
        f"{results['lines']} lines from 4 to 80 Hz; friction, nonlinear springs, noise and ripple on; "
        f"jaxfrf {results['version']}"
    )
    return page(
        title,
        [
            _headline(results),
            section("The excitation", *_excitation(results)),
            section("Table I: bias of the FRF amplitude", *_table_one(results)),
            section("Estimates, and Figures 3 and 4", *_figures(results, curves)),
            section("Table II: bias of the parameters", *_table_two(results)),
            section("Parameters, one by one", *_parameters(results)),
            uncertain_section(results["uncertain"]),
            section("The paper's conclusions", *_claims(results)),
            _why(results),
            section("A hidden effect", *_hidden(results["hidden"], courses)),
            section("Settings", *_settings(results)),
        ],
        subtitle,
    )


def _headline(results: dict) -> str:
    said = []
    for count in results["settings"]["indirect"]:
        entry, direct = _entry(results, count, "indirect"), _direct(results, count)
        published = PUBLISHED_PARAMETERS.get(count, {}).get("LRM, JIO")
        theirs = "" if published is None else f" (published, LRM, JIO: {100 * published:.1f} %)"
        said.append(
            f"n_e = {count}: mean parameter bias {spread(entry['mean_bias'])} % indirectly, "
            f"{spread(direct['mean_bias'])} % by the direct fit to {direct['method']}{theirs}"
        )
    said += [in_a_sentence(entry) for entry in results["uncertain"]["summary"]]
    made = claims(results)
    said.append(
        f"{sum(c.confirmed for c in made)} of {len(made)} conclusions of the paper "
        "that this study can check hold on R3X, see below"
    )
    first, *rest = hidden_lines(results["hidden"])
    said += [f"in a small robot ({results['hidden']['robot']}), {first}", *rest]
    return verdict("What came out", said, good=True)


def _entry(results: dict, count: int, method: str) -> dict:
    return next(e for e in results["summary"] if (e["experiments"], e["method"]) == (count, method))


def _direct(results: dict, count: int) -> dict:
    """The direct fit beside which the indirect one is shown: the paper's, or what it began with."""
    names = {e["method"] for e in results["summary"] if e["experiments"] == count}
    return _entry(results, count, "LRM, JIO" if "LRM, JIO" in names else STACKED)


def _excitation(results: dict) -> list[str]:
    drawn = multisine(reference(design(1, results["settings"]["seeds"][0])))[0].figure
    return [
        figure(
            drawn,
            f"What every experiment plays: orthogonal random-phase multisines of {results['lines']} odd lines, all "
            "six axes at once, on top of a slow sine that keeps every joint moving. Six experiments, which differ in "
            "their phases only, are a block; this is the first of them. The robot is simulated in closed loop, with "
            "friction, nonlinear springs, ripple and noise.",
            "png",
        )
    ]


def _table_one(results: dict) -> list[str]:
    blocks = [
        paragraph(
            "Mean over positions and lines of || W o (|G| - |G_hat|) ||, rad/s² per N m (eq. (24) of the paper). W is "
            "not published; here it weighs elements, 1 on the diagonal and .2 elsewhere, scaled to a 2-norm of 1. So "
            "orders and ratios compare, not values. G is the linearised robot with the describing gain of its "
            "friction, in the motion of the experiment: its springs as stiff as they are over it, and, since the slow "
            "sine turns the arm by degrees, the mean over the places that the arm visits, each weighed by what the "
            "controller makes of it."
        )
    ]
    for truth, words in (("in motion", "arm in motion"), ("at rest", "same robot as if its arm were at rest")):
        bias = results["bias"]["bias"][truth]
        names = list(dict.fromkeys(name for by in bias.values() for name in by))
        rows: list[list[object]] = []
        for count, by in bias.items():
            published = PUBLISHED_BIAS.get(int(count), {})
            rows.append([f"n_e = {count}", *(_mean(by.get(name)) for name in names)])
            if truth == "in motion" and published:
                rows.append([f"published, n_e = {count}", *[published.get(name) for name in names]])
        blocks += [paragraph(f"Against the {words}:"), table(["", *names], rows)]
    level = results["bias"]["level_db"]["in motion"]
    names = list(dict.fromkeys(name for by in level.values() for name in by))
    rows = [[f"n_e = {c}", *(f"{by[n]['mean']:.2f}" if n in by else None for n in names)] for c, by in level.items()]
    blocks += [
        paragraph("The same in decibels: mean of |20 log10(|G_hat,ii| / |G_ii|)|, in which all axes count alike."),
        table(["", *names], rows),
    ]
    return blocks


def _mean(entry: dict | None) -> str | None:
    if entry is None:
        return None
    if entry["standard_error"] is None:
        return f"{entry['mean']:.1f}"
    return f"{entry['mean']:.1f} ± {entry['standard_error']:.1f}"


def _figures(results: dict, curves) -> list[str]:
    example = results["example"]
    where = ", ".join(f"{np.rad2deg(x):.0f}" for x in example["q"])
    return [
        paragraph(
            "Every element and estimate, to choose, zoom and read values in; the figures of the paper are below. Truth "
            "is the linearised robot in motion, as in Table I."
        ),
        picture_of(curves, example["position"]),
        figure(
            diagonals(curves),
            f"Figure 3: diagonal elements at position {example['position']} (arm angles {where} degrees); the "
            "number of experiments is the index.",
        ),
        figure(enlargement(curves), "Figure 4: enlargement of the third."),
    ]


def _table_two(results: dict) -> list[str]:
    rows = []
    for entry in sorted(results["summary"], key=lambda e: -e["experiments"]):
        published = PUBLISHED_PARAMETERS.get(entry["experiments"], {}).get(entry["method"])
        rows.append(
            [
                entry["experiments"],
                entry["method"],
                spread(entry["mean_bias"]),
                None if published is None else f"{100 * published:.1f}",
                spread(entry["stiffness_bias"]),
                spread(entry["damping_bias"]),
                spread(entry["largest_damping_bias"]),
                f"{100 * entry['covered']:.0f}",
            ]
        )
    headers = [
        "n_e",
        "fit to",
        "all, %",
        "published, %",
        "stiffness, %",
        "damping, %",
        "worst damping, %",
        "95 % intervals hold, %",
    ]
    return [
        paragraph(
            f"Mean of |value/truth - 1| over 8 stiffnesses and 8 dampings, from {len(results['fit_positions'])} "
            f"{_choice(results['settings'])} positions; median [range] over the seeds. Fitted and compared are the "
            "stiffness at high deflection of axes 1-3 (ratio to the low stiffness and knee known) and the linear "
            "stiffness of the others. Direct fits use the linearised model with springs as stiff as over the motion "
            "and its response averaged over the places to which the slow sine turns the arm, but where they say "
            "otherwise; indirect means that the nonlinear robot was simulated through the same "
            "references (without the ripple and the noise of the record) until its FRF was the measured one."
        ),
        table(headers, rows),
    ]


def _choice(settings: dict) -> str:
    return "D-optimal" if settings["fit_positions"] < settings["positions"] else "random"


def _parameters(results: dict) -> list[str]:
    counts = results["settings"]["indirect"]
    methods = [(c, m) for c in counts for m in (_direct(results, c)["method"], "indirect")]
    rows = []
    for name, true in results["true"].items():
        cells = []
        for count, method in methods:
            errors = [
                100 * r["errors"][name]
                for r in results["parameters"]
                if (r["experiments"], r["method"]) == (count, method)
            ]
            cells.append(f"{np.median(errors):+.2f}")
        rows.append([name, true, *cells])
    return [
        paragraph("Median error over the seeds, %."),
        table(["parameter", "true (SI)", *(f"n_e = {c}, {m}" for c, m in methods)], rows),
    ]


def _claims(results: dict) -> list[str]:
    said = [
        f"{'Holds' if c.confirmed else 'Does not hold here'}: {c.says}. Paper: {c.paper}. Here: {c.found}."
        for c in claims(results)
    ]
    return [listing(said)]


def _why(results: dict) -> str:
    if not results["why"]:
        return ""
    names = list(next(iter(results["why"].values()))["level_db"]["6"])
    cell = lambda value: None if value is None else f"{value:.2f}"
    level = lambda row, count: [cell(row["level_db"][count].get(n)) for n in names]
    rows = [[row["text"], n, *level(row, n)] for n in ("6", "1") for row in results["why"].values()]
    fits = [
        [row["text"], *(f"{100 * row['parameters'][k]:.2f}" for k in _BIASES), _worst(row["parameters"]["errors"])]
        for row in results["why"].values()
    ]
    return section(
        "Why: one disturbance taken away at a time",
        paragraph(
            "Level error of the diagonal in dB at two of the positions; what remains in the last rows is the "
            "estimators' own smoothing."
        ),
        table(["", "n_e", *names], rows),
        paragraph("Bias of the direct fit to six experiments (stacked JIO-LRM), %:"),
        table(["", "all", "stiffness", "damping", "largest"], fits),
        listing(_reasons(results)),
    )


_BIASES = ("mean_bias", "stiffness_bias", "damping_bias")


def _worst(errors: dict[str, float]) -> str:
    names = sorted(errors, key=lambda n: -abs(errors[n]))[:2]
    return ", ".join(f"{n} {100 * errors[n]:+.0f} %" for n in names)


def _reasons(results: dict) -> list[str]:
    """What the rows above say, in words, from their numbers."""
    why = results["why"]
    level = lambda name, count, method: why[name]["level_db"][count][method]
    said = []
    for count, method in (("6", "LOG"), ("6", "LRM, JIO"), ("1", "LRM, JIO")):
        everything = level("everything", count, method)
        drops = {
            why[name]["text"]: everything - level(name, count, method)
            for name in ("no-ripple", "linear-springs", "no-coulomb")
        }
        most = max(drops, key=lambda name: drops[name])
        said.append(
            f"{method}, n_e = {count}: {everything:.2f} dB with everything; {most} it falls by {drops[most]:.2f} dB, "
            f"the most of any single one; {level('noise-free', count, method):.2f} dB are left without noise on "
            "the linear robot"
        )
    bias = {name: row["parameters"]["mean_bias"] for name, row in why.items()}
    percent = lambda name: f"{100 * bias[name]:.1f} %"
    best = min(("no-ripple", "linear-springs", "no-coulomb"), key=lambda name: bias[name])
    said.append(
        f"parameters of the direct fit: {percent('everything')} with everything, {why[best]['text']} {percent(best)}, "
        f"on the linear robot without noise {percent('noise-free')}, and without slow sine {percent('no-slow-sine')}"
    )
    return said + _of_the_slow_sine(results)


def _of_the_slow_sine(results: dict) -> list[str]:
    """What it costs to take an arm in slow motion for an arm at rest."""
    errors = {(e["experiments"], e["method"]): e["mean_bias"]["median"] for e in results["summary"]}
    pairs = [
        (count, error, errors[count, "LRM, JIO, arm as at rest"])
        for (count, method), error in errors.items()
        if method == "LRM, JIO" and (count, "LRM, JIO, arm as at rest") in errors
    ]
    return [
        f"n_e = {count}: the slow sine turns the arm by degrees, and its modes move with it; a fit to the response of "
        f"an arm at rest is off by {100 * at_rest:.1f} % (first seed), one to the mean response over the places by "
        f"{100 * in_motion:.1f} %"
        for count, in_motion, at_rest in pairs
    ]


def _hidden(hidden: dict, courses: Mapping[str, np.ndarray]) -> list[str]:
    true, gap = hidden["true"], hidden["gap"]
    off = ", ".join(f"{plain(kind)} {100 * (factor - 1):+.1f} %" for kind, factor in hidden["off"].items())
    rows = [
        [
            f"{plain(effect['name'])}, {effect['joint']}",
            name,
            x["unit"],
            interval(x),
            true_parameter(hidden, effect, name),
            ", ".join(plain(n) for n in effect["equivalent"]) or "none",
        ]
        for effect in hidden["effects"]
        for name, x in effect["parameters"].items()
    ]
    gaps = [["all axes, times the floor", gap["before"], gap["after"]]]
    gaps += [[f"torque of {name}, %", 100 * x["before"], 100 * x["after"]] for name, x in hidden["torque"].items()]
    names = list(hidden["torque"])
    return [
        paragraph(
            f"Another machine, smaller for the sake of time: two axes, "
            f"{len(hidden['fitted']) + len(hidden['heldout'])} positions, {hidden['experiments']} experiments of "
            f"{hidden['period_s']:g} s at each. It differs from its "
            f"model ({off}), has ripple, and hides {plain(true['name'])} on {true['joint']}. The search is given "
            "records and model alone; it plays the records' references to the model, and asks what the motors gave "
            "beyond what the model would have asked."
        ),
        verdict(hidden["verdict"], [hidden["says"]], good=hidden["verdict"] in ("named", "sufficient")),
        table(["found missing", "parameter", "unit", "value [95 % interval]", "true", "not told from it"], rows),
        paragraph(
            f"The gap on {gap['on']} ({', '.join(map(str, hidden['heldout']))}), which nothing was fitted to: rms of "
            "the torque that the model does not explain, before and after the effect was added."
        ),
        table(["gap", "before", "after"], gaps),
        figure(
            torque_courses(courses, names, names)[0],
            "Mean torque that the model does not explain, at all positions, against speed, angle and load: what is "
            "missing shows as a law.",
        ),
        paragraph("The candidates that explained most alone, and why they were taken or not:"),
        table(
            ["effect", "joint", "explains alone, %", ""],
            [[plain(r["name"]), r["joint"], f"{100 * r['explains']:.1f}", r["why"]] for r in hidden["next"]],
        ),
    ]


_SMALLER = {
    "positions": "positions of Table I",
    "fit_positions": "positions of the fits",
    "blocks": "blocks of six experiments at each",
    "seeds": "realisations of phases and noise",
    "indirect": "numbers of experiments of which an indirect fit is made",
    "starts": "starts of a fit",
    "single": "methods compared from one experiment",
    "fitted": "estimators that are fitted directly, many experiments",
    "fitted_single": "estimators that are fitted directly, one experiment",
    "at_rest": "fits as if the arm were at rest",
    "uncertain": "numbers of experiments from which whole robots are calibrated",
    "uncertain_robot": "robot around which machines are drawn",
    "machines": "machines drawn",
    "springs_alone": "their springs and dampers fitted by themselves",
    "ablations": "disturbances taken away one at a time",
}


def _made_smaller(settings: dict) -> list[str]:
    """What this study leaves out beside the paper's."""
    whole = plain_data(PAPER.as_dict())
    pairs = [(words, plain_data(settings[name]), whole[name]) for name, words in _SMALLER.items()]
    return [f"{words}: {_of(here, paper)}" for words, here, paper in pairs if here != paper]


def _of(here, paper) -> str:
    if isinstance(paper, bool):
        return "none"
    if isinstance(paper, str):
        return f"{here} for {paper}"
    if isinstance(paper, list) and isinstance(paper[0], str):
        return f"{'; '.join(here) or 'none of their own'} (without {'; '.join(x for x in paper if x not in here)})"
    count = lambda x: len(x) if isinstance(x, list) else x
    return f"{count(here)} of {count(paper)}"


def _settings(results: dict) -> list[str]:
    settings = results["settings"]
    smaller = _made_smaller(settings)
    return [
        facts(
            {
                "robot": "R3X (jaxfrf/robot/r3x.toml) with r3x_ripple()",
                "seeds of phases and noise": ", ".join(map(str, settings["seeds"])),
                "seed of positions": settings["position_seed"],
                "positions of the fits": ", ".join(map(str, results["fit_positions"])),
                "starts of a fit": settings["starts"],
                "position noise": "5e-5 rad",
                "time of all steps": f"{results['minutes']:.1f} min",
                "paper": _PAPER,
            }
        ),
        *([paragraph("Smaller than the paper's study:"), listing(smaller)] if smaller else []),
    ]


def write_study_page(
    path: str | os.PathLike, results: dict, curves: Mapping[str, np.ndarray], courses: Mapping[str, np.ndarray]
) -> None:
    """Write the page, whole or not at all."""
    write_page(path, study_page(results, curves, courses))
