"""Choice of positions: information by finite differences, determinants by trying all subsets, plans and their files."""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.graybox.positions import d_optimal, expected_accuracy, plan_positions, position_information
from jaxfrf.io.positions import write_positions
from jaxfrf.plot.plan import plan as draw_plan
from jaxfrf.simulation.positions import check_within, positions_of, read_positions

FREQUENCY = np.geomspace(1.0, 12.0, 20)
NAMES = ("a.stiffness", "a.damping", "b.stiffness", "b.damping", "f")
VALUES = np.array([900.0, 3.0, 2500.0, 8.0, 0.5])
POINTS = np.random.default_rng(0).uniform(-1.0, 1.0, (9, 2))


def response(omega, values, q, xp=np):
    """Two springs in series with masses that depend on q; acceleration of both for a force on either."""
    s = 1j * omega
    ka, kb = (values[f"{x}.stiffness"] + s * values[f"{x}.damping"] for x in "ab")
    m1, m2 = 1.0 + 0.4 * q[0], 1.5 + 0.5 * q[0] * q[1]
    a, b, c = m1 * s**2 + ka + kb, -kb, m2 * s**2 + values["f"] * s + kb
    det = a * c - b * b
    rows = [[c, -b], [-b, a]]
    return s[:, None, None] ** 2 * xp.moveaxis(xp.array(rows) / det, -1, 0)


@functools.cache
def model():
    known = {n: jf.Parameter(v, nuisance=n == "f") for n, v in zip(NAMES, VALUES, strict=True)}
    return jf.GrayBox(lambda omega, values, q: response(omega, values, q, jnp), known)


def numpy_information(q, noise, step=1e-6):
    """2/noise^2 Re(J^H J) of log G in log parameters, by central differences."""
    omega, columns = 2 * np.pi * FREQUENCY, []
    for i in range(len(VALUES)):
        ends = []
        for sign in (1, -1):
            moved = VALUES * np.exp(sign * step * (np.arange(len(VALUES)) == i))
            ends.append(np.log(response(omega, dict(zip(NAMES, moved, strict=True)), q)))
        columns.append(((ends[0] - ends[1]) / (2 * step) / noise).ravel())
    J = np.stack(columns, axis=1)
    return 2 * np.real(J.conj().T @ J)


@functools.cache
def information():
    return position_information(model(), FREQUENCY, POINTS, 0.05)


def names():
    """In the order of the information."""
    return plan().names


@functools.cache
def plan():
    return plan_positions(model(), FREQUENCY, POINTS, 3, noise=0.05, beyond=2, blocks=(1, 4))


def test_information_against_finite_differences():
    order = [NAMES.index(n) for n in names()]
    for q, found in zip(POINTS, information(), strict=True):
        expected = numpy_information(q, 0.05)[np.ix_(order, order)]
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * expected.max())


def test_noise_may_depend_on_frequency_and_element():
    noise = 0.02 + 0.1 * np.random.default_rng(1).random((20, 2, 2))
    order = [NAMES.index(n) for n in names()]
    found = position_information(model(), FREQUENCY, POINTS[:1], noise)[0]
    expected = numpy_information(POINTS[0], noise)[np.ix_(order, order)]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * expected.max())


def random_information(seed, n=8, parameters=4, rows=3):
    J = np.random.default_rng(seed).standard_normal((n, rows, parameters))
    return J.transpose(0, 2, 1) @ J


def volume(information, chosen):
    return np.linalg.slogdet(information[list(chosen)].sum(axis=0))[1]


@pytest.mark.parametrize("count", [2, 3, 4])
def test_choice_against_all_subsets(count):
    for seed in range(40):
        candidates = random_information(seed)
        best = max(itertools.combinations(range(8), count), key=lambda s: volume(candidates, s))
        assert d_optimal(candidates, count) == best


def test_choice_of_the_model_against_all_subsets():
    for count in (1, 3, 5):
        best = max(itertools.combinations(range(9), count), key=lambda s: volume(information(), s))
        assert d_optimal(information(), count) == best


def test_no_single_exchange_improves_a_large_choice():
    candidates = random_information(3, n=60, parameters=6)
    chosen = d_optimal(candidates, 7, starts=2)
    reached = volume(candidates, chosen)
    for out, into in itertools.product(chosen, set(range(60)) - set(chosen)):
        assert volume(candidates, [into, *(i for i in chosen if i != out)]) <= reached + 1e-12


