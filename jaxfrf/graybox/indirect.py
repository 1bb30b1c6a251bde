"""The indirect fit: the model is asked for what it would have measured, measured the same way."""

from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import PRNGKeyArray

from .._arguments import expect
from .._errors import input_error
from ..experiment import Experiment
from ..frf import FRF, LRM, AbstractMethod, JointInputOutput, estimate
from ..robot import ZeroOrderHold
from ..simulation import replay
from ..spectra import dft, with_output_quantity
from .corrections import Correction, next_point, settled, updated
from .cost import vec
from .deflections import robot_points
from .fit import Fit, fit_target
from .in_motion import fit_in_motion
from .model import RobotModel, starting_at
from .parameter import Coordinates
from .slow_motion import response_at
from .solver import AbstractSolver, LevenbergMarquardt
from .target import Target, Weights, shifted, target

_NOT_SIMULATED = ("torque_gain", "delay")  # parameters of the linear model that no simulation knows

Say = Callable[[str], None]


class IndirectFit(eqx.Module):
    """An indirect fit: the experiment was simulated.

    **Fields:** `fit`: the result; its residuals are the logarithm of measured over simulated FRF. `direct`: the fit to
    the measured FRF with the linear model, where it started. `corrections`: every round. `converged`: whether the last
    correction was below a tenth of its standard deviation. `measured`, `simulated`: FRFs, the latter at
    `corrections[-1].x`.

    **Source:** as of `jaxfrf.fit_indirectly`.
    """

    fit: Fit
    direct: Fit
    corrections: tuple[Correction, ...]
    converged: bool = eqx.field(static=True)
    measured: FRF
    simulated: FRF


def default_method() -> AbstractMethod:
    """The estimator of an indirect fit: local fractions through the reference, all experiments at once.

    Windows are fixed, so that measurement and simulation are smoothed alike."""
    return JointInputOutput(LRM())


def measured_frf(data: Experiment, method: AbstractMethod, quantity: str) -> FRF:
    """FRF of a record in this quantity of its output."""
    return estimate(with_output_quantity(dft(data), quantity), method)


def fit_indirectly(
    model: RobotModel,
    data: Experiment,
    method: AbstractMethod | None = None,
    *,
    weights: Weights | None = None,
    solver: AbstractSolver | None = None,
    starts: int | Sequence = 20,
    key: PRNGKeyArray | None = None,
    rounds: int = 12,
    done: Sequence[Correction] = (),
    keep: Callable[[Correction], None] | None = None,
    say: Say | None = None,
) -> IndirectFit:
    """Fit a robot's parameters by simulating the experiment itself.

    The simulated robot, nonlinear springs, friction and controller included, plays the references of the record; its
    FRF is estimated exactly as the measured one. The measured FRF is corrected by G(theta)/G_simulated(theta), the bias
    of the estimator and of the linearisation at theta, and fitted again, until theta converges: indirect inference
    (Gourieroux, Monfort & Renault, J. Appl. Econometrics 8, 1993) with the linear fit as its auxiliary model. What the
    simulation shares with the experiment cancels: leakage and smoothing, distortion by the same reference, the hold.
    Rounds are accelerated by Anderson's method; a round that widens the gap is taken back.

    Biased where robot and experiment differ in what is not fitted (another friction law, other masses): it then shows
    in `fit.uncertainty.misfit`.

    **Arguments:**

    - `model`: `jaxfrf.RobotModel` of a robot with a controller. Effective friction is fitted as a nuisance beside the
      simulation's own friction.
    - `data`: periodic records with references and arm configurations.
    - `method`: by default `jaxfrf.JointInputOutput(jaxfrf.LRM())`: fixed windows, which smooth measurement and
      simulation alike.
    - `weights`, `solver`, `starts`, `key`: of the direct fit, as in `jaxfrf.fit`.
    - `rounds`: at most. `done`: rounds of an interrupted run. `keep`: called with every new round.
    - `say`: called with a line of progress.

    **Returns:** an `IndirectFit`: the fit, the direct one, every round, both FRFs.

    **Raises:** `jaxfrf.InputError` without references or controller, and where a simulation diverges.

    **Source:** Gourieroux, Monfort & Renault, J. Applied Econometrics 8 (1993) S85-S118 (indirect inference); Anderson,
    J. ACM 12 (1965) 547-560 (the acceleration). Its use for FRFs of robots is this project's own.
    """
    expect("data", data, Experiment)
    method = default_method() if method is None else method
    weights = Weights() if weights is None else weights
    solver = LevenbergMarquardt() if solver is None else solver
    if model.robot.controller is None:
        raise input_error(
            f"{model.robot.name}: controller", "none", "a [controller] table", "Without it only `fit` is possible."
        )
    check_simulated(model)
    if rounds < 1:
        raise input_error("rounds", f"{rounds}", "1 or more", "Use `fit` for the direct fit.")
    measured = measured_frf(data, method, model.quantity)
    direct = fit_in_motion(model, data, measured, weights=weights, solver=solver, starts=starts, key=key)
    tell(say, f"direct fit: {direct.verdict}, {direct.close_starts} of {len(direct.starts)} starts agree")
    loop = _Loop(model, data, method, measured, weights, solver, direct.model)
    history = list(done)
    x = np.asarray(direct.x) if not history else next_point(history, loop.coordinates, direct)
    while True:
        correction, latest, simulated = loop.round(x)
        history.append(correction)
        if keep is not None:
            keep(correction)
        wanted = loop.coordinates.wanted()
        moved = np.abs(correction.update - correction.x)[wanted]
        converged = bool(settled(correction, loop.coordinates, latest)[wanted].all())
        tell(
            say,
            f"round {len(history)}: gap {correction.gap_db:.3f} dB, largest change {100 * moved.max():.2f} %"
            + (", converged" if converged else ""),
        )
        if converged or len(history) >= rounds:
            return IndirectFit(latest, direct, tuple(history), converged, measured, simulated)
        x = next_point(history, loop.coordinates, latest)


