"""What is wrong with a record is found where it is; what is only a machine is not."""

import numpy as np
import plants
import pytest
from scipy.interpolate import CubicSpline

import jaxfrf as jf
from jaxfrf.screening import Severity
from jaxfrf.screening.levels import saturated

FS, PERIOD = 500.0, 1000
LINES = np.arange(7, 200, 2)


@pytest.fixture(scope="module")
def clean():
    """Two axes in closed loop, four experiments of six periods, 1 % noise that is fed back: r, u, y."""
    rng = np.random.default_rng(0)
    loop = plants.two_mass_loop(2, FS, seed=3)
    R = plants.orthogonal_multisine(rng, 2, len(LINES), 2)
    one = np.stack([plants.multisine_record(x, LINES, PERIOD) for x in R])
    r = np.tile(one / one.std(), (1, 8, 1))
    u, y = np.stack([plants.simulate(loop, x, seed=i, noise=0.01) for i, x in enumerate(r)], axis=1)
    return tuple(x[:, 2 * PERIOD :] for x in (r, u, y))


@pytest.fixture
def record(clean):
    return dict(zip("ruy", (x.copy() for x in clean), strict=True))


def examine(record, n_periods=6, **fields):
    r, u, y = (record[k][:, : n_periods * PERIOD] for k in "ruy")
    return jf.examine(jf.Experiment(u, y, FS, **({"period": PERIOD, "r": r} | fields)))


def the_one(findings, kind, **where):
    """The finding of this kind that is the largest, which is in the place."""
    same = [f for f in findings if f.kind == kind]
    assert same, [f.says for f in findings]
    worst = max(same, key=lambda f: f.size)
    assert where.items() <= {k: getattr(worst, k) for k in where}.items(), worst
    return worst


@pytest.mark.parametrize("n_periods", [1, 2, 3, 6])
def test_nothing_on_a_clean_record(record, n_periods):
    assert examine(record, n_periods) == ()
    assert examine(record, n_periods, lines=LINES) == ()


@pytest.mark.parametrize("n_periods", [2, 6])
@pytest.mark.parametrize(("count", "at"), [(1, 700), (7, 1300), (-1, 1450), (20, 1100)])
def test_lost_samples(record, n_periods, count, at):
    y = record["y"]
    part = np.delete(y[1], slice(at, at + count), axis=0) if count > 0 else np.insert(y[1], at, y[1, at], axis=0)
    y[1] = np.concatenate([part, y[1, -max(count, 0) :][: max(count, 0)]])[: y.shape[1]]
    if n_periods == 2 and count == 20:  # of two periods, too little is left to tell by how many samples
        assert {f.exp for f in examine(record, 2)} >= {1}
        return
    found = the_one(examine(record, n_periods), "lost", signal="y", exp=1)
    assert abs(found.samples[0] - at) < 40 or n_periods == 2
    assert f"has lost {count} sample" in found.says or (count < 0 and "1 sample too many" in found.says)


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("at", [200, 740, 1000])
def test_doubled_samples_of_two_periods(record, at, count):
    y = record["y"]
    y[1, at + count :] = y[1, at:-count].copy()
    found = examine(record, 2)
    assert {f.kind for f in found} <= {"lost", "foreign"}
    assert f"holds {count} sample" in the_one(found, "lost", signal="y", exp=1).says


@pytest.mark.parametrize("name", ["u", "y"])
@pytest.mark.parametrize("count", [1, 3, 20, -1])
@pytest.mark.parametrize("tail", [15, 30, 70])
def test_samples_lost_near_the_end_of_two_periods(record, name, count, tail):
    """What comes after is filled from the next period, as by a logger that goes on to its number of samples."""
    at, x = 2 * PERIOD - tail, record[name][1]
    moved = np.arange(at, 2 * PERIOD) + count if count > 0 else np.r_[at : at - count, at : 2 * PERIOD + count]
    x[at : 2 * PERIOD] = x[moved].copy()
    found = the_one(examine(record, 2), "lost", signal=name, exp=1)
    assert abs(found.samples[0] - at) <= 20
    assert f"has lost {count} sample" in found.says or (count < 0 and "1 sample too many" in found.says)


