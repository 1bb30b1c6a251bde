"""What every estimation method is: a pure function of the spectra of one operating point, and how that is run."""

import abc
import dataclasses
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from .._annotated import check_fields
from .._compile import compiled
from .._device import at_once, on_accelerator
from .._status import Status
from .._threads import lapack_alone, of_one_program
from .._types import Array
from ..spectra import Spectra
from .covariance import AbstractFactors
from .part import Part, joined, parts_of

_BATCHES = (8, 64)  # lines that are solved again at once: few numbers, so that few programs are compiled


class Signals(eqx.Module):
    """Spectra of one operating point as arrays.

    **Fields:** `U`, `Y`, `R`: Fourier coefficients of input, output and reference, (exp, freq, channel). `noise`:
    covariance of [Y; U] between periods, (exp, freq, sig, sig). `frequency`: (freq,), Hz. `R` and `noise` are `None`
    where they are unknown. `part`: the lines that are to be estimated, all where it is `None`; only methods that say so
    (`AbstractMethod.shares_lines`) are given one.
    """

    U: Complex[Array, "exp freq in"]
    Y: Complex[Array, "exp freq out"]
    R: Complex[Array, "exp freq ref"] | None
    noise: Complex[Array, "exp freq sig sig"] | None
    frequency: Float[Array, "freq"]
    part: Part | None = None

    @property
    def n_exp(self) -> int:
        return self.U.shape[0]

    @property
    def n_in(self) -> int:
        return self.U.shape[-1]

    @property
    def n_out(self) -> int:
        return self.Y.shape[-1]


class Estimate(eqx.Module):
    """What a method returns.

    **Fields:** `G`, `cov`, `dof`, `status`, `window`, `cov_noise`, `cov_total`, `bias`: as those of `jaxfrf.FRF`, with
    or without the axis of positions. `doubtful`: lines where the fast solution is not accurate enough (too small a
    pivot or residual): `jaxfrf.estimate` solves them again by an orthogonal factorisation. `alike`: whether the noise
    of the experiments is surely of about one size, of methods that look (`AbstractMethod.looks`).
    """

    G: Complex[Array, "*pos freq out in"]
    cov: AbstractFactors | Complex[Array, "*pos freq vec vec"]
    dof: Float[Array, "*pos freq"]
    status: Int[Array, "*pos freq"]
    window: Float[Array, "*pos freq"]
    doubtful: Bool[Array, "*pos freq"]
    cov_noise: AbstractFactors | Complex[Array, "*pos freq vec vec"] | None = None
    cov_total: AbstractFactors | Complex[Array, "*pos freq vec vec"] | None = None
    bias: Float[Array, "*pos freq out in"] | None = None
    alike: Bool[Array, "*pos"] | None = None


class AbstractMethod(eqx.Module):
    """A way of estimating an FRF from spectra; its fields are its options. Passed to `jaxfrf.estimate`.

    A method of one's own defines `at_point`, `check`, `block_size` and `residual_dof`.
    """

    def __check_init__(self):
        check_fields(self)

    if not TYPE_CHECKING:

        def __getattribute__(self, name: str):
            """Python's own bound methods: to make pytrees of them takes equinox 20 us at every call, and an estimate by
            `H1` makes some ten."""
            return object.__getattribute__(self, name)

    @abc.abstractmethod
    def at_point(self, signals: Signals, lines: Int[Array, "line"] | None = None) -> Estimate:
        """The estimate at one operating point, from all experiments there: a pure function of arrays, which `jax.jit`,
        `jax.vmap` and `jax.grad` transform.

            method = jf.JointInputOutput(jf.LRM(width=36))

            def response(U, Y, R):  # (exp, freq, channel) each
                return method.at_point(jf.frf.Signals(U, Y, R, None, frequency)).G

            G = jax.jit(jax.vmap(response))(U, Y, R)  # several configurations: (pos, freq, out, in)

        Shapes must be fit for the method (see `check`); the numbers are not looked at. `Estimate.doubtful` marks lines
        that `jaxfrf.estimate` would solve again. Without `lines`, all lines by the fast solution (Gram matrix);
        otherwise these lines only, by orthogonal factorisation. Derivatives of a logarithmic mean need eigenvalues that
        differ.
        """

    @abc.abstractmethod
    def check(self, spectra: Spectra) -> None:
        """Raise `jaxfrf.InputError` if the method cannot be used on these spectra."""

    @abc.abstractmethod
    def block_size(self, spectra: Spectra | Signals) -> int:
        """Experiments that one estimate needs at least: the block over which averaging methods average."""

    @abc.abstractmethod
    def residual_dof(self, signals: Signals) -> float:
        """Residual degrees of freedom of the estimate at a line whose regressors have full rank; none at 0 or below."""

    @property
    def looks(self) -> bool:
        """Whether its estimate says in `Estimate.alike` if experiments are of one noise."""
        return False

    @property
    def shares_lines(self) -> bool:
        """Whether `estimate` can take the lines in parts, which cores share; `at_point` then heeds `Signals.part`."""
        return False

    def calls_lapack(self, spectra: Spectra) -> bool:
        """Whether `at_point` makes batched LAPACK calls for all lines: few such programs may run at the same time
        (`jaxfrf._threads.lapack_threads`)."""
        return True

    def n_window(self, spectra: Spectra) -> int:
        """Windows that are solved for the estimate of one line: what it takes, about."""
        return 1

    def remarks(self, spectra: Spectra) -> tuple[str, ...]:
        """Sentences on what of these spectra the method does not use."""
        return ()

    def estimate(self, spectra: Spectra, n_part: int = 1) -> Estimate:
        """The estimate at every operating point: `at_point`, and the doubtful lines solved again. `n_part`: parts of
        the lines that are estimated at the same time."""
        parts = run_in_parts(_at_point, self, spectra, n_part)
        found = on_host(parts[0])
        if n_part > 1:
            found = joined([found, *map(on_host, parts[1:])], len(spectra.frequency), axis=1)
        return solved_again(found, self, spectra)