def check_simulated(model: RobotModel) -> None:
    """Refuse free parameters that a simulation of the experiment does not know: the loop could not come to rest."""
    unknown = [n for n, p in model.parameters.items() if p.free and n.rpartition(".")[2] in _NOT_SIMULATED]
    if unknown:
        raise input_error(
            "parameters to fit",
            ", ".join(unknown),
            "stiffnesses and dampings: the simulation of the experiment knows no other",
            "Fit it directly (--direct, `fit`), or leave it fixed.",
        )


class _Loop:
    """What every round needs."""

    def __init__(self, model, data, method, measured, weights, solver, fitted_model):
        self.data, self.method, self.solver = data, method, solver
        self.model: RobotModel = fitted_model
        # A simulation samples positions; a record of a speed sensor's is compared by what both are beside linear.
        held = fitted_model.hold is not None
        played = ZeroOrderHold(data.fs, "position")
        self.as_played: RobotModel = eqx.tree_at(lambda m: m.hold, fitted_model, played) if held else fitted_model
        self.coordinates = Coordinates(fitted_model.parameters)
        self.target: Target = target(measured, weights, model.points(data.q, data.n_pos))
        self.g = np.asarray(measured.G).swapaxes(-1, -2).reshape(self.target.log_G.shape)

    def round(self, x) -> tuple[Correction, Fit, FRF]:
        values = {n: float(v) for n, v in self.coordinates.values(x).items()}
        robot = self.model.at(values)
        played = replay(robot, self.data)
        simulated = measured_frf(played, self.method, self.model.quantity)
        points = robot_points(robot, played)
        linear, as_played = (
            np.asarray(vec(response_at(x, values, self.target.frequency, points))) for x in (self.model, self.as_played)
        )
        G_simulated = np.asarray(vec(np.asarray(simulated.G)))
        with np.errstate(invalid="ignore", divide="ignore"):
            shift = np.log(G_simulated / as_played)
            gap = np.log(self.g / G_simulated * as_played / linear)
        tg = shifted(self.target, shift, points)
        found = fit_target(starting_at(self.model, values), tg, self.solver, 1)
        # The fit came from a single start on purpose; what it knows is counted both ways: distortion that repeats in
        # the simulation is in the FRF's covariance, but not in these residuals.
        weight = np.square(self.target.magnitude) * tg.used
        rms = lambda part: float(np.sqrt(np.sum(weight * np.where(tg.used, part, 0) ** 2) / np.sum(weight)))
        correction = Correction(
            np.asarray(x), updated(self.coordinates, found), 20 / np.log(10) * rms(gap.real), np.rad2deg(rms(gap.imag))
        )
        return correction, found, simulated


def tell(say: Say | None, text: str) -> None:
    if say is not None:
        say(text)