@pytest.mark.parametrize("count", [1, 5])
def test_samples_lost_near_the_beginning_of_two_periods(record, count):
    record["y"][1, : 25 + count] = np.r_[record["y"][1, PERIOD - count : PERIOD], record["y"][1, :25]]
    found = the_one(examine(record, 2), "lost", signal="y", exp=1)
    assert abs(found.samples[0] - 25 - count) <= 15 and f"{count} sample" in found.says


def test_held_zeroed_and_disturbed_stretches(record):
    record["y"][0, 2300:2420, 1] = record["y"][0, 2300, 1]
    record["u"][3, 4100:4130, 0] = 0.0
    record["u"][2, 3200:3300, 1] += np.random.default_rng(1).standard_normal(100) * record["u"].std()
    found = examine(record)
    assert {(f.signal, f.exp, f.samples) for f in found if f.kind == "held"} == {
        ("y", 0, (2300, 2420)),
        ("u", 3, (4100, 4130)),
    }
    assert any(f.exp == 2 and f.signal == "u" and f.kind in ("odd period", "disturbed") for f in found)


def test_single_spikes(record):
    record["y"][2, [1234, 3210], 0] += 3 * record["y"].std()
    kinds = {f.kind for f in examine(record, 5) if (f.signal, f.exp, f.channel) == ("y", 2, 0)}
    assert kinds & {"spikes", "disturbed", "odd period"}


@pytest.mark.parametrize("n_periods", [2, 6])
def test_gain_that_drifts(record, n_periods):
    n = n_periods * PERIOD
    record["y"][:, :n, 0] *= 1 + 0.05 * np.arange(n)[:, None].T / n
    found = the_one(examine(record, n_periods), "gain", signal="y", channel=0)
    assert abs(found.size - 0.05 * (n_periods - 1) / n_periods) < 0.01


def test_a_reference_that_fades_is_no_fault_of_the_gain(record):
    for x in record.values():
        x *= 1 - 0.2 * np.arange(x.shape[1])[:, None] / x.shape[1]
    assert not [f for f in examine(record) if f.kind == "gain"]


@pytest.mark.parametrize("name", ["u", "y"])
def test_a_counter_that_wraps_is_refused(record, name):
    x = record[name]
    turn = 0.8 * np.ptp(x)
    record[name] = (x + turn / 2) % turn - turn / 2
    assert the_one(examine(record), "wrapped", signal=name).severity is Severity.REFUSED


def other_clock(x, ppm):
    """The same signal at n (1 + ppm/1e6), by splines."""
    n = np.arange(x.shape[1])
    return CubicSpline(n, x, axis=1)(np.minimum(n * (1 + ppm * 1e-6), n[-1]))


@pytest.mark.parametrize("n_periods", [2, 3, 6])
@pytest.mark.parametrize(("names", "ppm"), [("y", 60), ("y", -300), ("u", 100)])
def test_signals_by_different_clocks(record, n_periods, names, ppm):
    for name in names:
        record[name] = other_clock(record[name], ppm)
    found = examine(record, n_periods)
    assert {f.kind for f in found} == {"clock"} and {f.signal for f in found} == set(names)
    factor = float(found[0].says.rsplit("n x ")[1].rstrip("."))
    assert abs(factor - 1 + ppm * 1e-6) < 1e-5 and found[0].severity is Severity.WARNED


def test_one_channel_of_one_experiment_by_another_clock(record):
    record["y"][2:3, :, 1:] = other_clock(record["y"][2:3, :, 1:], 100)
    (found,) = examine(record)
    assert (found.kind, found.exp, found.channel) == ("clock", 2, 1)