def solved_again(estimate: Estimate, method: AbstractMethod, spectra: Spectra) -> Estimate:
    """The estimate (arrays of the host) with its doubtful lines by orthogonal factorisation."""
    if not estimate.doubtful.any():
        return estimate
    estimate = jax.tree.map(np.array, estimate)
    points, frequency = arrays_of(spectra)
    for pos in np.flatnonzero(estimate.doubtful.any(axis=1)):
        point, here = (jax.tree.map(lambda x, pos=pos: x[pos], x) for x in (points, estimate))
        solve_again(here, method, Signals(**point, frequency=frequency))
    return estimate


def solve_again(estimate: Estimate, method: AbstractMethod, signals: Signals) -> None:
    """Write the doubtful lines of one operating point, by orthogonal factorisation, into the estimate's arrays."""
    estimate = dataclasses.replace(estimate, alike=None)  # which is no line's
    for lines, count in _batches(np.flatnonzero(estimate.doubtful)):
        with lapack_alone():
            again = on_host(compiled(_run_again)(method, signals, lines))
        jax.tree.map(lambda old, new, at=lines[:count]: old.__setitem__(at, new[: len(at)]), estimate, again)
        estimate.status[lines[:count]] |= int(Status.REFINED)


def on_host(x):
    """The same with arrays of NumPy."""
    return jax.device_get(x) if on_accelerator() else jax.tree.map(np.asarray, x)  # which has nothing to fetch


def flags(**where) -> Int[Array, "*number freq"]:
    """A status from its bits by name."""
    return sum((jnp.where(on, int(Status[name]), 0) for name, on in where.items()), jnp.zeros((), int))


def arrays_of(spectra: Spectra) -> tuple[dict, Array]:
    names = ("U", "Y", "R", "noise")
    signals = {name: getattr(spectra, name) for name in names}
    return {k: None if x is None else np.asarray(x) for k, x in signals.items()}, np.asarray(spectra.frequency)


def run(estimate, method: AbstractMethod, spectra: Spectra, *more, part: Part | None = None):
    """`estimate(method, signals, *more)` of every operating point, as one compiled program; `more`: what else there is
    of every point."""
    return compiled(_run)(estimate, method, *arrays_of(spectra), more, part)


def run_in_parts(estimate, method: AbstractMethod, spectra: Spectra, n_part: int, *more) -> list:
    """The same of every part of the lines, each by a core of its own."""
    if n_part == 1:
        return [run(estimate, method, spectra, *more)]

    def of_part(part):
        return jax.block_until_ready(run(estimate, method, spectra, *more, part=part))

    options, structure = jax.tree.flatten(method)
    program = estimate, structure, str(options), spectra.U.shape, spectra.Y.shape, n_part
    return list(of_one_program(of_part, parts_of(len(spectra.frequency), n_part), n_part, program))


def _at_point(method: AbstractMethod, signals: Signals) -> Estimate:
    return method.at_point(signals)


def _run(estimate, method: AbstractMethod, points: dict, frequency, more, part):
    def one_point(point, *more):
        return estimate(method, Signals(**point, frequency=frequency, part=part), *more)

    return over_points(one_point, points, *more)


def over_points(estimate, points: dict, *more):
    """`estimate(point, *more)` of every operating point, whose arrays are these without their leading axis: one after
    the other, as the moments of one fit the cache; on an accelerator as many at once as it holds."""
    every = (points, *more)
    if points["U"].shape[0] == 1:
        return jax.tree.map(lambda x: x[None], estimate(*jax.tree.map(lambda x: x[0], every)))
    together = _points_at_once(points) if on_accelerator() else None
    return jax.lax.map(lambda point: estimate(*point), every, batch_size=together)


def _points_at_once(points: dict) -> int:
    """Operating points whose windows, each experiment's its own, an accelerator solves together."""
    n_pos, n_exp, n_freq, n_in = points["U"].shape
    columns = 4 * (n_in + points["Y"].shape[-1])  # those of a fraction of order 2 are three to four of each
    return min(n_pos, max(1, at_once(columns) // (n_exp * n_freq)))


def _run_again(method: AbstractMethod, signals: Signals, lines) -> Estimate:
    return method.at_point(signals, lines)


def _batches(lines):
    """Lines in batches of few different sizes, the last filled up by repeats; and how many of each are meant."""
    while len(lines):
        size = _BATCHES[0] if len(lines) <= _BATCHES[0] else _BATCHES[-1]
        part, lines = lines[:size], lines[size:]
        yield np.concatenate([part, np.repeat(part[-1:], size - len(part))]), len(part)
