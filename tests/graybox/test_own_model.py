"""A user's own gray-box model, a two-mass drive, on synthetic responses and on the records of a real bench.

G = motor speed / current = kt/(Z1 + Z2 Zc/(Z2 + Zc)), with Z1, Z2 the impedances of motor and load, Zc that of the
coupling, behind a delay and a first-order lag of the speed signal.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.graybox import free, model_quality, starting_at


class TwoMasses(eqx.Module):
    def __call__(self, omega, values):
        v, s = values, 1j * omega
        motor, load, coupling = v["J1"] * s + v["f1"], v["J2"] * s + v["f2"], v["k"] / s + v["d"]
        speed = v["kt"] / (motor + load * coupling / (load + coupling))
        return speed * jnp.exp(-s * v["delay"]) / (1 + s * v["lag"])


class StateSpace(eqx.Module):
    """The same with states motor speed, load speed, twist; both speeds are outputs."""

    def __call__(self, omega, values):
        v = values
        rows = [
            [-(v["d"] + v["f1"]) / v["J1"], v["d"] / v["J1"], -v["k"] / v["J1"]],
            [v["d"] / v["J2"], -(v["d"] + v["f2"]) / v["J2"], v["k"] / v["J2"]],
            [1.0, -1.0, 0.0],
        ]
        s = 1j * omega[:, None, None]
        torque = jnp.array([1.0, 0.0, 0.0])[:, None] * v["kt"] / v["J1"]
        x = jnp.linalg.solve(s * jnp.eye(3) - jnp.array(rows), jnp.broadcast_to(torque, (len(omega), 3, 1)))
        return x[:, :2] * jnp.exp(-s * v["delay"]) / (1 + s * v["lag"])


TRUTH = {
    "J1": 4.8e-4, "J2": 5.3e-4, "k": 58.0, "d": 6e-3, "f1": 8e-3, "f2": 4e-3, "kt": 0.1, "delay": 2e-4, "lag": 0.0
}  # fmt: skip


def parameters():
    """From guesses a factor of two away."""
    known = {
        name: jf.Parameter(2 * TRUTH[name] if i % 2 else TRUTH[name] / 2, spread=0.3)
        for i, name in enumerate(("J1", "J2", "k", "d", "f1", "f2"))
    }
    return known | {
        "kt": jf.Parameter(0.1, free=False),
        "delay": jf.Parameter(0.0, positive=False, scale=1e-3, spread=0.1),
        "lag": jf.Parameter(0.0, positive=False, scale=1e-3, free=False),
    }


def mechanics(v, frequency):
    """Both speeds over the current from the equations of motion, line by line, in NumPy: (1, freq, 2, 1)."""
    G = np.empty((1, len(frequency), 2, 1), complex)
    damper = v["d"] * np.array([[1, -1], [-1, 1]]) + np.diag([v["f1"], v["f2"]])
    for i, f in enumerate(frequency):
        s = 2j * np.pi * f
        stiffness = v["k"] * np.array([[1, -1], [-1, 1]])
        angles = np.linalg.solve(np.diag([v["J1"], v["J2"]]) * s**2 + damper * s + stiffness, [v["kt"], 0.0])
        G[0, i, :, 0] = s * angles * np.exp(-s * v["delay"])
    return G


def synthetic(values, outputs, noise=0.01, seed=0):
    rng = np.random.default_rng(seed)
    frequency = np.arange(11.0, 250.0, 3.0)
    G = mechanics(values, frequency)[:, :, :outputs]
    error = noise / np.sqrt(2) * (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape))
    cov = np.zeros((*G.shape[:2], outputs, outputs), complex)
    cov[..., range(outputs), range(outputs)] = (noise * np.abs(G[..., 0])) ** 2
    lines = G.shape[:2]
    return jf.FRF(
        G=G * (1 + error),
        frequency=frequency,
        cov=cov,
        dof=np.full(lines, 20.0),
        status=np.zeros(lines, int),
        window=np.ones(lines),
    )


def test_recovers_its_parameters():
    frf = synthetic(TRUTH, outputs=1)
    fit = jf.fit(jf.GrayBox(TwoMasses(), parameters()), frf, starts=6)
    assert fit.verdict == "unimodal"
    assert abs(fit.uncertainty.misfit - 1) < 0.3  # the covariance is that of the noise, the model is true
    for name, std in fit.std.items():
        assert abs(fit.values[name] - TRUTH[name]) < 4 * std
    relative = dict(zip(fit.coordinates.names, fit.uncertainty.std, strict=True))
    assert max(relative[n] for n in ("J1", "J2", "k")) < 0.02
    other = synthetic(TRUTH, outputs=1, seed=1)
    assert model_quality(fit, other, jf.Weights(focus=1.0)).cost < 0.1  # 1 % of noise beside a floor of 3 %


@pytest.mark.slow
def test_state_space_is_the_same_model():
    frf = synthetic(TRUTH, outputs=2, noise=0.0)
    model = starting_at(jf.GrayBox(StateSpace(), parameters()), TRUTH)
    values = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    response = lambda model: lambda values: model.response(frf.frequency, values, jnp.zeros(0))
    motor = jf.GrayBox(TwoMasses(), model.parameters)
    np.testing.assert_allclose(response(model)(values), frf.G[0], rtol=1e-9)
    both, one = (jax.jacfwd(response(m))(values) for m in (model, motor))
    for name in ("J1", "J2", "k", "d", "f1", "f2", "kt", "delay"):
        size = np.abs(one[name]).max()
        np.testing.assert_allclose(both[name][:, :1], one[name], rtol=1e-8, atol=1e-9 * size)


class Own(jf.AbstractModel):
    """A model with its `response`, its derivative left to autodiff."""

    drive: TwoMasses
    parameters: dict[str, jf.Parameter]

    def response(self, frequency, values, point):
        return self.drive(2 * jnp.pi * frequency, values)[:, None, None] * jnp.exp(values["J1"] * point["gain"])


def test_a_model_with_a_response():
    """Its operating points are what it likes: here a dictionary; its cost is a function as any other's."""
    frf, points = synthetic(TRUTH, outputs=1, noise=0.0), {"gain": np.array([30.0])}
    frf = dataclasses.replace(frf, G=frf.G * np.exp(TRUTH["J1"] * 30.0))
    model = Own(TwoMasses(), parameters())
    cost = jf.graybox.cost_function(model, frf, points=points)
    x = cost.coordinates.start()
    slope = [(cost(x + h) - cost(x - h)) / 2e-5 for h in 1e-5 * np.eye(len(x))]
    np.testing.assert_allclose(jax.grad(cost)(x), slope, rtol=1e-6, atol=1e-6 * np.abs(slope).max())
    fit = jf.fit(model, frf, starts=2, points=points, keep=None)
    for name in ("J1", "J2", "k", "d", "f1", "f2", "delay"):
        np.testing.assert_allclose(fit.values[name], TRUTH[name], rtol=1e-7)
    assert cost(fit.x) < 1e-12 * cost(x)


