"""The verb of this package: spectra, or a record, and a method to an FRF."""

import dataclasses
import os
from collections.abc import Callable, Iterator

import jax
import numpy as np

from .. import __version__
from .._arguments import expect_callable, wrong_kind
from .._device import on_accelerator
from .._environment import cores
from .._errors import input_error
from .._status import SERIOUS, Status, describe
from .._threads import lapack_threads, of_one_program, one_blas_thread
from .._types import require_x64
from ..experiment import Experiment
from ..spectra import Spectra, select_positions
from .aperiodic import adapted
from .causes import with_causes
from .classical import DEPENDENT
from .from_record import spectra_of
from .method import AbstractMethod, Estimate
from .response import FRF
from .select import Auto
from .weighed import weighed

_BLOCK_BYTES = 8e8  # operating points are estimated in groups that need about this much memory
_ACCELERATED = 20  # times as much, on a GPU: to start a group takes longer than the arithmetic of a few points
_SHARED = 600  # windows of all operating points, from which on more than one core takes part
_FEW = 4  # times as many rows as channels, that mostly tell the rank
_WEAK = 1e-6  # power of a channel at a line, relative to its median line, that counts as almost none


@one_blas_thread
def estimate(
    data: Spectra | Experiment, method: AbstractMethod = Auto(), *, progress: Callable[[int, int], None] | None = None
) -> FRF:
    """Estimate the FRF from u to y at every operating point and excited line.

    **Arguments:**

    - `data`: spectra, e.g. from `jaxfrf.dft`; or a record, of which `jaxfrf.dft` then takes the mean steady period, or,
      where it is not periodic, `jaxfrf.record_spectra` the whole, for methods that can have a transient term (local
      ones and `jaxfrf.Auto`; see `jaxfrf.frf.adapted` for what becomes of them), and `jaxfrf.segment_spectra` segments
      for `jaxfrf.Welch`, as `jaxfrf estimate` does. Of a record the FRF is given with what it says of noise and
      distortion together, see `jaxfrf.with_distortion`.
    - `method`: e.g. `jaxfrf.LRM(order=2)`, `jaxfrf.LogMean()`, `jaxfrf.JointInputOutput(jaxfrf.LRM())`;
      `jaxfrf.Auto()` where none is given.
    - `progress`: called with (operating points done, of how many) after every group of them.

    **Returns:** a `jaxfrf.FRF`, with covariance, degrees of freedom and a status at every frequency. A frequency that
    cannot be estimated is marked there and never stops the others. Experiments whose noise differs by half or more are
    weighed by it, and `warnings` say so; with one period that needs more experiments than inputs, and intervals are
    too small where it cannot be told.

    **Raises:** `jaxfrf.InputError` if `data` is something else, or the method cannot be used on it (too few
    experiments, no reference, no period, a window that is too narrow, ...); `ValueError` if JAX is set to 32 bit.

    **Source:** as of the method; the default's is that of `jaxfrf.Auto`.
    """
    require_x64("estimate")
    if not isinstance(data, Experiment | Spectra):
        found, do = _instead(data)
        raise input_error("data", found, "jaxfrf.Spectra or a jaxfrf.Experiment", do)
    if not isinstance(method, AbstractMethod):
        raise wrong_kind("method", method, "a method, e.g. jaxfrf.LRM(order=2)", AbstractMethod)
    expect_callable("progress", progress)
    spectra = _spectra(data, method)
    method = adapted(method, spectra)
    method.check(spectra)
    _check_rank(spectra, method)
    as_measured = spectra
    looked = _everywhere(spectra, method, progress) if method.looks else None
    spectra, unequal = weighed(as_measured, method, None if looked is None else looked.alike)
    found = looked if looked is not None and spectra is as_measured else _everywhere(spectra, method, progress)
    whole = with_causes(found, spectra, method)
    status = whole.status | _excitation_status(as_measured, method)
    known = np.isfinite(whole.G)
    if not known.all():
        status = np.where(known.all(axis=(-2, -1)), status, status | int(Status.NOT_FINITE))
    serious = [text for text in describe(status & int(SERIOUS))]
    frf = FRF(
        G=whole.G,
        frequency=np.asarray(spectra.frequency),
        cov=whole.cov,
        dof=whole.dof,
        status=status,
        window=whole.window,
        cov_noise=whole.cov_noise,
        cov_total=whole.cov_total,
        bias=whole.bias,
        q=spectra.q,
        method=describe_method(method),
        y_quantity=spectra.y_quantity,
        u_unit=spectra.u_unit,
        y_unit=spectra.y_unit,
        sources=spectra.sources,
        warnings=(*spectra.warnings, *method.remarks(spectra), *unequal, *_of_rank(spectra, status), *serious),
        version=__version__,
    )
    if isinstance(data, Experiment) and spectra.periodic:  # segments have lines of their own
        return _with_distortion(frf, data)
    return frf


