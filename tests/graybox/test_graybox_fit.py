"""Gray-box fits against a NumPy cost, finite differences, SciPy's least squares and known parameters."""

import dataclasses
import functools
import tomllib

import equinox as eqx
import graybox_reference as reference
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import plants
import pytest
import scipy.optimize
from graybox_records import ARMS, FREQUENCY, frf_of, noisy, random_covariance
from two_axes import ROBOT

import jaxfrf as jf
from jaxfrf.frf.scatter import scatter
from jaxfrf.graybox import Coordinates, focus_band, share
from jaxfrf.graybox.cost import Cost
from jaxfrf.graybox.target import select, shifted, target

TRUE = {"k": 120.0, "d": 0.4, "f": 0.6, "tau": 3e-3}


def two_mass(omega, values, q):
    """The same two masses as in the reference, by an impedance network, in jax.numpy."""
    s = 1j * omega
    spring = values["k"] / s + values["d"]
    motor, arm = s + values["f"], 1.6 * (1 + 0.3 * q[0]) * s + 0.05
    late = jnp.exp(-s * values["tau"])
    # Mobilities of two impedances joined by a third.
    total = motor * arm + spring * (motor + arm)
    rows = [[(arm + spring) / total * late, spring / total], [spring / total * late, (motor + spring) / total]]
    return jnp.moveaxis(jnp.array(rows), -1, 0)


def drive(**changes):
    known = {
        "k": jf.Parameter(100.0, "N m/rad"),
        "d": jf.Parameter(0.5, "N m s/rad", spread=1.0),
        "f": jf.Parameter(0.5, "N m s/rad", spread=1.0),
        "tau": jf.Parameter(1e-3, "s", positive=False, scale=1e-2, spread=0.2),
    }
    return jf.GrayBox(two_mass, known | changes)


def gram(model, coordinates, tg, x):
    return np.asarray(Cost(model, coordinates, tg).gram(jnp.asarray(x)))


def true_response(values=TRUE, frequency=FREQUENCY, q=ARMS):
    omega = 2 * np.pi * np.asarray(frequency)
    return np.stack([reference.two_mass(omega, values, 1.6 * (1 + 0.3 * float(qi[0]))) for qi in q])


@pytest.fixture(scope="module")
def measured():
    rng = np.random.default_rng(0)
    G = true_response()
    cov = random_covariance(rng, G, 0.1)
    return frf_of(noisy(rng, G, cov), cov)


def response_by_x(model, frf, points=None):
    """x -> G (pos, freq, out, in), by the NumPy network where the model is the two masses."""
    coordinates = Coordinates(model.parameters)

    def response(x):
        values = {n: float(v) for n, v in coordinates.values(x).items()}
        return true_response(values, frf.frequency, frf.q)

    return response


def assert_same_equations(model, frf, weights, rule, x, response=None, atol=1e-7):
    """Cost to rounding; gradient and Gauss-Newton matrix to the accuracy of central differences."""
    coordinates = Coordinates(model.parameters)
    tg = target(frf, weights, model.points(frf.q, frf.n_pos))
    full = gram(model, coordinates, tg, x)
    W = reference.weight_matrices(rule, np.asarray(frf.G), np.asarray(frf.cov), frf.frequency)
    response = response_by_x(model, frf) if response is None else response
    V, gradient, hessian = reference.normal_equations(W, np.asarray(frf.G), response, x)
    np.testing.assert_allclose(full[-1, -1], V, rtol=1e-9)
    scale = np.sqrt(np.diagonal(hessian))
    np.testing.assert_allclose(full[:-1, :-1], hessian, atol=atol * np.outer(scale, scale).max())
    np.testing.assert_allclose(full[-1, :-1] / scale, gradient / scale, atol=atol * np.sqrt(V))
    assert np.array_equal(np.asarray(tg.used), np.real(np.einsum("pfvv->pfv", W)) > 0)
    return tg, W


@functools.cache
def linear_r3x():
    robot = jf.robot.r3x()
    ratios = jf.robot.parameters(robot, ("stiffness_ratio",))
    soft = {"joint1.stiffness": 4.74e5, "joint2.stiffness": 3.53e5, "joint3.stiffness": 2.09e5}
    return jf.robot.with_parameters(robot, dict.fromkeys(ratios, 1.0) | soft)


@functools.cache
def positions(n):
    return np.asarray(jf.random_positions(n, jr.key(5)))


def robot_frf(robot, q, frequency, friction):
    """By linearisation and one solve, not by the outer products of the model's Jacobian."""
    state = jf.robot.linearise(robot, jf.robot.operating_point(robot, q), jnp.asarray(friction))
    hold = jf.robot.ZeroOrderHold(robot.sampling_frequency, "position")
    return jf.robot.frf(state, frequency, "acceleration", hold)


def friction_of(model):
    return [model.parameters[f"{axis}.effective_friction"].start for axis in model.robot.axis_names]


