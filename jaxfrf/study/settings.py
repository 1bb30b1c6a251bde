"""What a study consists of: the paper's, and smaller ones that show the same sooner."""

import dataclasses

import equinox as eqx
import numpy as np

from ..excitation import Multisine, SlowSine, log_odd_lines
from ..frf import H1, LRM, AbstractMethod, Auto, JointInputOutput, LogMean, MisoLRM
from ..robot import Robot, r3x, r3x_ripple

SLOW_AMPLITUDE = (30.0, 30.0, 30.0, 40.0, 40.0, 40.0)  # rad/s, motor side


class Settings(eqx.Module):
    """Size and seeds of a study.

    **Arguments:**

    - `name`: on the page. `positions`: random arm configurations of Table I. `fit_positions`: chosen from them,
      D-optimally, for Table II; where there are as many, all of them.
    - `blocks`: blocks of six experiments at every position.
    - `seeds`: realisations of phases and noise; Table I uses the first, Table II all of them.
    - `indirect`: numbers of experiments from which the indirect fit is made.
    - `starts`: of every fit. `position_seed`: of the random configurations. `rounds`: of an indirect fit.
    - `ablations`: whether disturbances are taken away one at a time.
    - `single`: methods that are compared from a single experiment. `fitted`, `fitted_single`: estimators whose FRFs
      are fitted directly, of many experiments and of one, beside those that the indirect fits begin with.
      `at_rest`: whether that is repeated as if the arm were at rest.
    - `uncertain`: numbers of experiments from which machines are calibrated of which nothing is known exactly, drawn
      around `uncertain_robot`, "R3X" or "two axes", one for each of the seeds `machines`. `springs_alone`: whether
      springs and dampers are also fitted by themselves, all else taken as exact.
    - `at_once`: all positions are simulated together and the record is kept, which is faster and takes more memory;
      the noise is another realisation. `together`: steps that are made at the same time.
    """

    name: str = eqx.field(static=True)
    positions: int = eqx.field(static=True)
    fit_positions: int = eqx.field(static=True)
    blocks: int = eqx.field(static=True)
    seeds: tuple[int, ...] = eqx.field(static=True)
    indirect: tuple[int, ...] = eqx.field(static=True)
    starts: int = eqx.field(static=True, default=10)
    position_seed: int = eqx.field(static=True, default=0)
    rounds: int = eqx.field(static=True, default=8)
    ablations: bool = eqx.field(static=True, default=True)
    single: tuple[str, ...] = eqx.field(static=True, default=("LRM, MISO", "LRM, MIMO", "LRM, JIO", "auto"))
    fitted: tuple[str, ...] = eqx.field(static=True, default=("LOG", "LRM, JIO", "LRM, JIO stacked", "auto"))
    fitted_single: tuple[str, ...] = eqx.field(static=True, default=("LRM, JIO", "auto"))
    at_rest: bool = eqx.field(static=True, default=True)
    uncertain: tuple[int, ...] = eqx.field(static=True, default=(6, 1))
    uncertain_robot: str = eqx.field(static=True, default="R3X")
    machines: tuple[int, ...] = eqx.field(static=True, default=(0, 1, 2, 3, 4))
    springs_alone: bool = eqx.field(static=True, default=True)
    at_once: bool = eqx.field(static=True, default=False)
    together: int = eqx.field(static=True, default=1)

    @property
    def experiments(self) -> tuple[int, ...]:
        """Numbers of experiments that are compared, most first."""
        return tuple(dict.fromkeys((6 * self.blocks, 6, 1)))

    def as_dict(self) -> dict:
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}


PAPER = Settings("paper", positions=49, fit_positions=7, blocks=4, seeds=(0, 1, 2, 3, 4), indirect=(6, 1))
"""The paper's study: 49 positions, 24 experiments of 28 s at each, 336 lines; parameters from 7 positions."""

MEDIUM = Settings(
    "medium", positions=6, fit_positions=3, blocks=2, seeds=(0,), indirect=(6, 1), machines=(0,), ablations=False
)
"""The same steps with fewer positions and experiments."""

DEMO = Settings(
    "demo",
    positions=2,
    fit_positions=2,
    blocks=1,
    seeds=(0,),
    indirect=(6,),
    starts=5,
    ablations=False,
    single=("LRM, JIO", "auto"),
    fitted=(),
    fitted_single=("LRM, JIO",),
    at_rest=False,
    uncertain=(2,),
    uncertain_robot="two axes",
    machines=(0,),
    springs_alone=False,
    at_once=True,
    together=2,
)
"""The shortest run that shows every part."""

SCALES = {"demo": DEMO, "medium": MEDIUM, "paper": PAPER}
"""The sizes by the name that `--scale` takes."""


def design(blocks: int, seed: int, slow: bool = True) -> Multisine:
    """The paper's excitation: 336 log-spaced odd lines from 4 to 80 Hz, a period of 28 s, six axes at once; on top of a
    slow sine that keeps the joints moving, unless `slow` is false."""
    return Multisine(
        fs=2000.0,
        period=56000,
        lines=log_odd_lines(112, 2240, 366),
        blocks=blocks,
        rms=np.array([2.0, 2.0, 2.0, 4.0, 4.0, 6.0]),
        slow=SlowSine([21, 23, 25, 27, 29, 31], SLOW_AMPLITUDE) if slow else None,
        seed=seed,
    )


def truth() -> Robot:
    """R3X with friction, nonlinear springs and ripple."""
    return r3x().with_effects(*r3x_ripple())


PAPER_METHODS: dict[str, dict[str, AbstractMethod]] = {
    "many": {
        "LOG": LogMean(),
        "JIO": JointInputOutput(H1()),
        "LRM, MISO": LogMean(MisoLRM()),
        "LRM, MIMO": LogMean(LRM()),
        "LRM, JIO": LogMean(JointInputOutput(LRM())),
    },
    "one": {
        "LRM, MISO": MisoLRM(),
        "LRM, MIMO": LRM(),
        "LRM, JIO": JointInputOutput(LRM()),
    },
}
"""Table I's columns: for whole blocks of experiments, and for a single one, of which there is no mean to take."""

OWN_METHODS: dict[str, AbstractMethod] = {
    "LRM, JIO stacked": JointInputOutput(LRM()),
    "auto": Auto(),
}
"""What jaxfrf adds."""


def methods(experiments: int, settings: Settings = PAPER) -> dict[str, AbstractMethod]:
    """The methods that are compared at this number of experiments."""
    if experiments > 1:
        return PAPER_METHODS["many"] | OWN_METHODS
    every = PAPER_METHODS["one"] | OWN_METHODS
    return {name: every[name] for name in settings.single}


PUBLISHED_BIAS = {
    24: {"LOG": 135.55, "JIO": 134.72, "LRM, MISO": 248.65, "LRM, MIMO": 240.40, "LRM, JIO": 125.22},
    6: {"LOG": 162.14, "JIO": 162.14, "LRM, MISO": 257.71, "LRM, MIMO": 249.89, "LRM, JIO": 136.20},
    1: {"LRM, MISO": 238.89, "LRM, MIMO": 238.90, "LRM, JIO": 147.27},
}
"""Table I of Zimmermann & Moberg: weighted amplitude bias; its weights are not published."""

PUBLISHED_PARAMETERS = {
    24: {"LOG": 0.079, "LRM, JIO": 0.048},
    6: {"LOG": 0.100, "LRM, JIO": 0.091},
    1: {"LRM, JIO": 0.191},
}
"""Table II of Zimmermann & Moberg: mean relative bias of the parameters."""
