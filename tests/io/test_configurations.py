"""Where the arm stood as it was logged along the record, and files that are told apart by it."""

import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.io.blocks import data_set
from jaxfrf.io.records import read_each

N, PERIOD = 200, 50
SETTINGS = {"fs": 500.0, "period": PERIOD, "transient_periods": 1, "y_quantity": "position"}
NAMES = {"u": "[M1;M2]", "y": "[A1;A2]", "q": "[Pos1 [deg];Pos2 [deg]]"}
MAP = ["--map", ",".join(f"{key}={name}" for key, name in NAMES.items())]


def log(path, q, seed, sway=0.05):
    """A table of one experiment: torques, motor angles, and the joints' angles about `q` rad, in degrees."""
    rng = np.random.default_rng(seed)
    u = np.tile(rng.standard_normal((PERIOD, 2)), (N // PERIOD, 1))
    y = np.roll(u, 1, axis=0) + 1e-3 * rng.standard_normal((N, 2))
    angle = np.asarray(q) + sway * np.sin(2 * np.pi * np.arange(N)[:, None] / PERIOD + [0.0, 1.0])
    angle[:PERIOD] += 0.1  # as long as it has not settled
    table = np.column_stack([u, y, np.rad2deg(angle)])
    np.savetxt(path, table, delimiter=",", header="M1,M2,A1,A2,Pos1 [deg],Pos2 [deg]", comments="")
    return path


def read(*paths, **more):
    return jf.io.read(*paths, names=NAMES, values=SETTINGS | more)


def test_joints_that_turn_and_joints_that_slide_state_units_of_their_own(tmp_path):
    path = log(tmp_path / "a.csv", [0.3, -0.7], 0)
    head, rows = path.read_text().split("\n", 1)
    path.write_text(head.replace("Pos2 [deg]", "Pos2 [mm]") + "\n" + rows)
    data = jf.io.read(path, names=NAMES | {"q": "[Pos1 [deg];Pos2 [mm]]"}, values=SETTINGS)
    np.testing.assert_allclose(data.q, [[0.3, 1e-3 * np.rad2deg(-0.7)]], atol=1e-12)


def test_the_mean_of_the_steady_record_is_the_configuration(tmp_path):
    data = read(log(tmp_path / "a.csv", [0.3, -0.7], 0))
    np.testing.assert_allclose(data.q, [[0.3, -0.7]], atol=1e-12)
    assert any(
        "a record; its mean is the arm configuration, about which it moves by up to 0.1 rad" in w for w in data.warnings
    )
    one = jf.io.read(tmp_path / "a.csv", names=NAMES | {"q": "Pos2"}, values=SETTINGS)
    np.testing.assert_allclose(one.q, [[-0.7]], atol=1e-12)
    stated = read(tmp_path / "a.csv", q=np.array([0.1, 0.2]))
    np.testing.assert_array_equal(stated.q, [[0.1, 0.2]])


def test_files_are_experiments_of_the_positions_that_they_were_logged_at(tmp_path):
    """Two positions, two experiments at each, in any order; whole and some positions at a time."""
    places = {"a": [0.3, -0.7], "b": [0.5, -0.7], "c": [0.305, -0.695], "d": [0.495, -0.7]}
    paths = [log(tmp_path / f"{name}.csv", q, i) for i, (name, q) in enumerate(places.items())]
    data = read(*paths)
    assert data.u.shape == (2, 2, N, 2) and [s.name for s in data.sources] == [p.name for p in paths]
    np.testing.assert_allclose(data.q, [places["a"], places["b"]], atol=1e-12)
    for (i, j), k in {(0, 0): 0, (0, 1): 2, (1, 0): 1, (1, 1): 3}.items():
        np.testing.assert_array_equal(data.u[i, j], read(paths[k]).u[0, 0])
    blocks = data_set(*paths, names=NAMES, values=SETTINGS)
    assert (blocks.n_pos, blocks.n_exp, blocks.blocks(5)) == (2, 2, [range(0, 1), range(1, 2)])
    for i in (0, 1):
        part = blocks.read(range(i, i + 1)).data
        np.testing.assert_array_equal(part.u[0], data.u[i])
        np.testing.assert_array_equal(part.q[0], data.q[i])
    np.testing.assert_array_equal(blocks.unscreened(range(2)).u, data.u)
    apart = read_each(*paths, names=NAMES, values=SETTINGS)
    np.testing.assert_array_equal(apart[2].q, apart[0].q)
    assert jf.concatenate(apart).u.shape == data.u.shape


def test_slow_motions_that_begin_elsewhere_are_of_one_position(tmp_path):
    """Means within half of the movement; farther, or without a movement, they are two positions."""
    shape = lambda apart, sway: read(
        *(log(tmp_path / f"{i}.csv", [0.3 + i * apart, -0.7], i, sway=sway) for i in (0, 1))
    ).u.shape[:2]
    assert shape(0.05, 0.06) == (1, 2)
    assert shape(0.07, 0.06) == shape(0.05, 0.002) == (2, 1)


def test_stated_configurations_are_taken_exactly():
    """A hundredth of a radian apart are two positions; where one has more experiments, every record is one."""

    def at(q, seed):
        u = np.tile(np.random.default_rng(seed).standard_normal((PERIOD, 1)), (4, 1))
        return jf.Experiment(u, u, 500.0, PERIOD, q=[q])

    both = jf.concatenate([at([0.1], 0), at([0.11], 1), at([0.1], 2), at([0.11], 3)])
    assert both.u.shape[:2] == (2, 2)
    np.testing.assert_array_equal(both.q[:, 0], [0.1, 0.11])
    assert jf.concatenate([at([0.1], 0), at([0.11], 1), at([0.1], 2)]).u.shape[:2] == (3, 1)


def test_an_arm_that_travels_is_refused(tmp_path):
    path = log(tmp_path / "a.csv", [0.3, -0.7], 0, sway=0.6)
    with pytest.raises(
        jf.InputError, match=r"q \(\[Pos1 .*found joint \d moving by 1\.2 rad within an experiment; .* 0.5 rad"
    ):
        read(path)
    u = np.random.default_rng(0).standard_normal((2, N, 1))
    q = np.broadcast_to([[0.0], [0.1]], (2, N))[..., None]
    np.savez(tmp_path / "a.npz", u=u, y=u, q=q, fs=500.0)
    with pytest.raises(jf.InputError, match=r"experiments of one position that stand 0\.1 rad apart"):
        jf.io.read(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", u=u[:, None], y=u[:, None], q=q[:, None], fs=500.0)
    np.testing.assert_allclose(jf.io.read(tmp_path / "b.npz").q, [[0.0], [0.1]])


def test_on_the_command_line(tmp_path, capsys):
    from jaxfrf.__main__ import main

    paths = [str(log(tmp_path / f"{i}.csv", [0.3 * (i // 2), 0.0], i)) for i in range(4)]
    values = ",".join(f"{key}={value}" for key, value in SETTINGS.items())
    frf = tmp_path / "frf.nc"
    assert main(["estimate", *paths, *MAP, "--set", values, "--method", "h1", "-o", str(frf)]) == 0, (
        capsys.readouterr().err
    )
    assert jf.io.read_frf(frf).G.shape[0] == 2