X = np.array([0.1, -0.3, 0.2, 0.05]) + np.array([np.log(100), np.log(0.5), np.log(0.5), 0.1])
CASES = {
    "plain": (jf.Weights(focus=1), reference.Rule()),
    "floor and off-diagonal": (
        jf.Weights(focus=1, floor=0.1, off_diagonal=0.7),
        reference.Rule(floor=0.1, off_diagonal=0.7),
    ),
    "reject": (jf.Weights(focus=1, reject=0.01), reference.Rule(reject=0.01)),
    "elements": (
        jf.Weights(focus=1, elements=np.array([[1.0, 0.0], [0.3, 2.0]])),
        reference.Rule(elements=np.array([[1.0, 0.0], [0.3, 2.0]])),
    ),
    "bands": (
        jf.Weights(focus=1, bands=((1.0, 2.0, 0.0), (3.0, 5.0, 2.5))),
        reference.Rule(bands=((1.0, 2.0, 0.0), (3.0, 5.0, 2.5))),
    ),
    "correlated": (
        jf.Weights(focus=1, off_diagonal=1.0, correlated=True),
        reference.Rule(off_diagonal=1.0, correlated=True),
    ),
    "correlated, user weights, reject": (
        jf.Weights(focus=1, correlated=True, reject=0.015, bands=((1.0, 2.0, 0.5),)),
        reference.Rule(correlated=True, reject=0.015, bands=((1.0, 2.0, 0.5),)),
    ),
}


