"""The page about a fit: what was found, how sure it is, and where the model does not follow the measurement."""

import os

import numpy as np

from .._text import percent
from ..graybox import Fit
from ..identification import Identification
from ..io.fits import fit_contents
from ..plot.fit import correlation_map, fit_bode, residual_maps, round_gaps, start_paths
from .page import beside, choice, facts, figure, listing, number, page, paragraph, section, table, verdict, write_page

_POSITIONS = 8  # whose Bode plots the page holds


def write_identification(path: str | os.PathLike, found: Identification) -> None:
    """Write the page about a fit, one HTML file that needs nothing beside itself.

    **Arguments:** `path`: of the file. `found`: what `jaxfrf.identify` returned.

    **Raises:** `ImportError` without matplotlib; `jaxfrf.InputError` if the folder is not there.
    """
    write_page(path, identification_page(found))


def identification_page(found: Identification) -> str:
    """The page about a fit as HTML text."""
    frf = found.measured
    names = ", ".join(s.name for s in frf.sources) or "data in memory"
    kind = "fit through the experiment" if found.indirect else "direct fit"
    subtitle = (
        f"{kind} to {names}: {len(found.positions)} positions, {len(frf.frequency)} lines from "
        f"{number(frf.frequency[0], 4)} to {number(frf.frequency[-1], 4)} Hz"
    )
    sections = [
        _result(found),
        _parameters(found),
        _heldout(found),
        _bode(found),
        _residuals(found),
        _search(found),
        _correlations(found.fit),
        _provenance(found),
    ]
    return page(f"{found.model.robot.name}: identified parameters", [s for s in sections if s], subtitle)


def _result(found: Identification) -> str:
    good = found.result == "unimodal" and (found.indirect is None or found.indirect.converged)
    word = found.result[0].upper() + found.result[1:]
    text = verdict(word, found.explain(), good)
    if found.indirect is None:
        return text + paragraph(f"Direct fit only: {found.why_direct}.")
    return text


def _parameters(found: Identification) -> str:
    own = fit_contents(found.fit, found.model)["parameters"]
    direct = found.direct.values
    beside_direct = found.indirect is not None
    headers = [
        "parameter",
        "value",
        "95 % interval",
        "std",
        "unit",
        "start",
        *(["direct fit"] if beside_direct else []),
        "",
    ]
    rows = []
    for name, p in own.items():
        low, high = p["interval95"] or (None, None)
        flags = [
            *(["not identifiable"] if not p["identifiable"] else []),
            *(["at its bound"] if p["at_bound"] else []),
            *([f"same as {p['same_as']}"] if "same_as" in p else []),
        ]
        spread = None if p["std"] is None or not p["value"] else percent(p["std"] / abs(p["value"]))
        interval = "" if low is None else f"{number(low)} to {number(high)}"
        row = [f"{name} (nuisance)" if p["nuisance"] else name, p["value"], interval, spread, p["unit"], p["start"]]
        rows.append([*row, *([direct[name]] if beside_direct else []), ", ".join(flags)])
    note = (
        "Intervals hold noise, widened where residuals are larger than it; std is one standard deviation. A bias that "
        "the parameters absorb is not in them."
    )
    return section("Parameters", table(headers, rows, flags=[len(headers) - 1]), paragraph(note))


def _heldout(found: Identification) -> str:
    held = found.heldout
    if held is None:
        return ""
    columns = {"direct fit": held.direct} | ({} if held.indirect is None else {"through the experiment": held.indirect})
    headers = ["position", "fit", "rms error, dB", "rms error, degrees", "cost"]
    rows = [
        [p, name, *(float(x[k]) for x in (q.rms_db, q.rms_degrees, q.position_cost))]
        for k, p in enumerate(held.positions)
        for name, q in columns.items()
    ]
    note = "A cost of 1 means errors as large as the weights allow: their floor and the noise of the FRF."
    worst = (held.indirect or held.direct).worst(held.positions)
    return section("Positions that were not fitted", table(headers, rows), paragraph(note), listing(worst))


