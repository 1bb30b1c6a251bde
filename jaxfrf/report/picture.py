"""A picture of responses on a page: choose position, output, input and curves, zoom, read values."""

import base64
import html
import importlib.resources
import json
from collections.abc import Mapping, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from ..plot._style import breaks

_MISSING = -32768

_STYLE = """<style>
#frf .choose { display: flex; flex-wrap: wrap; gap: 8px 14px; align-items: center; margin: 0 0 8px; font-size: 14px; }
#frf select, #frf .choose button { font: inherit; padding: 3px 8px; border: 1px solid var(--line); border-radius: 3px;
  background: var(--paper); color: var(--ink); max-width: 100%; }
#frf .choose button { cursor: pointer; }
#frf select { margin-left: 5px; }
#frf .legend { display: flex; flex-wrap: wrap; gap: 4px 18px; font-size: 14px; margin: 0 0 4px; }
#frf .legend i { display: inline-block; width: 14px; height: 4px; margin: 0 6px 3px 4px; }
#frf [hidden] { display: none; }
#frf .what { color: var(--soft); font-size: 13.5px; margin: 0 0 4px; }
#frf .chart svg { width: 100%; height: auto; display: block; touch-action: pan-y; cursor: crosshair;
  user-select: none; }
#frf .charts:focus-visible { outline: 2px solid #0072b2; outline-offset: 3px; }
#frf .grid { stroke: var(--line); stroke-width: 1; } #frf .frame { fill: none; stroke: #7b858e; }
#frf .tick { font-size: 12px; fill: var(--soft); font-variant-numeric: tabular-nums; }
#frf .line { fill: none; stroke-width: 1.1; opacity: .75; } #frf .line.model { stroke-width: 2.6; }
#frf .band { opacity: .18; stroke: none; }
#frf .doubtful { fill: var(--paper); stroke: #9a9a9a; stroke-width: .7; }
#frf .cursor { stroke: var(--ink); stroke-width: 1; stroke-dasharray: 3 3; pointer-events: none; }
#frf .chosen { fill: #0072b2; opacity: .15; }
#frf .values { margin: 8px 0 4px; } #frf .values td:first-child { padding-left: 8px; white-space: normal; }
#frf .matrix { display: grid; gap: 4px; margin: 14px 0 0; max-width: 760px; }
#frf .cell { position: relative; padding: 2px; border: 1px solid var(--line); border-radius: 3px;
  background: var(--paper); cursor: pointer; min-width: 0; }
#frf .cell svg { display: block; width: 100%; height: 44px; } #frf .cell path { fill: none; stroke-width: 1.5;
  vector-effect: non-scaling-stroke; }
#frf .cell span { position: absolute; left: 4px; top: 1px; font-size: 11px; color: var(--soft);
  background: var(--paper); padding: 0 2px; line-height: 1.2; }
#frf .cell[aria-pressed=true] { border-color: var(--ink); box-shadow: 0 0 0 1px var(--ink); }
@media print { #frf .choose, #frf .matrix, #frf .hint, #frf .legend input { display: none; } }
</style>"""

_BODY = """<div id="frf">
<noscript><p>This page draws with JavaScript, which is switched off here.</p></noscript>
<div class="choose"><label>Position<select class="position"></select></label>
<label>Output<select class="output"></select></label><label>Input<select class="input"></select></label>
<button type="button" class="in" title="Zoom in about the cursor">zoom in</button>
<button type="button" class="out" title="Zoom out">zoom out</button>
<button type="button" class="reset">whole band</button><button type="button" class="axis"></button></div>
<div class="legend"></div><p class="what"></p>
<div class="charts" tabindex="0" aria-label="Magnitude and phase; arrow keys move the cursor">
<div class="chart magnitude"></div><div class="chart phase"></div></div>
<div class="wide"><table class="values"><thead><tr><th>at the cursor</th><th class="number">Hz</th>
<th class="number">|G|, UNIT</th><th class="number">CONFIDENCE % region</th><th class="number">dB</th>
<th class="number">phase, degrees</th></tr></thead><tbody></tbody></table></div>
<p class="what hint">Drag across a picture to zoom, double-click for the whole band, move to read values (arrow keys, +,
- and Escape do the same). Bands: CONFIDENCE % regions; hollow points: doubtful estimates; LINES.</p>
<div class="matrix"></div></div>"""


class Curve(eqx.Module):
    """One estimate, model or truth of a picture.

    **Fields:** `name`, `colour`. `frequency`: Hz, (freq,). `layers`: name -> (pos, freq, out, in), NaN where nothing is
    known: `level` (dB), `phase` (degrees) and, where there are any, `radius` of the confidence region, standard
    deviations `noise` and `total` (all dB), `doubt` (1: hollow points). `points`: whether its lines are marked.
    """

    name: str = eqx.field(static=True)
    colour: str = eqx.field(static=True)
    frequency: Float[np.ndarray, "freq"]
    layers: Mapping[str, Float[np.ndarray, "pos freq out in"]]
    points: bool = eqx.field(static=True, default=True)


def responses(G: Complex[np.ndarray, "pos freq out in"]) -> dict[str, np.ndarray]:
    """The layers `level` and `phase` of a response."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return {"level": decibel(np.abs(G)), "phase": np.where(np.isfinite(G), np.degrees(np.angle(G)), np.nan)}


def decibel(x: np.ndarray) -> np.ndarray:
    """20 log10, NaN where x is not positive."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return 20 * np.log10(np.where(x > 0, x, np.nan))


def picture(
    curves: Sequence[Curve],
    *,
    outputs: Sequence[str],
    inputs: Sequence[str],
    positions: Sequence[str],
    unit: str,
    confidence: float = 0.95,
    lines: str = "lines join neighbours",
) -> str:
    """The picture as HTML, with its numbers and its script; one on a page.

    **Arguments:** `outputs`, `inputs`, `positions`: what each is called where it is chosen. `unit`: of the response.
    `confidence`: of `radius`. `lines`: what lines mean, in words.
    """
    data = {
        "estimates": [_packed(curve) for curve in curves],
        "outputs": list(outputs),
        "inputs": list(inputs),
        "positions": list(positions),
        "unit": unit,
    }
    body = _BODY.replace("UNIT", html.escape(unit)).replace("CONFIDENCE", f"{100 * confidence:g}")
    body = body.replace("LINES", html.escape(lines))
    script = importlib.resources.files(__package__).joinpath("response.js").read_text(encoding="utf-8")
    return (
        f'{_STYLE}\n{body}\n<script type="application/json" id="frf-data">{_json(data)}</script>\n'
        f"<script>{script}</script>"
    )


def _packed(curve: Curve) -> dict:
    """What the script needs of a curve: hundredths of decibels and degrees in two bytes each."""
    order = np.argsort(curve.frequency, kind="stable")
    frequency = np.asarray(curve.frequency, float)[order]
    # (pos, layer, out, in, freq)
    layers = np.stack([np.moveaxis(np.asarray(x)[:, order], 1, -1) for x in curve.layers.values()], axis=1)
    whole = np.where(np.isfinite(layers), np.clip(np.round(100 * layers), -32767, 32767), _MISSING).astype("<i2")
    return {
        "name": curve.name,
        "colour": curve.colour,
        "points": curve.points,
        "layers": list(curve.layers),
        "positions": len(layers),
        "frequency": [float(f"{f:.7g}") for f in frequency],
        "cuts": np.flatnonzero(breaks(frequency)).tolist() if len(frequency) > 1 else [],
        "data": base64.b64encode(whole.tobytes()).decode(),
    }


def _json(data: dict) -> str:
    """JSON that may stand inside a script element."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
