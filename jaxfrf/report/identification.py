"""The page about a fit: what was found, how sure it is, and where the model does not follow the measurement."""

import os
from collections.abc import Mapping, Sequence
from typing import Any

from .._text import percent
from ..identification import Identification
from ..plot.fit import draw_correlation_map, draw_residual_maps, draw_start_paths, fit_bode, round_gaps
from .page import beside, choice, facts, figure, listing, number, page, paragraph, section, table, verdict, write_page
from .recorded import reading

_POSITIONS = 8  # whose Bode plots the page holds


def write_identification(path: str | os.PathLike, found: Identification | Mapping[str, Any]) -> None:
    """Write the page about a fit, one HTML file that needs nothing beside itself.

    **Arguments:** `path`: of the file. `found`: what `jaxfrf.identify_springs` returned, or what its fit.json holds
    (`jaxfrf.io.read_fit`): the FRFs are in no fit.json, and their pictures then not on the page.

    **Raises:** `ImportError` without matplotlib; `jaxfrf.InputError` if the folder is not there.
    """
    write_page(path, identification_page(found))


def identification_page(found: Identification | Mapping[str, Any]) -> str:
    """The page about a fit, or about what its fit.json holds, as HTML text.

    **Arguments:** `found`: what `jaxfrf.identify_springs` returned, or what its fit.json holds (`jaxfrf.io.read_fit`).

    **Returns:** the HTML of the page.

    **Raises:** `jaxfrf.InputError` if the file lacks what the page shows; `ImportError` without matplotlib.
    """
    if not isinstance(found, Mapping):
        return _page(found.as_dict(), _bode(found))
    with reading("fit.json", "identify --springs"):
        return _page(found, _no_bode())


def _page(held: Mapping[str, Any], bode: str) -> str:
    names = ", ".join(s["name"] for s in held["sources"]) or "data in memory"
    kind, frf = "indirect fit" if _indirect(held) else "direct fit", held["frf"]
    subtitle = (
        f"{kind} to {names}: {len(frf['positions'])} positions, {frf['lines']} lines from "
        f"{number(frf['band_hz'][0], 4)} to {number(frf['band_hz'][1], 4)} Hz"
    )
    sections = [
        _result(held),
        _parameters(held),
        _heldout(held),
        bode,
        _residuals(held),
        _search(held),
        _correlations(held),
        _provenance(held),
    ]
    return page(f"{held['robot']}: identified parameters", [s for s in sections if s], subtitle)


def _indirect(held: Mapping[str, Any]) -> bool:
    return held["kind"] == "indirect"


def _result(held: Mapping[str, Any]) -> str:
    result, indirect = held["result"], _indirect(held)
    good = result == "unimodal" and (not indirect or held["converged"])
    text = verdict(result[0].upper() + result[1:], held["explanation"], good)
    return text if indirect else text + paragraph(f"Direct fit only: {held['why_direct']}.")


def _parameters(held: Mapping[str, Any]) -> str:
    own, direct, beside_direct = held["parameters"], held["direct"]["parameters"], _indirect(held)
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
        rows.append([*row, *([direct[name]["value"]] if beside_direct else []), ", ".join(flags)])
    note = (
        "Intervals hold noise, widened where residuals are larger than it; std is one standard deviation. A bias that "
        "the parameters absorb is not in them."
    )
    return section("Parameters", table(headers, rows, flags=[len(headers) - 1]), paragraph(note))


def _heldout(held: Mapping[str, Any]) -> str:
    best = held["heldout"]
    if best is None:
        return ""
    columns = {"direct fit": held["direct"]["heldout"]}
    if _indirect(held):
        columns["indirect fit"] = best
    headers = ["position", "fit", "rms error, dB", "rms error, degrees", "cost"]
    rows = [
        [p, name, *(q[field][k] for field in ("rms_db", "rms_degrees", "cost_by_position"))]
        for k, p in enumerate(best["positions"])
        for name, q in columns.items()
    ]
    note = "A cost of 1 means errors as large as the weights allow: their floor and the noise of the FRF."
    return section("Positions that were not fitted", table(headers, rows), paragraph(note), listing(best["worst"]))