class TestCost:
    @pytest.mark.parametrize("case", CASES)
    def test_two_masses(self, measured, case):
        weights, rule = CASES[case]
        tg, _ = assert_same_equations(drive(), measured, weights, rule, X)
        assert tg.used.any() and (case in ("plain", "correlated") or "floor" in case or not tg.used.all())

    def test_focus_bands(self, measured):
        bands = [[focus_band(measured, axis, pos) for axis in range(2)] for pos in range(2)]
        # An antiresonance of motor speed over motor torque: the arm on its spring, k / arm; the resonance with both.
        for pos, arm in enumerate((1.6, 1.6 * 1.24)):
            low, high = np.sqrt(120 / arm) / 2 / np.pi, np.sqrt(120 * (1 + 1 / arm)) / 2 / np.pi
            step = FREQUENCY[1] / FREQUENCY[0]
            assert (
                1 / step < bands[pos][0][0] / (0.8 * low) < step and 1 / step < bands[pos][0][1] / (1.25 * high) < step
            )
        own = np.zeros((2, len(FREQUENCY), 2, 2))
        for pos in range(2):
            for axis in range(2):
                low, high = bands[pos][axis]
                own[pos, (FREQUENCY >= low) & (FREQUENCY <= high), axis, axis] = 1
        plain = target(measured, jf.Weights(focus=1), ARMS)
        focused = target(measured, jf.Weights(focus=4), ARMS)
        np.testing.assert_allclose(focused.magnitude**2, plain.magnitude**2 * (1 + 3 * reference.vec(own)), rtol=1e-12)

    def test_uncertainty_that_is_not_known_or_endless(self, measured):
        G, cov = np.array(measured.G), np.array(measured.cov)
        G[0, 3], G[0, 4, 0, 1], G[1, 5, 1, 1] = np.nan, np.nan, 0.0
        cov[0, 3] = np.nan
        cov[0, 7, 2, :], cov[0, 7, :, 2] = np.inf, np.inf
        frf = dataclasses.replace(measured, G=G, cov=cov)
        tg, _ = assert_same_equations(drive(), frf, jf.Weights(focus=1), reference.Rule(), X)
        assert not tg.used[0, 3].any() and not tg.used[0, 4, 2] and not tg.used[1, 5, 3] and not tg.used[0, 7, 2]
        assert tg.used[0, 7, [0, 1, 3]].all()

    def test_no_covariance_at_all(self):
        """Methods without residual degrees of freedom say NaN: lines that scatter count less, whatever scatters."""
        rng, frequency = np.random.default_rng(8), np.sort(np.random.default_rng(9).uniform(1.0, 4.0, 300))
        G = (1.0 + 0.2j) * np.ones((1, 300, 2, 2)) * (1 + 0.1 * frequency)[:, None, None]  # straight, unevenly spaced
        size = np.array([[0.02, 0.1], [0.2, 1e-6]])
        noisy = G + np.abs(G) * size * plants.circular(rng, G.shape)
        vec = reference.vec(noisy)[0]
        found = (scatter(frequency, vec) / np.abs(vec))[None] ** 2
        np.testing.assert_allclose(found.mean(axis=1)[0], reference.vec(size**2), rtol=0.15)
        assert np.all(scatter(frequency, reference.vec(G)[0]) < 1e-14)
        assert not scatter(frequency[:2], vec[:2]).any()
        frf = frf_of(noisy, np.full((1, 300, 4, 4), np.nan + 0j), frequency, None)
        tg = target(frf, jf.Weights(focus=1, off_diagonal=1.0), np.zeros((1, 0)))
        np.testing.assert_allclose(tg.magnitude**2, 1 / (found + 0.03**2), rtol=1e-12)
        np.testing.assert_allclose(np.diagonal(tg.cov, axis1=-2, axis2=-1), found, rtol=1e-12)

    @pytest.mark.slow
    def test_deviations_without_a_covariance(self):
        """The scatter of neighbouring lines stands in for it, where the response is smooth between them."""
        rng, frequency = np.random.default_rng(3), np.linspace(1.0, 40.0, 400)
        s = 2j * np.pi * frequency
        G = 1 / (2.0 * s + 30.0) * (1 + 0.02 * plants.circular(rng, s.shape))
        model = jf.GrayBox(lambda w, v: 1 / (v["J"] * 1j * w + v["f"]), {"J": 1.5, "f": 40.0})
        std = []
        for known in (1.0, np.nan):
            cov = (0.02 * np.abs(G)) ** 2 * known
            frf = frf_of(G[None, :, None, None], cov[None, :, None, None] + 0j, frequency, None)
            std.append(jf.fit(model, frf, starts=2, weights=jf.Weights(floor=0.0)).std)
        for name in ("J", "f"):
            assert 0.8 < std[1][name] / std[0][name] < 1.25

    def test_one_line_one_position_one_channel(self, measured):
        """A callable of omega and values, and an FRF of one number."""
        model = jf.GrayBox(lambda w, v: 1 / (v["J"] * 1j * w + v["f"]), {"J": 2.0, "f": 0.3})
        frf = frf_of([[[[0.1 - 0.2j]]]], np.array([[[[1e-4]]]]), np.array([0.7]), None)
        coordinates = Coordinates(model.parameters)
        tg = target(frf, jf.Weights(), model.points(None, 1))
        g = 1 / (2.0 * 2j * np.pi * 0.7 + 0.3)
        e = np.log((0.1 - 0.2j) / g)
        w = 1 / (1e-4 / 0.05 + 0.03**2)
        full = gram(model, coordinates, tg, coordinates.start())
        np.testing.assert_allclose(full[-1, -1], w * abs(e) ** 2, rtol=1e-12)
        slope = np.array([2.0 * 2j * np.pi * 0.7 * g, 0.3 * g])  # of e = -log g by ln J, ln f
        np.testing.assert_allclose(full[-1, :-1], w * np.real(slope.conj() * e), rtol=1e-10)

    def test_phase_is_continuous_through_half_a_turn(self):
        """G_hat and G on both sides of the negative real axis: the ratio is near 1, the difference of angles is not."""
        model = jf.GrayBox(lambda w, v: -v["g"] * jnp.exp(1j * v["phi"]) * jnp.ones_like(w), {
            "g": 1.0, "phi": jf.Parameter(0.01, positive=False)})  # fmt: skip
        frf = frf_of(np.full((1, 2, 1, 1), -np.exp(-0.01j)), frequency=np.array([1.0, 2.0]), q=None)
        tg = target(frf, jf.Weights(), model.points(None, 1))
        E, _ = Cost(model, Coordinates(model.parameters), tg).errors(jnp.array([0.0, 0.01]))
        np.testing.assert_allclose(E, -0.02j, atol=1e-12)

    @pytest.mark.slow
    def test_elements_of_the_model_that_are_zero_do_not_matter_where_nothing_is_measured(self):
        """Decoupled axes: the off-diagonal elements are noise in the data and exactly 0 in the model."""

        def apart(w, v):
            own = 1 / (1j * w + v["f"])
            return own[:, None, None] * jnp.eye(2)

        model = jf.GrayBox(apart, {"f": 0.3})
        G = np.asarray(apart(2 * np.pi * FREQUENCY, {"f": 0.5}))[None] + 1e-9 * (1 - np.eye(2))
        cov = 1e-12 * np.eye(4) * np.ones((1, 24, 1, 1))
        for weights in (jf.Weights(), jf.Weights(off_diagonal=0.0), jf.Weights(correlated=True)):
            found = jf.fit(model, frf_of(G, cov, q=None), weights=weights, starts=2)
            np.testing.assert_allclose(found.values["f"], 0.5, rtol=1e-9)
            assert np.isfinite(found.uncertainty.cov).all()

    @pytest.mark.slow
    def test_channels_in_another_order(self, measured):
        """Swapping the channels of data and model changes nothing, with any weights."""

        def swapped(omega, values, q):
            return two_mass(omega, values, q)[:, ::-1, ::-1]

        order = np.array([3, 2, 1, 0])
        G, cov = np.asarray(measured.G)[:, :, ::-1, ::-1], np.asarray(measured.cov)[:, :, order][..., order]
        other = dataclasses.replace(measured, G=G, cov=cov)
        coordinates = Coordinates(drive().parameters)
        for weights in (jf.Weights(correlated=True), jf.Weights()):
            one = gram(drive(), coordinates, target(measured, weights, ARMS), X)
            two = gram(jf.GrayBox(swapped, drive().parameters), coordinates, target(other, weights, ARMS), X)
            np.testing.assert_allclose(two, one, rtol=1e-9, atol=1e-9)

    def test_shift(self, measured):
        """What is added to the model is taken from the measurement; where it is not finite nothing counts."""
        rng = np.random.default_rng(3)
        factor = np.exp(plants.circular(rng, np.asarray(measured.G).shape))
        weights = jf.Weights(focus=1)
        tg = target(measured, weights, ARMS)
        shift = np.log(reference.vec(factor))
        found = gram(drive(), Coordinates(drive().parameters), shifted(tg, shift, ARMS), X)
        W = np.square(np.asarray(tg.magnitude))
        coordinates = Coordinates(drive().parameters)
        values = {n: float(v) for n, v in coordinates.values(X).items()}
        e = np.log(reference.vec(np.asarray(measured.G)) / reference.vec(true_response(values) * factor))
        np.testing.assert_allclose(found[-1, -1], np.sum(W * np.abs(e) ** 2), rtol=1e-9)
        shift[0, 3, 1] = np.nan
        left = gram(drive(), coordinates, shifted(tg, shift, ARMS), X)
        np.testing.assert_allclose(left[-1, -1], np.sum(W * np.abs(e) ** 2) - (W * np.abs(e) ** 2)[0, 3, 1], rtol=1e-9)

    @pytest.mark.slow
    def test_parts_of_a_target_add_up(self, measured):
        tg = target(measured, jf.Weights(correlated=True), ARMS)
        model, coordinates = drive(), Coordinates(drive().parameters)
        whole = gram(model, coordinates, tg, X)
        for parts in (
            [select(tg, positions=[p]) for p in (0, 1)],
            [select(tg, lines=range(i, 24, 3)) for i in range(3)],
        ):
            np.testing.assert_allclose(sum(gram(model, coordinates, p, X) for p in parts), whole, rtol=1e-9, atol=1e-9)

    @pytest.mark.slow
    @pytest.mark.parametrize("axes", [2, 6])
    @pytest.mark.parametrize("kind", ["gains", "correlated", "springs alone"])
    def test_robot(self, kind, axes):
        """A robot against its linearised FRF, differenced: stiffness, damping, friction, gain and delay.

        Without gain and delay an element and its mirror image share their slopes, not their weights."""
        robot = linear_r3x() if axes == 6 else jf.robot.robot_from_table(tomllib.loads(ROBOT))
        q, late = positions(2)[:, :axes], axes - 2
        gain, delay = f"{robot.axis_names[1]}.torque_gain", f"{robot.axis_names[late]}.delay"
        frequency = np.geomspace(8.0, 60.0, 5)
        model = jf.RobotModel(robot)
        if kind != "springs alone":
            model = jf.graybox.free(model, [gain, delay])
        coordinates = Coordinates(model.parameters)
        assert model.reciprocal(coordinates.names) == (kind == "springs alone")
        rng = np.random.default_rng(1)
        x = coordinates.start() + 0.2 * rng.standard_normal(coordinates.size)
        G = np.asarray(robot_frf(robot, q, frequency, friction_of(model)))
        cov = random_covariance(rng, G, 0.02)
        frf = frf_of(noisy(rng, G, cov), cov, frequency, q)

        def response(x):
            v = coordinates.values(x)
            changed = model.at(v)
            friction = [v[f"{a}.effective_friction"] for a in robot.axis_names]
            G = np.array(robot_frf(changed, q, frequency, friction))
            G[..., 1] *= float(v[gain])
            G[..., late] *= np.exp(-2j * np.pi * frequency * float(v[delay]))[:, None]
            return G

        options = {"correlated": kind == "correlated", "floor": 0.05}
        if kind == "springs alone":
            variance = np.real(np.einsum("pfvv->pfv", reference.relative_covariance(np.asarray(frf.G), cov)))
            options |= {
                "elements": rng.random((axes, axes)) * (rng.random((axes, axes)) > 0.2),
                "reject": np.median(variance),
            }
        weights, rule = jf.Weights(focus=1, **options), reference.Rule(**options)
        tg, _ = assert_same_equations(model, frf, weights, rule, x, response, atol=1e-5)
        square = np.asarray(tg.used).reshape(2, 5, axes, axes)
        assert (square != square.swapaxes(-1, -2)).any() == (kind == "springs alone")


