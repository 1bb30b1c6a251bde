"""The parameters of a robot with everything that is known about how they were found."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np

from .. import __version__
from .._text import counted, number, percent
from ..frf import FRF
from ..graybox import Fit, IndirectFit, RobotModel
from ..graybox.quality import Quality
from ..graybox.slow_motion import response_at
from ..io.fits import fit_contents, plain_data, starts_contents
from ..robot import Robot


class HeldOut(eqx.Module):
    """Positions that were not fitted. `positions`: their numbers. `direct`: errors of the direct fit's linear model
    there. `indirect`: of the simulated experiment, or `None`."""

    positions: tuple[int, ...] = eqx.field(static=True)
    direct: Quality
    indirect: Quality | None


class Identification(eqx.Module):
    """The parameters of a robot with everything that is known about how they were found.

    **Fields:** `model`: as it was before the fit. `direct`: the fit of the linear model to the FRF. `indirect`: the
    indirect fit, or `None`; `why_direct` then says why not. `measured`: the FRF at the positions that were fitted,
    `positions` their numbers. `quality`: residuals of `fit`; `direct_quality`: of `direct`. `heldout`: or
    `None`. `settings`: what was asked for, plain data.
    """

    model: RobotModel
    direct: Fit
    indirect: IndirectFit | None
    why_direct: str = eqx.field(static=True)
    measured: FRF
    positions: tuple[int, ...] = eqx.field(static=True)
    quality: Quality
    direct_quality: Quality
    heldout: HeldOut | None
    settings: dict[str, Any] = eqx.field(static=True)

    @property
    def fit(self) -> Fit:
        """The result: the indirect fit where there is one."""
        return self.direct if self.indirect is None else self.indirect.fit

    @property
    def robot(self) -> Robot:
        """The robot with the stiffnesses and dampings of the result."""
        return self.model.at(self.fit.values)

    @property
    def result(self) -> str:
        """The verdict, as `Fit.verdict`; starts are those of the direct fit."""
        verdict = self.fit.verdict
        return self.direct.verdict if verdict == "unimodal" and self.direct.verdict == "multimodal" else verdict

    def explain(self) -> list[str]:
        """The verdict in sentences."""
        said = self.fit.explain()
        if self.indirect is None:
            return said
        starts = [text for text in self.direct.explain() if "starts ended within" in text]
        rounds = len(self.indirect.corrections)
        gap = self.indirect.corrections[-1]
        text = (
            f"the parameters stay after {counted(rounds, 'round')} of simulation"
            if self.indirect.converged
            else f"the parameters still moved after {rounds} rounds of simulation: more of them may help, "
            "or robot and experiment differ in what is not fitted"
        )
        differ = f"measured and simulated FRF differ by {number(gap.gap_db, 2)} dB, {number(gap.gap_deg, 2)} degrees"
        return [f"{text}; {differ}", *starts, *said]

    def responses(self) -> dict[str, np.ndarray]:
        """Modelled FRFs beside the measured one: name -> (pos, freq, out, in)."""
        found = {"direct fit": model_response(self.direct, self.measured.frequency)}
        return found if self.indirect is None else found | {"simulated": np.asarray(self.indirect.simulated.G)}

    def lines(self) -> list[str]:
        """The result for a person: the first things to know, one line each."""
        fitted, own = self.fit, fit_contents(self.fit, self.model)["parameters"]
        std, direct = dict(zip(fitted.coordinates.names, fitted.uncertainty.std, strict=True)), self.direct.values
        frequency = self.measured.frequency
        kind = f"direct fit only ({self.why_direct})" if self.indirect is None else "indirect fit"
        text = [
            f"{self.model.robot.name}: {kind}, {counted(len(self.positions), 'position')}, {len(frequency)} lines from "
            f"{number(frequency[0], 4)} to {number(frequency[-1], 4)} Hz, {len(self.direct.starts)} starts"
        ]
        width = max(len(name) for name in own)
        for name, p in own.items():
            if p["nuisance"]:
                continue
            spread = std.get(p.get("same_as", name))
            known = "  not identifiable" if not p["identifiable"] or spread is None else f" +- {percent(spread)}"
            beside = "" if self.indirect is None else f", direct {number(direct[name], 4)}"
            text.append(
                f"  {name:{width}}  {number(p['value'], 4)}{known} {p['unit']}  (start {number(p['start'], 4)}{beside})"
            )
        text += [f"{self.result}: {self.explain()[0]}" if self.explain() else self.result, *self.explain()[1:]]
        text += [f"residual: {x}" for x in self.quality.worst(self.positions)[:3]]
        if self.heldout is not None:
            held, best = self.heldout, self.heldout.indirect or self.heldout.direct
            beside = "" if held.indirect is None else f" (direct fit {number(held.direct.total_db, 2)} dB)"
            text.append(
                f"held-out position(s) {', '.join(map(str, held.positions))}: rms error {number(best.total_db, 2)} dB, "
                f"{number(best.total_degrees, 2)} degrees{beside}"
            )
        return text

    def as_dict(self) -> dict[str, Any]:
        """What fit.json holds, as `jaxfrf.io.write_fit` takes it."""
        fitted, own = self.fit, fit_contents(self.fit, self.model)
        held = self.heldout
        values = lambda x: {n: float(v) for n, v in fitted.coordinates.values(x).items() if n in own["parameters"]}
        return plain_data(
            own
            | {
                "kind": "direct" if self.indirect is None else "indirect",
                "why_direct": self.why_direct,
                "result": self.result,
                "explanation": self.explain(),
                "starts": starts_contents(self.direct),
                "correlation_matrix": {
                    "names": list(fitted.coordinates.names),
                    "values": fitted.uncertainty.correlation,
                },
                "quality": _quality_contents(self.quality, self.positions),
                "heldout": None if held is None else _heldout_contents(held, held.indirect or held.direct),
                "direct": fit_contents(self.direct, self.model)
                | {
                    "quality": _quality_contents(self.direct_quality, self.positions),
                    "heldout": None if held is None else _heldout_contents(held, held.direct),
                },
                "rounds": []
                if self.indirect is None
                else [
                    {"gap_db": c.gap_db, "gap_degrees": c.gap_deg, "parameters": values(c.x)}
                    for c in self.indirect.corrections
                ],
                "converged": None if self.indirect is None else self.indirect.converged,
                "settings": self.settings,
                "frf": {
                    "method": self.measured.method,
                    "lines": len(self.measured.frequency),
                    "band_hz": [self.measured.frequency[0], self.measured.frequency[-1]],
                    "positions": list(self.positions),
                },
                "robot": self.model.robot.name,
                "sources": [{"name": s.name, "sha256": s.sha256} for s in self.measured.sources],
                "warnings": list(self.measured.warnings),
                "version": __version__,
            }
        )


def model_response(fitted: Fit, frequency) -> np.ndarray:
    """G of a fitted model at its operating points, (pos, freq, out, in); at the lines of the fit as the experiment
    shows it, with the shift of its target."""
    tg = fitted.target
    G = response_at(fitted.model, fitted.values, frequency, tg.points)
    if not np.array_equal(frequency, tg.frequency):
        return G
    return G * np.exp(tg.shift).reshape(*G.shape[:2], G.shape[3], G.shape[2]).swapaxes(-1, -2)


def _quality_contents(own: Quality, positions: Sequence[int]) -> dict[str, Any]:
    return {
        "rms_db": own.total_db,
        "rms_degrees": own.total_degrees,
        "cost": own.cost,
        "chi_square": {
            "by_element": own.by_element,
            "by_output": own.by_output,
            "by_input": own.by_input,
            "by_band": own.by_band,
            "by_position": own.by_position,
            "band_edges_hz": own.edges,
        },
        "maps": {"of_noise": own.of_noise, **dict(zip(("by_element", "by_position"), own.maps, strict=True))},
        "positions": list(positions),
        "worst": own.worst(positions),
    }


def _heldout_contents(held: HeldOut, own: Quality) -> dict[str, Any]:
    return {
        "positions": list(held.positions),
        "cost": own.cost,
        "cost_by_position": own.position_cost,
        "rms_db": own.rms_db,
        "rms_degrees": own.rms_degrees,
        "chi_square_by_position": own.by_position,
        "worst": own.worst(held.positions),
    }