@pytest.mark.slow
def test_common_factor_is_named():
    """Without friction: kt, both inertias, stiffness and damping times the same number leave G as it is."""
    free_of_friction = TRUTH | {"f1": 0.0, "f2": 0.0}
    start = parameters() | {n: jf.Parameter(0.0, positive=False, free=False) for n in ("f1", "f2")}
    model = free(jf.GrayBox(TwoMasses(), start), ["kt"])
    fit = jf.fit(model, synthetic(free_of_friction, outputs=1), starts=4)
    assert fit.verdict == "not identifiable"
    said = [x for x in fit.explain() if x.startswith("only together")]
    assert len(said) == 1
    for name in ("kt", "J1", "J2", "k", "d"):
        assert f"{name} up" in said[0]
    assert not fit.uncertainty.identifiable[list(fit.coordinates.names).index("kt")]
    ratio = {n: fit.values[n] / fit.values["kt"] / (TRUTH[n] / TRUTH["kt"]) for n in ("J1", "J2", "k")}
    assert max(abs(x - 1) for x in ratio.values()) < 0.02


@pytest.mark.slow
@pytest.mark.data
def test_bench(measured):
    """The bench of `test_real_data.py`: antiresonance between its lines at 53 and 54 Hz (|G| is as small at both),
    resonance at 77 Hz, and a filtered speed signal, whose lag the encoder's angle shows without a model."""

    def estimate(kind, y="omega_max"):
        data = jf.io.read(
            measured / "two_mass_bench" / f"MultisineType{kind}.mat",
            names={"r": "iq_refx", "u": "iq_adx", "y": y},
            values={"fs": 2500, "period": 2500, "transient_periods": 1},
        )
        return jf.estimate(jf.select_band(jf.dft(data), 0, 150), jf.LRM(order=2))

    a, b, angle = estimate("A"), estimate("B"), estimate("A", "theta_mx")
    s = 2j * np.pi * a.frequency
    lag = np.median(((s * angle.G[0, :, 0, 0] / a.G[0, :, 0, 0] - 1) / s).real)
    guess = {"J1": 1e-3, "J2": 1e-3, "k": 100.0, "d": 1e-2, "f1": 1e-2, "f2": 1e-2, "lag": 5e-3}
    fit = jf.fit(starting_at(free(jf.GrayBox(TwoMasses(), parameters()), ["lag"]), guess), a, starts=5)
    v = fit.values
    assert abs(np.sqrt(v["k"] / v["J2"]) / (2 * np.pi) - 53.5) < 1
    assert abs(np.sqrt(v["k"] / v["J1"] + v["k"] / v["J2"]) / (2 * np.pi) - 77) < 1.5
    low, high = fit.interval()["lag"]
    assert low < lag < high and high / low < 1.5
    assert fit.uncertainty.misfit > 2 and any("residuals are" in x for x in fit.explain())  # friction distorts
    assert model_quality(fit, b, jf.Weights(focus=1.0)).cost < 2  # the record that it has not seen