def _with_distortion(frf: FRF, data: Experiment) -> FRF:
    from .distortion import with_distortion  # whose room estimates, too

    return with_distortion(frf, data)


def _spectra(data: Experiment | Spectra, method: AbstractMethod) -> Spectra:
    if isinstance(data, Experiment):
        return spectra_of(data, method)
    return data


def _instead(data) -> tuple[str, str]:
    """What something else is, and how to come from there to what is needed."""
    items = list(data) if isinstance(data, list | tuple) else []
    first = items[0] if items else data
    several = f"a {type(data).__name__} of {len(items)}, the first " if items else ""
    if isinstance(first, str | os.PathLike):
        return f"{several}{str(first)!r}", "Read files with jaxfrf.io.read(path, ...), which takes several."
    if isinstance(first, Experiment):
        return f"{several}an Experiment", "Join records with jaxfrf.concatenate(records)."
    if isinstance(first, Spectra):
        return f"{several}Spectra", "Estimate them one by one, or join the records with jaxfrf.concatenate."
    if isinstance(first, FRF):
        return f"{several}an FRF", "It is estimated already."
    if hasattr(first, "shape"):
        kind = f"an array of shape {tuple(first.shape)}"
        return several + kind, "Make a record of the arrays: jaxfrf.Experiment(u, y, fs, period, r=r)."
    return f"{several}{type(first).__name__}", "Make one: jaxfrf.io.read(path), or jaxfrf.Experiment(u, y, fs, period)."


def describe_method(method: AbstractMethod) -> str:
    """A `method` and its options as text, e.g. `LogMean(method=LRM(order=2, width=34), elementwise=False)`.

    **Arguments:** `method`: any; what is no method gives its `repr`.

    **Returns:** the text, which `FRF.method` holds.
    """
    if not isinstance(method, AbstractMethod):
        return repr(method)
    options = ", ".join(f"{f.name}={describe_method(getattr(method, f.name))}" for f in dataclasses.fields(method))
    return f"{type(method).__name__}({options})"


def _threads(spectra: Spectra, method: AbstractMethod) -> int:
    """Programs that run at the same time."""
    return lapack_threads() if method.calls_lapack(spectra) else cores()