def test_a_period_of_no_whole_number_of_samples(record):
    (found,) = examine({k: other_clock(x, 200) for k, x in record.items()}, 4)
    assert found.kind == "period length" and "every 999.8" in found.says and found.severity is Severity.TOLD


@pytest.mark.parametrize("n_periods", [2, 6])
def test_a_machine_that_changes_is_not_another_clock(record, n_periods):
    """A pole that moves by a tenth over the record, and a delay that comes back."""
    n = n_periods * PERIOD
    warm = np.linspace(1, 1.1, n)
    for x in record["y"][:, :n, 0]:
        state = 0.0
        for t in range(n):
            state = x[t] = state + 0.3 * warm[t] * (x[t] - state)
    found = [f for f in examine(record, n_periods) if f.kind in ("clock", "period length")]
    assert not found, found


def test_a_limit_behind_noise(record):
    limit = 1.2 * record["y"][..., 0].std()
    noise = 0.003 * limit * np.random.default_rng(2).standard_normal(record["y"].shape[:2])
    record["y"][..., 0] = np.clip(record["y"][..., 0], -limit, limit) + noise
    the_one(examine(record), "saturated", signal="y", channel=0)


def test_jitter(record):
    n = record["y"].shape[1]
    slope = np.fft.irfft(2j * np.pi * np.fft.rfftfreq(n)[:, None] * np.fft.rfft(record["y"], axis=1), n, axis=1)
    record["y"] += 0.4 * slope * np.random.default_rng(3).standard_normal((1, n, 1))
    assert abs(the_one(examine(record), "jitter", signal="y").size - 0.4) < 0.15


def test_much_jitter_scatters_about_its_line_by_chance(record):
    n = PERIOD * 2
    y, t = record["y"][:, :, 0], np.arange(n)
    times = t + 0.6 * np.random.default_rng(5).standard_normal((4, n))
    spline = [CubicSpline(np.arange(y.shape[1]), x) for x in y]
    record["y"][:, :n, 0] = [x(np.abs(at)) for x, at in zip(spline, times, strict=True)]
    assert len({f.exp for f in examine(record, 2) if f.kind == "jitter"}) >= 3


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda y: -y, "all signs of y"),
        (lambda y: y * [1, -1], "sign of y: channel 1"),
        (lambda y: y[:, ::-1], "channels 0 and 1 of y exchanged"),
        (lambda y: np.random.default_rng(4).standard_normal(y.shape), "noise"),
        (lambda y: np.roll(y, 1, axis=0), "does not belong"),
        (lambda y: 1.15 * y, "does not belong"),
    ],
)
@pytest.mark.parametrize("n_periods", [2, 6])
def test_an_experiment_that_does_not_belong(record, change, says, n_periods):
    record["y"][2] = change(record["y"][2])
    assert says in the_one(examine(record, n_periods), "foreign", exp=2).says


def test_experiments_in_another_order(record):
    record["y"][[1, 3]] = record["y"][[3, 1]]
    found = [f for f in examine(record) if f.kind == "foreign"]
    assert {f.exp for f in found} == {1, 3} and "Its u fits the y of experiment" in found[0].says


def test_two_experiments_contradict_each_other(record):
    two = {k: x[:2, :, :1].copy() for k, x in record.items()}
    two["u"], two["y"] = (
        two["r"],
        0.7 * np.roll(two["r"], 2, axis=1) + 0.01 * np.roll(record["y"][:2, :, :1], 9, axis=1),
    )
    assert not [f for f in examine(two) if f.kind == "foreign"]
    two["y"][1] *= -1
    assert "contradict each other" in the_one(examine(two), "foreign").says


def test_one_record_as_all_experiments(record):
    """Its FRF would look exact: nothing differs between them."""
    copies = {k: np.concatenate([x[1:2]] * 3) for k, x in record.items()}
    finding = the_one(examine(copies), "copied")
    assert finding.severity is Severity.REFUSED and "same samples" in finding.says