def _no_bode() -> str:
    text = "Pictures of the FRFs are on the page that `jaxfrf identify --report` makes: a fit.json holds no FRFs."
    return section("Measured and modelled", paragraph(text))


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


def _residuals(held: Mapping[str, Any]) -> str:
    own, positions = held["quality"], held["frf"]["positions"]
    text = (
        "Residuals over what the covariance of the FRF predicts, root mean square in each cell: 1 is noise alone, red "
        "is more than the model explains."
        if own["maps"]["of_noise"]
        else "The covariance of the FRF is not known: errors in dB."
    )
    blocks = {}
    if _indirect(held):
        blocks["indirect fit"] = figure(_residual_maps(own, positions))
        text += (
            " Blue where the simulation repeats what the covariance counts as noise (distortion by the same reference)."
        )
    blocks["direct fit"] = figure(_residual_maps(held["direct"]["quality"], positions))
    said = listing(own["worst"]) if own["worst"] else paragraph("No cell stands out of the noise.")
    return section("Residuals", paragraph(text), choice("residual", blocks), said)


def _residual_maps(quality: Mapping[str, Any], positions: Sequence[int]):
    maps, of = quality["maps"], quality["chi_square"]
    return draw_residual_maps(
        maps["by_element"],
        maps["by_position"],
        of["band_edges_hz"],
        positions,
        n_in=len(of["by_input"]),
        of_noise=maps["of_noise"],
    )[0]


def _search(held: Mapping[str, Any]) -> str:
    direct, starts = held["direct"], held["starts"]
    text = (
        f"{starts['within_1_percent']} of {starts['number']} starts of the direct fit ended within 1 % of the best "
        f"cost {number(direct['cost'], 4)}; {number(direct['expected_cost'], 4)} is what noise alone would leave."
    )
    paths = figure(
        draw_start_paths(starts["costs"], starts["paths"])[0],
        "Cost over the steps of every start; blue: ended within 1 % of the best, orange: elsewhere, or left in its "
        "valley.",
    )
    rounds = ""
    if _indirect(held):
        drawn = round_gaps([r["gap_db"] for r in held["rounds"]], [r["gap_degrees"] for r in held["rounds"]])[0]
        rounds = figure(drawn, "Gap between measured and simulated FRF in every round of simulation.")
    return section("The search", paragraph(text), beside(paths, rounds))


def _correlations(held: Mapping[str, Any]) -> str:
    high = [f"{' and '.join(pair['between'])}: {pair['value']:+.2f}" for pair in held["correlations"]]
    matrix = held["correlation_matrix"]
    said = listing(high) if high else paragraph("No two parameters are correlated above 0.9.")
    return section("Correlations", said, figure(draw_correlation_map(matrix["names"], matrix["values"])[0]))


def _provenance(held: Mapping[str, Any]) -> str:
    settings = held["settings"]
    weights = ", ".join(f"{n} {v}" for n, v in settings["weights"].items() if v not in (None, [], False))
    about = {
        "estimator": held["frf"]["method"] or "unknown",
        "starts": f"{settings['starts']}, seed {settings['seed']}",
        **({"rounds": f"{len(held['rounds'])} of {settings['rounds']}"} if _indirect(held) else {}),
        "weights": weights,
        "fixed": ", ".join(settings["fixed"]),
        "freed": ", ".join(settings["freed"]),
        "shared": "; ".join(" = ".join(names) for names in settings["shared"]),
        "held-out positions": ", ".join(map(str, settings["heldout"])),
        "band": "" if settings["band_hz"] is None else f"{settings['band_hz']} Hz",
        "jaxfrf": held["version"],
        **{s["name"]: f"sha256 {s['sha256']}" for s in held["sources"]},
    }
    return section("Settings and provenance", facts({k: v for k, v in about.items() if v}), listing(held["warnings"]))