def test_choice_does_not_depend_on_units():
    candidates = random_information(5, n=30, parameters=6)
    units = 10.0 ** np.random.default_rng(0).uniform(-6, 6, 6)
    assert d_optimal(candidates, 5) == d_optimal(candidates * units[:, None] * units, 5)


def test_positions_may_repeat():
    """One candidate far better than the others."""
    candidates = random_information(0, rows=6)
    candidates[5] *= 100
    assert d_optimal(candidates, 3, repeat=True) == (5, 5, 5)
    assert len(set(d_optimal(candidates, 3))) == 3


def test_accuracy_is_the_inverse_of_the_sum():
    found = expected_accuracy(information()[:4], names(), blocks=3)
    cov = np.linalg.inv(3 * information()[:4].sum(axis=0))
    np.testing.assert_allclose(found.std, np.sqrt(np.diagonal(cov)), rtol=1e-6)
    np.testing.assert_allclose(found.correlation, cov / np.outer(found.std, found.std), rtol=1e-5, atol=1e-8)


def test_a_plan_holds_what_its_positions_give():
    made = plan()
    assert made.chosen == d_optimal(information(), 3)
    np.testing.assert_array_equal(made.points, POINTS[list(made.chosen)])
    assert dict(zip(made.names, made.wanted, strict=True)) == {n: n != "f" for n in NAMES}
    np.testing.assert_array_equal(made.counts, [1, 2, 3, 4, 5])
    for count, std in zip(made.counts, made.optimal, strict=True):
        np.testing.assert_array_equal(
            std, expected_accuracy(information()[list(d_optimal(information(), int(count)))], made.names).std
        )
    np.testing.assert_array_equal(made.optimal[2], made.accuracy.std)
    np.testing.assert_allclose(made.by_blocks[1], made.by_blocks[0] / 2, rtol=1e-9)
    assert np.log(made.random[2] / made.optimal[2]).mean() > 0


def test_accuracy_of_a_plan_by_monte_carlo():
    """Scatter of linear least squares on log G of the chosen positions, with noise of the stated size."""
    made, rng, runs = plan(), np.random.default_rng(2), 400
    J = [np.linalg.cholesky(numpy_information(q, 1.0)).T for q in made.points]  # same J^T J with noise of 1
    J = np.concatenate(J)
    errors = 0.05 * rng.standard_normal((runs, len(J)))
    scatter = np.linalg.lstsq(J, errors.T, rcond=None)[0].std(axis=1)
    stated = dict(zip(made.names, made.accuracy.std, strict=True))
    np.testing.assert_allclose(scatter, [stated[n] for n in NAMES], rtol=4 / np.sqrt(2 * runs))


def test_what_cannot_be_planned():
    with pytest.raises(jf.InputError, match="count of positions: found 10; expected 1 to 9"):
        plan_positions(model(), FREQUENCY, POINTS, 10)
    with pytest.raises(jf.InputError, match="count of positions: found 0"):
        d_optimal(information(), 0)
    with pytest.raises(jf.InputError, match="count of positions: found 10"):
        d_optimal(information(), 10)
    with pytest.raises(jf.InputError, match="not finite at position 4"):
        d_optimal(np.where(np.arange(9)[:, None, None] == 4, np.nan, information()), 2)
    with pytest.raises(jf.InputError, match=r"not finite at 1 of 9 \(first: 2\)"):
        position_information(model(), FREQUENCY, np.where(np.arange(9)[:, None] == 2, np.nan, POINTS))
    with pytest.raises(jf.InputError, match="blocks"):
        plan_positions(model(), FREQUENCY, POINTS, 2, blocks=())


def test_picture_of_a_plan():
    figure, axes = draw_plan(plan(), title="two springs")
    labels = {ax.get_ylabel() for ax in axes}
    assert labels == {f"standard deviation of {kind} (%)" for kind in ("stiffness", "damping")}
    kind = axes[0].get_ylabel().split()[3]
    column = plan().names.index(f"a.{kind}")
    drawn = [line.get_ydata() for line in axes[0].lines]
    assert any(np.array_equal(y, 100 * plan().optimal[:, column]) for y in drawn)
    assert any(np.array_equal(y, 100 * plan().random[:, column]) for y in drawn)
    assert "two springs" in [text.get_text() for text in figure.texts]
    with pytest.raises(jf.InputError, match="axes: found 1; expected 2"):
        draw_plan(plan(), axes=axes[:1])
    many = dataclasses.replace(plan(), names=tuple(f"p{i}" for i in range(5)))
    assert len(draw_plan(many)[1]) == 1  # names without a kind: one axes