def _groups(spectra: Spectra, threads: int) -> list[np.ndarray]:
    """Operating points that are estimated together, as many for every thread: groups of one size, the last filled up
    with the last point, so that one compilation serves them."""
    if spectra.n_pos == 1:
        return [np.arange(1)]
    vec = spectra.n_in * spectra.n_out
    bytes_each = 16 * len(spectra.lines) * (4 * vec**2 + spectra.n_exp * 8 * (spectra.n_in + spectra.n_out) ** 2)
    accelerated = on_accelerator()
    available = _BLOCK_BYTES * (_ACCELERATED if accelerated else 1)
    n_group = -(-spectra.n_pos // max(1, int(available / bytes_each)))
    if spectra.n_pos * len(spectra.lines) > _SHARED and not accelerated:
        n_group = -(-n_group // threads) * threads
    size = -(-spectra.n_pos // n_group)
    last = spectra.n_pos - 1
    return [np.minimum(np.arange(i, i + size), last) for i in range(0, spectra.n_pos, size)]


def _part_count(spectra: Spectra, method: AbstractMethod, threads: int) -> int:
    """In how many parts the lines of a single operating point are shared out."""
    few = len(spectra.lines) * method.n_window(spectra) <= _SHARED
    alone = few or spectra.n_pos > 1 or method.looks or not method.shares_lines or on_accelerator()
    return 1 if alone else threads


def _estimates(spectra: Spectra, method: AbstractMethod, groups: list[np.ndarray], threads: int) -> Iterator[Estimate]:
    """The estimate of every group of operating points, in threads of their own once the program is compiled."""

    if len(groups) == 1:
        yield method.estimate(spectra, _part_count(spectra, method, threads))
        return

    def estimated(group):
        return method.estimate(select_positions(spectra, group))

    program = describe_method(method), spectra.U.shape[1:], len(groups[0])
    yield from of_one_program(estimated, groups, threads, program)


def _everywhere(spectra: Spectra, method: AbstractMethod, progress) -> Estimate:
    """The estimate at every operating point, group by group."""
    threads = _threads(spectra, method)
    groups = _groups(spectra, threads)
    stored = None
    for group, part in zip(groups, _estimates(spectra, method, groups, threads), strict=True):
        stored = _stored(stored, part, group, spectra.n_pos)
        if progress is not None:
            progress(int(group[-1]) + 1, spectra.n_pos)
    assert stored is not None  # there is no record without a position
    return stored


def _stored(whole: Estimate | None, part: Estimate, group, n_pos: int) -> Estimate:
    """The result of a group put in its place among those of all operating points."""
    if len(group) == n_pos:
        return part
    if whole is None:
        whole = jax.tree.map(lambda x: np.empty((n_pos, *x.shape[1:]), x.dtype), part)
    jax.tree.map(lambda every, x: every.__setitem__(group, x), whole, part)
    return whole


def _check_rank(spectra: Spectra, method: AbstractMethod) -> None:
    """Inputs that are copies of each other at every line cannot be told apart by any method; those that take several
    experiments at every line have looked at these."""
    n = spectra.n_in
    if n == 1 or method.block_size(spectra) > 1:
        return
    rank = _ranks(np.asarray(spectra.U).reshape(spectra.n_pos, -1, n))
    if rank.min() < n:
        pos = int(np.argmin(rank))
        raise input_error(
            "u",
            f"{n} inputs of which only {rank[pos]} are independent (rank of the excitation at position {pos})",
            "inputs that are excited independently of each other",
            "Excite with orthogonal or independent random phases, or leave out the channel that copies another.",
        )


def _of_rank(spectra: Spectra, status) -> tuple[str, ...]:
    """Why windows lose rank where the excitation does not: outputs that say the same are regressed on each other."""
    if not (status & int(Status.RANK_DEFICIENT)).any():
        return ()
    Y = np.asarray(spectra.Y).reshape(spectra.n_pos, -1, spectra.n_out)
    Y = Y[..., np.any(Y, axis=(0, 1))]  # others are dead, which screening says
    n = Y.shape[-1]
    rank = int(_ranks(Y).min()) if n > 1 else n
    if rank == n:
        return ()
    return (
        f"of {n} outputs only {rank} are independent, others copy them or add them up: windows that regress outputs on "
        "each other lose rank by that. G hardly suffers; leave those outputs out, or take lrm-miso.",
    )


def _ranks(X) -> np.ndarray:
    """The rank of every position's (row, channel), channels scaled: of its first rows, where these have full rank."""
    n = X.shape[-1]
    ranks = _ranks_of(X[:, : _FEW * n])
    lacking = ranks < n
    if lacking.any():
        ranks[lacking] = _ranks_of(X[lacking])
    return ranks


def _ranks_of(X) -> np.ndarray:
    size = np.linalg.norm(X, axis=1, keepdims=True)
    X = X / np.where(size > 0, size, 1.0)
    small = X if X.shape[1] <= _FEW * X.shape[2] else np.linalg.qr(X, mode="r")
    singular = np.linalg.svd(small, compute_uv=False)
    return (singular > DEPENDENT * singular[:, :1]).sum(axis=1)


def _excitation_status(spectra: Spectra, method: AbstractMethod) -> np.ndarray:
    """LOW_EXCITATION where a channel of u carries almost no power over all experiments, (pos, freq); of methods that
    take a line's neighbours, too, where none does: lines may be shared among channels (zippered designs)."""
    power = _power(np.asarray(spectra.U))
    if (power.min(axis=1) > _WEAK * power.max(axis=1)).all():
        return np.zeros(power.shape[:2], int)
    weak = power <= _WEAK * np.median(power, axis=1, keepdims=True)
    low = weak.any(axis=-1) if method.block_size(spectra) > 1 else weak.all(axis=-1)
    return np.where(low, int(Status.LOW_EXCITATION), 0)


def _power(X) -> np.ndarray:
    """Of (pos, exp, freq, channel), summed over experiments."""
    parts = np.ascontiguousarray(X, complex).view(float)
    squares = np.einsum("pefi,pefi->pfi", parts, parts)
    return squares[..., ::2] + squares[..., 1::2]