def differences(f, x, step=1e-5):
    """df/dx by central differences, the parameter last."""
    return np.stack([(f(x + h) - f(x - h)) / (2 * step) for h in step * np.eye(len(x))], axis=-1)


@pytest.fixture(scope="module", params=["plain", pytest.param("correlated", marks=pytest.mark.slow)])
def both(request, measured):
    """The cost, and that of the NumPy network."""
    weights, rule = CASES[request.param]
    cost = jf.graybox.cost_function(drive(), measured, weights)
    W = reference.weight_matrices(rule, np.asarray(measured.G), np.asarray(measured.cov), measured.frequency)
    response = response_by_x(drive(), measured)
    return cost, lambda x: reference.cost(W, np.asarray(measured.G), response(x))


class TestCostFunction:
    """The cost as JAX sees it: its derivatives by autodiff against differences of the NumPy cost."""

    def test_value_and_gradient(self, both):
        cost, expected = both
        np.testing.assert_allclose([cost(X), jax.jit(cost)(X)], expected(X), rtol=1e-10)
        slope = differences(expected, X)
        np.testing.assert_allclose(jax.grad(cost)(X), slope, rtol=1e-6, atol=1e-6 * np.abs(slope).max())

    def test_hessian(self, both):
        """Not the Gauss-Newton matrix: the errors at X are large."""
        cost, expected = both
        curvature = differences(lambda x: differences(expected, x, 1e-4), X, 1e-4)
        found = np.asarray(jax.jit(jax.hessian(cost))(X))
        np.testing.assert_allclose(found, curvature, rtol=1e-4, atol=1e-5 * np.abs(curvature).max())
        part = 2 * np.asarray(cost.gram(X))[:-1, :-1]
        assert np.abs(part - found).max() > 1e-2 * np.abs(found).max()

    def test_many_at_once(self, both):
        cost, expected = both
        several = X + 0.2 * np.random.default_rng(6).standard_normal((5, len(X)))
        np.testing.assert_allclose(jax.vmap(cost)(several), [expected(x) for x in several], rtol=1e-10)
        slopes = jax.jit(jax.vmap(jax.grad(cost)))(several)
        np.testing.assert_allclose(slopes[3], jax.grad(cost)(several[3]), rtol=1e-10)

    @pytest.mark.slow
    def test_robot(self):
        """A robot's own derivative, taken backwards."""
        cost, x, expected = self.robot()
        np.testing.assert_allclose([cost(x), jax.jit(cost)(x)], expected(x), rtol=1e-9)
        slope = differences(expected, x)
        np.testing.assert_allclose(jax.grad(cost)(x), slope, rtol=1e-5, atol=1e-5 * np.abs(slope).max())

    @pytest.mark.slow
    def test_robot_beyond(self):
        """To second order, and in what that derivative was not written for."""
        cost, x, expected = self.robot()
        along, gradient = np.random.default_rng(2).standard_normal(len(x)), jax.grad(cost)
        curved = (np.asarray(gradient(x + 1e-5 * along)) - np.asarray(gradient(x - 1e-5 * along))) / 2e-5
        found = jax.jit(lambda x, v: jax.jvp(gradient, (x,), (v,))[1])(x, along)
        np.testing.assert_allclose(found, curved, rtol=1e-5, atol=1e-6 * np.abs(curved).max())
        q = np.asarray(cost.points)
        elsewhere = lambda q: eqx.tree_at(lambda c: c.points, cost, q)(x)
        turned = differences(lambda angles: expected(x, angles[None]), q[0])
        np.testing.assert_allclose(jax.jacfwd(elsewhere)(jnp.asarray(q))[0], turned, rtol=1e-5)

    @staticmethod
    def robot():
        """The cost of two axes, a place away from its minimum, and the cost by linearisation, solve and NumPy."""
        robot = jf.robot.robot_from_table(tomllib.loads(ROBOT))
        model, frequency = jf.RobotModel(robot), np.geomspace(8.0, 60.0, 4)
        at = positions(1)[:, :2]
        G = np.asarray(robot_frf(robot, at, frequency, friction_of(model)))
        frf = dataclasses.replace(frf_of(G, frequency=frequency, q=at), y_quantity=model.quantity)
        cost = jf.graybox.cost_function(model, frf, jf.Weights(focus=1))
        W = reference.weight_matrices(reference.Rule(), G, np.zeros((1, 4, 4, 4)), frequency)

        def expected(x, q=at):
            v = cost.coordinates.values(x)
            friction = [v[f"{a}.effective_friction"] for a in robot.axis_names]
            return reference.cost(W, G, np.asarray(robot_frf(model.at(v), q, frequency, friction)))

        change = 0.1 * np.random.default_rng(1).standard_normal(cost.coordinates.size)
        return cost, cost.coordinates.start() + change, expected

    def test_what_does_not_fit_together(self, measured):
        with pytest.raises(jf.InputError, match="points"):
            jf.graybox.cost_function(drive(), measured, points=np.zeros((3, 1)))