def test_the_same_data_twice(record):
    twice = {k: np.concatenate([x, x[1:2]]) for k, x in record.items()}
    assert "once more" in the_one(examine(twice), "twice", exp=4).says
    after = {k: np.concatenate([x[:, : 3 * PERIOD]] * 2, axis=1) for k, x in record.items()}
    assert "second half" in the_one(examine(after), "twice").says


@pytest.mark.parametrize("period", [500, 750, 999, 1001, 1200, 1500])
def test_a_wrong_period_is_refused(record, period):
    n = 6000 // period * period
    r, u, y = (record[k][:, :n] for k in "ruy")
    for more in ({"r": r}, {}):
        data = jf.Experiment(u, y, FS, period, **more)
        with pytest.raises(jf.InputError, match=r"repeats every 1000 samples .*--set period=1000"):
            jf.estimate(data, jf.LRM())


def test_a_multiple_of_the_period_is_told(record):
    """It is a period, but lines that nobody excited lie between the excited ones."""
    found = the_one(examine(record, period=2000), "period")
    assert found.severity is Severity.WARNED and "--set period=1000" in found.says


def test_lines_that_are_not_excited(record):
    found = the_one(examine(record, lines=np.arange(7, 200, 3)), "lines")
    assert "every other line from 7 to 199" in found.says


def test_a_break_in_a_record_without_period():
    rng = np.random.default_rng(7)
    t = np.arange(6000) / FS
    y = np.sum([np.sin(2 * np.pi * f * t + p) for f, p in rng.uniform(0, 6, (9, 2))], axis=0)
    y += 1e-4 * rng.standard_normal(y.shape)
    u = np.gradient(y) + 1e-4 * rng.standard_normal(y.shape)
    assert jf.screen(jf.Experiment(u, y, FS)) == ()
    broken = np.delete(y, slice(2000, 2008))
    found = the_one(jf.examine(jf.Experiment(u[:-8], broken, FS)), "glitch", signal="y")
    assert abs(found.samples[0] - 2000) < 12


def test_files_are_compared_with_each_other(tmp_path, record):
    """The checks between experiments see those of several files, and name the file."""
    for i in range(4):
        y = -record["y"][i] if i == 3 else record["y"][i]
        np.savez(tmp_path / f"{i}.npz", u=record["u"][i], y=y, r=record["r"][i], fs=FS, period=PERIOD)
    data = jf.io.read(*(tmp_path / f"{i}.npz" for i in range(4)))
    (text,) = (w for w in data.warnings if "does not belong" in w)
    assert "experiment 3 (position 0, file 3.npz)" in text
    data = jf.io.read(*(tmp_path / f"{i}.npz" for i in (0, 1, 2, 1)))
    assert any("holds the samples of experiment 1" in w for w in data.warnings)


def test_what_is_refused_can_be_read_anyway(tmp_path, record):
    path = tmp_path / "a.npz"
    np.savez(path, u=record["u"], y=record["y"], fs=FS, period=1500)
    with pytest.raises(jf.InputError, match=r"a\.npz: period"):
        jf.io.read(path)
    assert any("1000 samples" in text for text in jf.io.read(path, anyway=True).warnings)


def two_masses(hertz, place, damping=0.02):
    """Torque of the first of two masses to the speed of `place`: antiresonance at 60 Hz, resonance at 85 Hz."""
    s = 2j * np.pi * hertz
    k = (2 * np.pi * 60.0) ** 2
    spring = k + 2 * damping * np.sqrt(k) * s
    M = np.array([[s**2 + s + spring, -spring], [-spring, s**2 + spring]])
    return s * np.linalg.inv(np.moveaxis(M, -1, 0))[:, place, 0]