def test_files_of_positions(tmp_path):
    path = tmp_path / "positions.csv"
    write_positions(path, POINTS, ("one", "two"), ["7 of 200\nD-optimal"])
    np.testing.assert_array_equal(read_positions(path, 2), POINTS)
    assert path.read_text().splitlines()[:3] == ["# 7 of 200", "# D-optimal", "# one, two (rad)"]
    with pytest.raises(jf.InputError, match="finite"):
        write_positions(path, np.full((1, 2), np.nan))
    with pytest.raises(jf.InputError, match="no folder"):
        write_positions(tmp_path / "none" / "a.csv", POINTS)
    assert [p.name for p in tmp_path.iterdir()] == ["positions.csv"]
    np.testing.assert_array_equal(read_positions(path, 2), POINTS)


def test_positions_between_limits(tmp_path):
    robot = jf.robot.r3x()
    limits = ((-0.5, 0.5), (-np.inf, np.inf), (4.0, 6.0), (0.0, 9.0), *((-np.inf, np.inf),) * 2)
    robot = dataclasses.replace(robot, limits=limits)
    jf.io.write_robot(tmp_path / "r.toml", robot)
    assert jf.io.read_robot(tmp_path / "r.toml").limits == limits
    margin = np.array([0.1, 0.0, 0.05, 0.1, 0.0, 0.0])
    q = positions_of(robot, 200, jax.random.key(0), margin)
    free = jf.random_positions(200, jax.random.key(0))
    np.testing.assert_array_equal(q[:, [1, 4, 5]], free[:, [1, 4, 5]])
    assert 0.38 < np.abs(q[:, 0]).max() <= 0.4
    assert 4.05 <= q[:, 2].min() < 4.1 and 5.9 < q[:, 2].max() <= 5.95
    assert 3.0 < np.abs(q[:, 3] - 4.5).max() <= np.pi
    check_within("q.csv", q, robot, margin)
    with pytest.raises(jf.InputError, match=r"q.csv: position 0: found joint1 at 0.45 rad; expected -0.5 to 0.5 rad"):
        check_within("q.csv", np.full((1, 6), 0.45), robot, margin)
    with pytest.raises(jf.InputError, match=r"limits of joint1: .* more than the 0.6 rad"):
        positions_of(robot, 2, jax.random.key(0), 0.6)
    with pytest.raises(jf.InputError, match=r"limits: .* for each axis"):
        dataclasses.replace(robot, limits=limits[:2])
    with pytest.raises(jf.InputError, match=r"limits: .* for each axis"):
        dataclasses.replace(robot, limits=((0.0, np.inf), *limits[1:]))


def test_what_slides_is_drawn_and_written_in_metres(tmp_path):
    joint = {"type": "driven", "axis": [0.0, 0.0, 1.0], "offset": [0.0, 0.0, 0.0], "mass": 1.0, "com": [0.0, 0.0, 0.0]}
    joint |= {"inertia": [0.1] * 3 + [0.0] * 3, "gear_ratio": 50.0, "motor_inertia": 1e-3, "stiffness": 1e4}
    joint |= {"damping": 1.0, "viscous_friction": 1e-3, "coulomb_friction": 0.1}
    joints = [joint | {"name": "turn"}, joint | {"name": "slide", "slides": True}]
    robot = jf.robot.robot_from_table({"name": "two", "gravity": [0.0, 0.0, -9.81], "joint": joints})
    q = positions_of(robot, 40, jax.random.key(0))
    assert robot.axis_units == ("rad", "m")
    assert np.abs(q[:, 0]).max() > 1.0 and 0.3 < np.abs(q[:, 1]).max() <= 0.5
    np.testing.assert_array_equal(q[:5], positions_of(robot, 5, jax.random.key(0)))
    write_positions(tmp_path / "q.csv", q, robot.axis_names, units=robot.axis_units)
    assert "# turn (rad), slide (m)" in (tmp_path / "q.csv").read_text()
    np.testing.assert_array_equal(read_positions(tmp_path / "q.csv", 2), q)