def series(omega, values):
    """Two springs in series between motor and arm: only their common compliance can be seen."""
    k = 1 / (1 / values["k1"] + 1 / values["k2"])
    s = 1j * omega
    spring, arm = k / s + values["d"], 1.6 * s + 0.05
    return (arm + spring) / (s * arm + spring * (s + arm)) * jnp.ones_like(s)


def late_twice(omega, values):
    """exp(-s tau): a fit of the phase alone has many minima, one for every turn."""
    return jnp.exp(-1j * omega * values["tau"]) / (1 + 1j * omega / values["corner"])


class TestFit:
    def test_true_parameters_from_every_start(self):
        found = jf.fit(drive(), frf_of(true_response()), starts=10, keep=None)
        assert found.verdict == "unimodal" and found.close_starts == 10
        for start in found.starts:
            np.testing.assert_allclose(start.x, found.x, atol=1e-8)
        for name, value in TRUE.items():
            np.testing.assert_allclose(found.values[name], value, rtol=1e-8)

    @pytest.mark.parametrize("correlated", [False, True])
    def test_the_optimum_of_scipy(self, measured, correlated):
        off = 1.0 if correlated else 0.2
        weights = jf.Weights(focus=1, off_diagonal=off, correlated=correlated)
        found = jf.fit(drive(), measured, weights=weights, starts=3)
        rule = reference.Rule(off_diagonal=off, correlated=correlated)
        W = reference.weight_matrices(rule, np.asarray(measured.G), np.asarray(measured.cov), measured.frequency)
        response = response_by_x(drive(), measured)
        cost = lambda x: reference.residuals(W, np.asarray(measured.G), response(x))
        start = Coordinates(drive().parameters).start()
        best = scipy.optimize.least_squares(cost, start, jac="3-point", xtol=1e-12, ftol=1e-15, gtol=1e-12)
        np.testing.assert_allclose(found.x, best.x, atol=1e-6)
        np.testing.assert_allclose(found.cost, 2 * best.cost, rtol=1e-9)
        np.testing.assert_allclose(found.uncertainty.information, best.jac.T @ best.jac, rtol=1e-4, atol=1e-2)

    @pytest.mark.slow
    def test_bfgs_ends_where_levenberg_marquardt_does(self, measured):
        one = jf.fit(drive(), measured, starts=1)
        two = jf.fit(drive(), measured, starts=1, solver=jf.BFGS())
        assert two.starts[0].converged
        np.testing.assert_allclose(two.cost, one.cost, rtol=1e-9)
        np.testing.assert_allclose(two.x, one.x, atol=1e-5)

    def test_paths(self, measured):
        values = [{}, {"k": 80.0, "tau": 5e-3}, {"d": 2.0, "f": 0.1}]
        for keep in (None, 5, 1):
            found = jf.fit(drive(), measured, starts=values, keep=keep)
            for start, begin in zip(found.starts, values, strict=True):
                for name, expected in ({n: p.start for n, p in drive().parameters.items()} | begin).items():
                    at = {n: float(v) for n, v in found.coordinates.values(start.path_x[0]).items()}
                    np.testing.assert_allclose(at[name], expected, rtol=1e-12)
                assert np.all(np.diff(start.path_cost) <= 1e-9 * start.path_cost[:-1])
                np.testing.assert_allclose(start.path_cost[-1], start.cost, rtol=1e-9)
                np.testing.assert_array_equal(start.path_x[-1], start.x)
                assert len(start.path_x) == len(start.path_cost) and start.converged
            assert [s.polished for s in found.starts] == [True] * 3
            tg = target(measured, jf.Weights(), ARMS)
            for x, cost in zip(found.starts[1].path_x, found.starts[1].path_cost, strict=True):
                np.testing.assert_allclose(gram(drive(), found.coordinates, tg, x)[-1, -1], cost, rtol=1e-9)

    @pytest.mark.slow
    def test_paths_of_a_search_on_a_part_of_the_lines(self):
        frequency = np.linspace(0.5, 8.0, 200)
        frf = frf_of(true_response(TRUE, frequency, ARMS[:1]), frequency=frequency, q=ARMS[:1])
        frf = dataclasses.replace(frf, G=frf.G * 1.05 ** np.random.default_rng(2).standard_normal(frf.G.shape))
        found = jf.fit(drive(), frf, starts=3)
        for start in found.starts:
            np.testing.assert_allclose(start.path_cost[-1], start.cost, rtol=1e-9)
            np.testing.assert_array_equal(start.path_x[-1], start.x)

    def test_several_minima(self):
        model = jf.GrayBox(late_twice, {
            "tau": jf.Parameter(0.01, positive=False, scale=1e-2, spread=60.0), "corner": 3.0})  # fmt: skip
        f = np.arange(20.0, 24.0, 0.25)  # a narrow band: delays that differ by 1/22 s look nearly alike
        G = late_twice(2 * np.pi * f, {"tau": 0.01, "corner": 5.0})[None, :, None, None]
        frf = frf_of(G, np.full((1, len(f), 1, 1), 1e-6), f, None)
        found = jf.fit(model, frf, starts=[{"tau": t} for t in (0.01, 0.055, 0.1, 0.19, 0.28)])
        assert found.verdict == "multimodal" and found.close_starts == 1
        np.testing.assert_allclose(found.values["tau"], 0.01, rtol=1e-6)
        assert any("only 1 of 5 starts" in text for text in found.explain())

    @pytest.mark.slow
    def test_bound_that_the_data_ask_to_cross(self):
        held = jf.Parameter(100.0, bounds=(90.0, 110.0))
        frf = frf_of(true_response())
        found = jf.fit(drive(k=held), frf, starts=8)
        assert found.verdict == "at a bound" and found.coordinates.at_bound(found.x) == ("k",)
        assert 105 < found.values["k"] <= 110
        assert any("k is at its bound" in text for text in found.explain())

    def test_bounds_with_the_optimum_inside(self):
        """Starts drawn far beyond a bound are brought back, and the bound leaves no trace."""
        held = {"k": jf.Parameter(100.0, bounds=(80.0, 150.0)), "d": jf.Parameter(0.5, bounds=(0.25, 1.0), spread=2.0)}
        found = jf.fit(drive(**held), frf_of(true_response()), starts=10, keep=None)
        assert found.verdict == "unimodal" and found.close_starts == 10
        for name, value in TRUE.items():
            np.testing.assert_allclose(found.values[name], value, rtol=1e-8)

    @pytest.mark.parametrize("start", [-3.0, 0.0, 1e-9, 2.0, 4.999, 5.0])
    def test_a_parameter_with_bounds_starts_where_it_is_told(self, start):
        """Away from the corner (2 % of the range) exactly, inside it at least within the bounds."""
        p = jf.Parameter(2.0, positive=False, bounds=(-3.0, 5.0), scale=2.0)
        at = float(p.value(p.coordinate(start)))
        assert -3.0 < at < 5.0
        np.testing.assert_allclose(at, start, atol=1e-12 if -2.9 < start < 4.9 else 0.1)

    @pytest.mark.slow
    def test_parameter_without_effect(self, measured):
        model = drive(colour=jf.Parameter(3.0))
        found = jf.fit(model, measured, starts=2)
        assert found.without_sensitivity == ("colour",) and "colour" not in found.coordinates.names
        assert found.values["colour"] == 3.0 and found.verdict == "not identifiable"
        assert found.explain()[0] == "colour has no effect on the response: it was left at its start"

    @pytest.mark.slow
    def test_springs_in_series(self):
        model = jf.GrayBox(series, {"k1": 200.0, "k2": 300.0, "d": 0.5})
        G = np.asarray(series(2 * np.pi * FREQUENCY, {"k1": 150.0, "k2": 600.0, "d": 0.4}))[None, :, None, None]
        found = jf.fit(model, frf_of(G, 1e-4 * np.abs(G) ** 2 + 0j, q=None), starts=3)
        values = found.values
        np.testing.assert_allclose(1 / (1 / values["k1"] + 1 / values["k2"]), 120.0, rtol=1e-6)
        np.testing.assert_allclose(values["d"], 0.4, rtol=1e-5)
        assert found.verdict == "not identifiable"
        identifiable = dict(zip(found.coordinates.names, found.uncertainty.identifiable, strict=True))
        assert identifiable == {"k1": False, "k2": False, "d": True}
        (said,) = found.uncertainty.directions()
        assert said.startswith("only together:") and "k1" in said and "k2" in said and "d " not in said
        assert ("k1 up" in said) == ("k2 down" in said)
        # d ln k = share1 d ln k1 + share2 d ln k2 = 0 along it, the shares k/k1 and k/k2.
        H = np.asarray(found.uncertainty.information)
        blind = np.linalg.eigh(H)[1][:, 0]
        along = dict(zip(found.coordinates.names, blind, strict=True))
        assert abs(along["k1"] / values["k1"] + along["k2"] / values["k2"]) < 1e-5 / 120

    def test_shared_and_fixed_parameters(self):
        """Two names for one value; the reference knows only one."""

        def both(omega, v, q):
            return two_mass(omega, v | {"k": (v["k"] + v["k2"]) / 2}, q)

        model = share(jf.GrayBox(both, drive().parameters | {"k2": jf.Parameter(50.0)}), ["k", "k2"])
        model = jf.graybox.fix(jf.graybox.starting_at(model, {"f": 0.6}), ["f"])
        found = jf.fit(model, frf_of(true_response()), starts=3)
        assert set(found.coordinates.names) == {"k", "d", "tau"} and set(found.std) == {"k", "d", "tau"}
        np.testing.assert_allclose([found.values[n] for n in ("k", "k2", "f", "d")], [120, 120, 0.6, 0.4], rtol=1e-8)

    def test_one_name_is_no_list_of_letters(self):
        model = jf.GrayBox(lambda w, v: w, {"k": 1.0, "d": 1.0, "kd": 1.0})
        assert Coordinates(jf.graybox.fix(model, "kd").parameters).names == ("d", "k")
        assert Coordinates(jf.graybox.fix(model, "k*").parameters).names == ("d",)

    def test_slope_of_a_shared_parameter(self, measured):
        """Both places where the value stands count in the Jacobian."""

        def both(omega, v, q):
            return two_mass(omega, v | {"k": v["k"] ** 0.3 * v["k2"] ** 0.7}, q)

        shared = share(jf.GrayBox(both, drive().parameters | {"k2": jf.Parameter(50.0)}), ["k", "k2"])
        tg = target(measured, jf.Weights(), ARMS)
        one = gram(drive(), Coordinates(drive().parameters), tg, X)
        coordinates = Coordinates(shared.parameters)
        assert coordinates.names == Coordinates(drive().parameters).names
        two = gram(shared, coordinates, tg, X)
        np.testing.assert_allclose(two, one, rtol=1e-9, atol=1e-9)

    def test_a_negative_delay(self):
        values = TRUE | {"tau": -4e-3}
        found = jf.fit(drive(), frf_of(true_response(values)), starts=3)
        np.testing.assert_allclose(found.values["tau"], -4e-3, rtol=1e-8)
        low, high = found.interval()["tau"]
        np.testing.assert_allclose([low, high], -4e-3, rtol=1e-8)  # no noise: no width

    @pytest.mark.slow
    def test_evaluate_on_other_positions(self, measured):
        """1 where the errors are as large as noise and floor say, whatever the user's weights are."""
        rng = np.random.default_rng(3)
        many = np.zeros((40, 1))
        G = true_response(TRUE, FREQUENCY, many)
        cov = random_covariance(rng, G, 0.003)
        at_truth = jf.graybox.starting_at(drive(), TRUE)
        fitted = jf.fit(at_truth, frf_of(true_response()), starts=1)
        frf = frf_of(noisy(rng, G, cov), cov, q=many)
        for weights in (jf.Weights(floor=0), jf.Weights(floor=0, correlated=True)):
            np.testing.assert_allclose(jf.graybox.model_quality(fitted, frf, weights).cost, 1.0, atol=0.08)