@pytest.mark.parametrize(("late", "place"), [(0, 0), (1, 0), (3, 0), (0, 1)])
def test_u_late_by_samples_of_a_lightly_damped_machine(late, place):
    """Resonances up to near the end of the band: |G| does not run straight there."""
    rng, n, lines = np.random.default_rng(0), 2000, np.arange(9, 260)
    U = np.zeros(n // 2 + 1, complex)
    U[lines] = np.exp(2j * np.pi * rng.random(lines.size))
    Y = U.copy()
    Y[lines] *= two_masses(lines * 0.5, place) * np.exp(-1j * np.pi * lines / n)  # u is held between samples
    u, y = (np.tile(np.fft.irfft(X, n), 2) for X in (U, Y))
    u = np.roll(u, late) + 1e-3 * u.std() * rng.standard_normal(2 * n)
    y = y + 1e-3 * y.std() * rng.standard_normal(2 * n)
    found = [f for f in jf.examine(jf.Experiment(u, y, 1000.0, n, lines=lines)) if f.kind == "noncausal"]
    assert len(found) == (late > 0)
    for finding in found:
        assert abs(finding.size - (late - 0.5)) < 0.2


@pytest.mark.parametrize("limit", [None, 1.6])
def test_a_limit_behind_noise_beside_a_slow_sine(limit):
    rng, n = np.random.default_rng(1), 2000
    t = np.arange(n) / n
    weak = sum(0.15 * np.cos(2 * np.pi * (k * t + rng.random())) for k in range(11, 240, 4))
    y = np.tile(2.0 * np.sin(2 * np.pi * 3 * t) + weak, 2)
    u = np.tile(weak, 2) + 1e-3 * rng.standard_normal(2 * n)
    if limit:
        y = np.clip(y, -limit * y.std(), limit * y.std())
    y = y + 0.006 * rng.standard_normal(2 * n)
    assert bool([f for f in jf.examine(jf.Experiment(u, y, 1000.0, n)) if f.kind == "saturated"]) == bool(limit)


def test_several_periods_given_as_one(record):
    findings = examine(record, period=2 * PERIOD)
    assert f"repeats every {PERIOD} samples already" in the_one(findings, "period").says


@pytest.mark.parametrize("times", [1, 30])
def test_a_crest_that_is_sampled_finely_is_no_limit(times):
    """One crest of nine samples is one visit to the end of the range; thirty of them are a limit."""
    rng = np.random.default_rng(5)
    n, lines = 20_000, np.arange(21, 400, 4)
    wave = lambda: np.cos(2 * np.pi * np.outer(np.arange(n), lines) / n + rng.uniform(0, 2 * np.pi, len(lines))).sum(1)
    u, y = wave(), wave()
    limit = 1.05 * y.max()
    for at in rng.choice(n // 20, times, replace=False) * 20:
        y[at : at + 9] = limit + 0.05 * rng.random(9)
    found = jf.examine(jf.Experiment(u[None, None, :, None], y[None, None, :, None], 2000.0, n, lines=lines))
    assert bool([f for f in found if f.kind == "saturated"]) == (times > 1)


@pytest.mark.parametrize("seed", [11, 14, 17, 19])
def test_one_of_many_channels_crowds_at_an_end_by_chance(seed):
    """Forty runs of seven channels have 560 ends: one stands out by 2.5 standard deviations in every ninth such set."""
    rng, n = np.random.default_rng(seed), 4000
    X = np.zeros((1, 40, n // 2 + 1, 6), complex)
    X[:, :, 5:105] = np.exp(2j * np.pi * rng.random((1, 40, 100, 6)))
    x = np.fft.irfft(X, axis=2)
    stepping = 0.3 * np.sign(np.sin(2 * np.pi * 3 * np.arange(n) / n))  # as friction does
    u = x / x.std() + stepping[:, None] + 0.02 * rng.standard_normal(x.shape)
    u = np.concatenate([u, u], axis=2)
    assert not jf.examine(jf.Experiment(u, u[..., :1], 1000.0, n), (saturated,))