def _bode(found: Identification) -> str:
    frf, models = found.measured, found.responses()
    blocks, count = {}, min(frf.n_out, frf.n_in)
    size = None if count < 3 else (10.2, 0.6 + 3.0 * -(-count // 3)) if count != 4 else (10.2, 6.6)
    for k, p in list(enumerate(found.positions))[:_POSITIONS]:
        drawn, _ = fit_bode(frf, models, position=k, size=size)
        blocks[f"position {p}"] = figure(drawn, kind="png")
    names = " and ".join(models)
    text = f"Diagonal elements, measured (with 95 % bands) and {names}."
    if found.indirect is not None:
        text += " The simulated curve went through the same estimator as the measured one; the direct fit's did not."
    more = frf.n_pos - len(blocks)
    tail = paragraph(f"{more} more positions are not shown.") if more > 0 else ""
    return section("Measured and modelled", paragraph(text), choice("bode", blocks), tail)


def _residuals(found: Identification) -> str:
    known = np.isfinite(found.quality.chi_square).any()
    text = (
        "Residuals over what the covariance of the FRF predicts, root mean square in each cell: 1 is noise alone, red "
        "is more than the model explains."
        if known
        else "The covariance of the FRF is not known: errors in dB."
    )
    blocks = {}
    if found.indirect is not None:
        blocks["through the experiment"] = figure(residual_maps(found.quality, found.positions)[0])
        text += (
            " Blue where the simulation repeats what the covariance counts as noise (distortion by the same reference)."
        )
    blocks["direct fit"] = figure(residual_maps(found.direct_quality, found.positions)[0])
    worst = found.quality.worst(found.positions)
    said = listing(worst) if worst else paragraph("No cell stands out of the noise.")
    return section("Residuals", paragraph(text), choice("residual", blocks), said)


def _search(found: Identification) -> str:
    direct = found.direct
    text = (
        f"{direct.close_starts} of {len(direct.starts)} starts of the direct fit ended within 1 % of the best cost "
        f"{number(direct.cost, 4)}; {number(direct.uncertainty.expected_cost, 4)} is what noise alone would leave."
    )
    paths = figure(
        start_paths(direct)[0],
        "Cost over the steps of every start; blue: ended within 1 % of the best, orange: elsewhere, or left in its "
        "valley.",
    )
    rounds = ""
    if found.indirect is not None:
        gaps = found.indirect.corrections
        drawn = round_gaps([c.gap_db for c in gaps], [c.gap_deg for c in gaps])[0]
        rounds = figure(drawn, "Gap between measured and simulated FRF in every round of simulation.")
    return section("The search", paragraph(text), beside(paths, rounds))


def _correlations(fitted: Fit) -> str:
    high = [f"{a} and {b}: {rho:+.2f}" for (a, b), rho in fitted.uncertainty.correlations().items()]
    said = listing(high) if high else paragraph("No two parameters are correlated above 0.9.")
    return section("Correlations", said, figure(correlation_map(fitted)[0]))


def _provenance(found: Identification) -> str:
    from .. import __version__

    frf, settings = found.measured, found.settings
    weights = ", ".join(f"{n} {v}" for n, v in settings["weights"].items() if v not in (None, [], False))
    about = {
        "estimator": frf.method or "unknown",
        "starts": f"{settings['starts']}, seed {settings['seed']}",
        **({} if found.indirect is None else {"rounds": f"{len(found.indirect.corrections)} of {settings['rounds']}"}),
        "weights": weights,
        "fixed": ", ".join(settings["fixed"]),
        "freed": ", ".join(settings["freed"]),
        "shared": "; ".join(" = ".join(names) for names in settings["shared"]),
        "held-out positions": ", ".join(map(str, settings["heldout"])),
        "band": "" if settings["band_hz"] is None else f"{settings['band_hz']} Hz",
        "jaxfrf": __version__,
        **{s.name: f"sha256 {s.sha256}" for s in frf.sources},
    }
    return section("Settings and provenance", facts({k: v for k, v in about.items() if v}), listing(frf.warnings))