class TestRobot:
    @pytest.mark.slow
    def test_every_start_finds_the_truth(self):
        """Two axes; R3X is below."""
        start = jf.RobotModel(jf.robot.robot_from_table(tomllib.loads(ROBOT)))
        rng = np.random.default_rng(4)
        names = Coordinates(start.parameters).names
        values = {n: start.parameters[n].start * np.exp(0.1 * rng.standard_normal()) for n in names}
        frequency, q = np.geomspace(4.0, 79.0, 24), positions(2)[:, :2]
        friction = [values[f"{a}.effective_friction"] for a in start.robot.axis_names]
        frf = frf_of(robot_frf(start.at(values), q, frequency, friction), frequency=frequency, q=q)
        found = jf.fit(start, dataclasses.replace(frf, y_quantity=start.quantity), starts=20, keep=None)
        assert found.close_starts == 20 and all(s.converged for s in found.starts)
        for begun in found.starts:
            np.testing.assert_allclose(begun.x, np.log([values[n] for n in found.coordinates.names]), atol=1e-8)


class TestR3X:
    @staticmethod
    def truth(n_lines, n_pos):
        """A robot whose springs, dampers and frictions are not those where the fit starts."""
        start = jf.RobotModel(linear_r3x())
        rng = np.random.default_rng(4)
        names = Coordinates(start.parameters).names
        values = {n: start.parameters[n].start * np.exp(0.1 * rng.standard_normal()) for n in names}
        frequency, q = np.geomspace(4.0, 79.0, n_lines), positions(n_pos)
        friction = [values[f"{a}.effective_friction"] for a in start.robot.axis_names]
        frf = frf_of(robot_frf(start.at(values), q, frequency, friction), frequency=frequency, q=q)
        return start, values, dataclasses.replace(frf, y_quantity=start.quantity)

    def check(self, n_lines):
        model, values, frf = self.truth(n_lines, 7)
        found = jf.fit(model, frf, starts=20, keep=None)
        assert found.verdict == "unimodal" and found.close_starts == 20
        for start in found.starts:
            np.testing.assert_allclose(start.x, np.log([values[n] for n in found.coordinates.names]), atol=1e-8)

    @pytest.mark.slow
    def test_every_start_finds_the_truth(self):
        self.check(64)

    @pytest.mark.slow
    def test_every_start_finds_the_truth_full_size(self):
        self.check(336)

    @pytest.mark.slow
    def test_some_starts(self):
        """2 positions and few lines, a model started elsewhere: the default search."""
        model, values, frf = self.truth(40, 2)
        found = jf.fit(model, frf, starts=3)
        for name, value in values.items():
            np.testing.assert_allclose(found.values[name], value, rtol=1e-7)


