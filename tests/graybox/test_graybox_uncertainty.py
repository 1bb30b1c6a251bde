"""Monte Carlo: the 95 % intervals of gray-box fits cover the true parameters in 95 % of realisations.

Plants are linear. First the FRF's noise has a known covariance, then it comes from `jaxfrf.estimate` on noisy records,
where lines that share a window have correlated errors.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import plants
import pytest
import scipy.signal
import scipy.stats
from graybox_records import frf_of, noisy, random_covariance

import jaxfrf as jf
from jaxfrf.frf.overlap import overlaps
from jaxfrf.graybox import Coordinates
from jaxfrf.graybox.cost import Cost
from jaxfrf.graybox.fit import ELSEWHERE
from jaxfrf.graybox.solver import descend
from jaxfrf.graybox.target import target
from jaxfrf.graybox.uncertainty import uncertainty

LIKELIHOOD = jf.Weights(floor=0.0, off_diagonal=1.0, focus=1.0, correlated=True)
FALSE_ALARM = 1e-3


@dataclasses.dataclass(frozen=True)
class Trials:
    """Fits to many realisations: x, std in x (trial, parameter), truth (parameter,), cost, expected cost, misfit."""

    x: np.ndarray
    std: np.ndarray
    truth: np.ndarray
    bound: np.ndarray
    cost: np.ndarray
    expected: np.ndarray
    misfit: np.ndarray

    @property
    def coverage(self):
        return np.mean(np.abs(self.x - self.truth) < 1.959964 * self.std, axis=0)

    @property
    def rms(self):
        return np.sqrt(np.mean((self.x - self.truth) ** 2, axis=0))

    @property
    def bias(self):
        """Mean error over its standard deviation in one realisation."""
        return np.mean(self.x - self.truth, axis=0) / np.std(self.x, axis=0)

    def table(self):
        n = len(self.x)
        share = self.coverage
        return (
            f"covers {np.round(share, 3)} +- {np.sqrt(0.95 * 0.05 / n):.3f}, "
            f"rms/crlb {np.round(self.rms / self.bound, 3)}, "
            f"rms/std {np.round(self.rms / np.sqrt(np.mean(self.std**2, axis=0)), 3)}, bias {np.round(self.bias, 2)}, "
            f"cost/expected {np.mean(self.cost) / np.mean(self.expected):.3f}, misfit {np.mean(self.misfit):.3f}"
        )


def trials(model, frfs, weights, values):
    """One descent from the truth for every FRF; then what is known of each."""
    model = jf.graybox.starting_at(model, values)
    coordinates = Coordinates(model.parameters)
    truth = coordinates.start()
    targets = [target(frf, weights, model.points(frf.q, frf.n_pos)) for frf in frfs]
    ends = [
        descend(Cost(model, coordinates, tg), truth, jf.LevenbergMarquardt(max_steps=25), tolerance=1e-6)
        for tg in targets
    ]
    x = np.stack([end.x for end in ends])
    known = [uncertainty(model, coordinates, tg, xi) for tg, xi in zip(targets, x, strict=True)]
    return Trials(
        x=x,
        std=np.array([u.std for u in known]),
        truth=truth,
        bound=np.sqrt(np.mean([np.diagonal(u.crlb) for u in known], axis=0)),
        cost=np.array([u.cost for u in known]),
        expected=np.array([u.expected_cost for u in known]),
        misfit=np.array([u.misfit for u in known]),
    )


def motor(omega, values):
    """A motor with friction, and a spring to an arm of inertia 1.6: torque to speed, one channel."""
    s = 1j * omega
    spring, arm = values["k"] / s + values["d"], 1.6 * s + 0.05
    return (arm + spring) / ((s + values["f"]) * arm + spring * (s + values["f"] + arm))


SMALL = {"k": 120.0, "d": 0.4, "f": 0.6}
LINES = np.geomspace(0.5, 5.0, 30)


def two_by_two(omega, values):
    """Two such motors, coupled."""
    one, two = motor(omega, values), motor(omega, values | {"k": values["k2"]})
    c = values["c"]
    rows = [[one, c * (one + two)], [c * (two - 0.5 * one), two]]
    return jnp.moveaxis(jnp.array(rows), -1, 0)


TWO = SMALL | {"k2": 300.0, "c": 0.3}


def assert_honest(found, excess=1.2, coverage=(0.92, 0.98)):
    """Coverage of 92 to 98 % beyond what chance does to a correct 95 %, and rms errors near the bound."""
    n = len(found.x)
    tail = FALSE_ALARM / found.x.shape[1]
    low = scipy.stats.binom.ppf(tail, n, coverage[0]) / n
    high = scipy.stats.binom.isf(tail, n, coverage[1]) / n
    print(found.table())
    assert np.all((found.coverage >= low) & (found.coverage <= high)), found.table()
    assert excess is None or np.all(found.rms <= excess * found.bound), found.table()


class TestKnownCovariance:
    @pytest.mark.slow
    @pytest.mark.parametrize("size", [0.02, 0.1])
    def test_one_channel(self, size):
        rng = np.random.default_rng(0)
        G = np.asarray(motor(2 * np.pi * LINES, SMALL))[None, :, None, None]
        cov = (size * np.abs(G) * rng.uniform(0.5, 2.0, G.shape)) ** 2 + 0j
        model = jf.GrayBox(motor, SMALL)
        frfs = [frf_of(noisy(rng, G, cov), cov, LINES, None) for _ in range(400)]
        assert_honest(trials(model, frfs, LIKELIHOOD, SMALL))

    @pytest.mark.slow
    def test_two_channels(self):
        rng = np.random.default_rng(1)
        G = np.asarray(two_by_two(2 * np.pi * LINES, TWO))[None]
        cov = random_covariance(rng, G, 0.01)
        frfs = [frf_of(noisy(rng, G, cov), cov, LINES, None) for _ in range(400)]
        assert_honest(trials(jf.GrayBox(two_by_two, TWO), frfs, LIKELIHOOD, TWO))

    @pytest.mark.slow
    def test_other_weights(self):
        """Default weights are not the likelihood: the sandwich still covers, the bound is further away."""
        rng = np.random.default_rng(2)
        G = np.asarray(two_by_two(2 * np.pi * LINES, TWO))[None]
        cov = random_covariance(rng, G, 0.01)
        frfs = [frf_of(noisy(rng, G, cov), cov, LINES, None) for _ in range(400)]
        assert_honest(trials(jf.GrayBox(two_by_two, TWO), frfs, jf.Weights(), TWO), excess=None)


FS, PERIOD = 500.0, 8000
EXCITED = np.arange(145, 417, 4)  # 9 to 26 Hz; neighbours a fifth of a resonance's width apart
STIFF = {"k": 9.1e3, "d": 12.0, "f": 4.0}


def continuous(values, xp):
    """Deflection and both speeds; torque on the motor (inertia 1), friction .5 on the arm (inertia 1.6)."""
    k, d, f = values["k"], values["d"], values["f"]
    zero, one = 0.0 * k, 1.0 + 0.0 * k
    rows = [[zero, one, -one], [-k, -(d + f), d], [k / 1.6, d / 1.6, -(d + 0.5) / 1.6]]
    return xp.stack([xp.stack(row) for row in rows])


def held(omega, values):
    """Motor speed by torque, with the zero-order hold."""
    A = continuous(values, jnp)
    whole = jnp.zeros((4, 4)).at[:3, :3].set(A).at[1, 3].set(1.0)
    step = jax.scipy.linalg.expm(whole / FS)
    z = jnp.exp(1j * omega / FS)
    return jnp.linalg.solve(z[:, None, None] * jnp.eye(3) - step[:3, :3], step[:3, 3:][None] + 0j)[:, 1, 0]


def plant():
    A = continuous({n: np.float64(v) for n, v in STIFF.items()}, np)
    B, C = np.array([[0.0], [1.0], [0.0]]), np.array([[0.0, 1.0, 0.0]])
    A, B, C, _, _ = scipy.signal.cont2discrete((A, B, C, np.zeros((1, 1))), 1 / FS, method="zoh")
    loop = plants.Loop(A, B, C, np.array([15.0]), np.array([0.1]), FS)
    assert np.abs(loop.closed_loop_poles()).max() < 1
    return loop


def position_of(frf, i):
    cut = lambda a: None if a is None else np.asarray(a)[i : i + 1]
    names = ("G", "cov", "dof", "status", "window", "cov_noise", "cov_total")
    return dataclasses.replace(frf, **{n: cut(getattr(frf, n)) for n in names})


def from_records(method, n_exp, noise, weights, n=400):
    records = plants.steady_spectra(plant(), EXCITED, PERIOD, n_exp, n_pos=n, process_noise=noise, seed=3)
    np.testing.assert_allclose(held(2 * np.pi * records.frequency, STIFF), records.G[:, 0, 0], rtol=1e-9)
    frf = jf.estimate(records.spectra(), method)
    return trials(jf.GrayBox(held, STIFF), [position_of(frf, i) for i in range(n)], weights, STIFF)


METHODS = {
    "h1, 24 experiments": (jf.H1(), 24, 0.02),
    "h1, 6 experiments": (jf.H1(), 6, 0.02),
    "jio": (jf.JointInputOutput(jf.H1()), 24, 0.02),
    "lrm": (jf.LRM(order=2, width=12), 1, 0.02),
    "lrm-jio": (jf.JointInputOutput(jf.LRM(order=2, width=12)), 2, 0.02),
    "auto": (jf.Auto(), 2, 0.02),
}


class TestThroughRecords:
    """Rms errors are measured against the bound of the same FRFs: with windows that overlap it is approximate."""

    @pytest.mark.slow
    def test_few_degrees_of_freedom(self):
        """5: weights from such covariances scatter, which costs accuracy, and the covariance counts that."""
        method, n_exp, noise = METHODS["h1, 6 experiments"]
        found = from_records(method, n_exp, noise, LIKELIHOOD)
        assert_honest(found)
        np.testing.assert_allclose(np.mean(found.cost) / np.mean(found.expected), 1.0, atol=0.03)

    @pytest.mark.slow
    @pytest.mark.parametrize("name", METHODS)
    def test_coverage(self, name):
        method, n_exp, noise = METHODS[name]
        assert_honest(from_records(method, n_exp, noise, LIKELIHOOD))

    @pytest.mark.slow
    def test_windows_that_overlap(self):
        method, n_exp, noise = METHODS["lrm-jio"]
        assert_honest(from_records(method, n_exp, noise, LIKELIHOOD, n=200))


class TestMisfit:
    @pytest.mark.slow
    def test_wrong_model(self):
        """A ripple of 5 % that the model cannot follow, in an FRF good to 1 %."""
        G = np.asarray(motor(2 * np.pi * LINES, SMALL))[None, :, None, None]
        G = G * (1 + 0.05 * np.sin(8 * LINES))[None, :, None, None]
        found = jf.fit(jf.GrayBox(motor, SMALL), frf_of(G, 1e-4 * np.abs(G) ** 2 + 0j, LINES, None), starts=3)
        known = found.uncertainty
        assert known.misfit == found.cost / known.expected_cost
        assert 5 < known.misfit < 20  # about (.05^2 / 2) / 1e-4
        assert any("the model lacks something" in text for text in found.explain())

    @pytest.mark.parametrize(("ripple", "told"), [(0.2, True), (0.02, False)])
    def test_where_to_go_on(self, ripple, told):
        G = np.asarray(motor(2 * np.pi * LINES, SMALL))[None, :, None, None]
        G = G * (1 + ripple * np.sin(8 * LINES))[None, :, None, None]
        found = jf.fit(jf.GrayBox(motor, SMALL), frf_of(G, 1e-4 * np.abs(G) ** 2 + 0j, LINES, None), starts=1)
        assert found.explain().count(ELSEWHERE) == told


def test_overlap_is_that_of_the_fits_written_out():
    """Against a matrix of the weights of least squares, for windows narrow, wide, and at the ends of the band."""
    rng, n = np.random.default_rng(0), 60
    widths = rng.integers(1, n + 10, n)
    rows = np.zeros((n, n))
    for i, width in enumerate(np.clip(widths, 1, n)):
        first = np.clip(i - width // 2, 0, n - width)
        x = np.arange(first, first + width) - i
        rows[i, first : first + width] = np.linalg.pinv(x[:, None] ** np.arange(min(width, 3.0)))[0]
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    rho, x, some = rows @ rows.T, rng.standard_normal((n, 2)), np.arange(3, n, 7)
    (found,) = overlaps(widths[None] * 1.0)
    np.testing.assert_allclose(found @ x, rho @ x, atol=1e-9)
    np.testing.assert_allclose(found.row_sums(), rho.sum(axis=1), atol=1e-9)
    np.testing.assert_allclose(found.at(some) @ x[some], rho[np.ix_(some, some)] @ x[some], atol=1e-9)
    assert abs(found.sum_of_squares(np.ones(n)) / np.sum(rho**2) - 1) < 1e-9
    assert overlaps(np.ones((1, n))) is None