class TestBadInput:
    def test_model_of_another_size(self, measured):
        one = jf.GrayBox(lambda w, v: 1 / (1j * w + v["f"]), {"f": 1.0})
        with pytest.raises(jf.InputError, match="1 outputs and 1 inputs"):
            jf.fit(one, measured)
        with pytest.raises(jf.InputError, match="arm angles"):
            jf.fit(jf.RobotModel(linear_r3x(), quantity=measured.y_quantity), measured)

    def test_points_of_another_number(self, measured):
        with pytest.raises(jf.InputError, match="points"):
            jf.fit(drive(), measured, points=np.zeros((3, 1)), starts=1)

    @pytest.mark.parametrize("starts", [0, -1, [], [3.0], [{"stiffnes": 1.0}], [{"k": -1.0}], [{"k": np.nan}]])
    def test_starts(self, measured, starts):
        with pytest.raises(jf.InputError):
            jf.fit(drive(), measured, starts=starts)

    def test_numbers_of_numpy(self, measured):
        assert len(jf.fit(drive(), measured, starts=np.int64(2)).starts) == 2

    def test_nothing_left(self, measured):
        for weights in (
            jf.Weights(reject=1e-9),
            jf.Weights(bands=((0.0, 100.0, 0.0),)),
            jf.Weights(elements=np.zeros((2, 2))),
        ):
            with pytest.raises(jf.InputError, match="no element"):
                jf.fit(drive(), measured, weights=weights)

    @pytest.mark.parametrize(
        "bad",
        [
            {"floor": -1.0},
            {"floor": np.nan},
            {"reject": 0.0},
            {"focus": 0.0},
            {"off_diagonal": -0.1},
            {"bands": ((3.0, 1.0, 2.0),)},
            {"bands": ((1.0, 3.0, -2.0),)},
            {"bands": ((1.0, 3.0),)},
        ],
    )
    def test_weights(self, bad):
        with pytest.raises(jf.InputError):
            jf.Weights(**bad)

    def test_elements_of_another_shape(self, measured):
        for elements in (np.ones((3, 3)), -np.ones((2, 2)), np.full((2, 2), np.nan)):
            with pytest.raises(jf.InputError, match=r"weights\.elements"):
                jf.fit(drive(), measured, weights=jf.Weights(elements=elements))

    def test_model_that_is_not_finite(self, measured):
        def broken(omega, values, q):
            return two_mass(omega, values, q) * jnp.sqrt(values["k"] - 200.0)

        with pytest.raises(jf.InputError, match="not finite"):
            jf.fit(jf.GrayBox(broken, drive().parameters), measured)

    def test_one_start_where_the_model_is_not_finite(self, measured):
        """It is counted, with an endless cost, and the others go on."""

        def fragile(omega, values, q):
            return two_mass(omega, values, q) * jnp.where(values["k"] > 400.0, jnp.nan, 1.0)

        found = jf.fit(jf.GrayBox(fragile, drive().parameters), measured, starts=[{"k": 500.0}, {}])
        assert found.starts[0].cost == np.inf and np.isfinite(found.cost)
        with pytest.raises(jf.InputError, match="finite"):
            jf.fit(jf.GrayBox(fragile, drive().parameters), measured, starts=[{"k": 500.0}])

    def test_model_without_a_frequency_axis(self, measured):
        with pytest.raises(jf.InputError, match="freq, out, in"):
            jf.fit(jf.GrayBox(lambda w, v, q: jnp.ones((2, 2)) * v["k"], drive().parameters), measured)

    @pytest.mark.parametrize(
        ("wrong", "says", "cause"),
        [
            (lambda w, v: np.exp(v["k"]) * w, "written in jax.numpy", jax.errors.TracerArrayConversionError),
            (lambda w, v: w if v["k"] > 1.0 else -w, "jnp.where", jax.errors.TracerBoolConversionError),
            (lambda w, v: w * float(v["k"]), "Leave float", jax.errors.ConcretizationTypeError),
            (lambda w, v: w * v["kk"], "'kk'; expected one of .*Did you mean 'k'", KeyError),
            (lambda w, v: w @ jnp.ones(3), "model: found TypeError: ", TypeError),
            (lambda w, v: None, "result of the model: found None", type(None)),
        ],
    )
    def test_a_mistake_in_a_model_of_ones_own(self, measured, wrong, says, cause):
        with pytest.raises(jf.InputError, match=says) as caught:
            jf.fit(jf.GrayBox(wrong, drive().parameters), measured)
        assert isinstance(caught.value.__cause__, cause)

    def test_solver_by_name(self, measured):
        with pytest.raises(jf.InputError, match="solver"):
            jf.fit(drive(), measured, solver="lm")
