"""What keeps a diagnosis from naming what is not there: positions that choose nothing, and held-out ones."""

import itertools
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import scipy.stats
from small_arm import made_up, small_robot
from two_axes import ROBOT

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.calibration.least_squares import Posterior
from jaxfrf.calibration.numbers import numbers
from jaxfrf.effects._harmonics import polar_deviation
from jaxfrf.gap.simulated.conclude import (
    _verdict,
    close_rivals,
    counting,
    stand_for_each_other,
    untold,
    worse_words,
)
from jaxfrf.gap.simulated.fitted import Fitted
from jaxfrf.gap.simulated.hypothesis import hypothesis
from jaxfrf.gap.simulated.judge import against_it, beyond, compared, over_floor, shows_nothing
from jaxfrf.gap.simulated.loud_ripple import holds_no_ripple
from jaxfrf.gap.simulated.maps import shown_samples
from jaxfrf.gap.simulated.one_round import Round, costs_of, is_number_confused_with
from jaxfrf.gap.simulated.rank import Scored, is_had
from jaxfrf.gap.simulated.records import split
from jaxfrf.gap.simulated.shortlist import chosen, confused
from jaxfrf.robot import Tolerances
from jaxfrf.trajectory.alike import alike, alike_as_written
from jaxfrf.trajectory.evidence import band_edges, by_band
from jaxfrf.trajectory.ripple import Order, with_ripple

FLOOR = np.full((41, 2), 0.1)
JUDGED = SimpleNamespace(
    U=np.ones((2, 2, 41, 2), complex), frequency=np.arange(41.0)
)  # a torque of 1 N m in every line


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "two.toml"
    path.write_text(ROBOT)
    return jf.io.read_robot(path)


def leaving(*times):
    """A robot that leaves so many floors, one number for each axis."""
    size = np.sqrt(2) * FLOOR * np.asarray(times)
    return SimpleNamespace(
        residual=(size * np.ones((2, 2, 41, 2))).astype(complex),
        evidence=SimpleNamespace(plain=FLOOR),
        robot=SimpleNamespace(axis_names=("shoulder", "elbow")),
    )


class TestHeldOutPositions:
    @pytest.mark.parametrize(
        ("joint", "heldout", "says"),
        [
            ("shoulder", [1.0, 1.1], ""),  # both axes gain
            ("shoulder", [1.0, 2.0], ""),  # one does, the other stays
            ("shoulder", [1.0, 2.1], ""),  # or loses little beside that
            ("", [1.0, 1.9], ""),
            ("shoulder", [3.0, 2.0], "takes away 0% of what is beyond the floor"),  # nothing gained
            ("shoulder", [2.9, 2.0], "takes away 5% of what"),  # or too little
            ("shoulder", [1.0, 2.5], "elbow rises from 2 to 2.5"),  # one pays for the other
            ("shoulder", [4.0, 2.0], "takes away -64%"),
            ("elbow", [1.0, 2.1], "the torque of elbow itself"),  # its own joint loses
        ],
    )
    def test_gap_of_every_axis(self, joint, heldout, says):
        against = against_it(JUDGED, leaving(3.0, 2.0), leaving(*heldout), joint)
        assert (says in against) if says else against == ""

    def test_an_axis_within_its_floor_may_move(self):
        """But not that of the effect itself."""
        base, extended = leaving(3.0, 0.3), leaving(1.0, 0.6)
        assert against_it(JUDGED, base, extended, "shoulder") == ""
        assert "torque of elbow itself" in against_it(JUDGED, base, extended, "elbow")

    def test_nothing_beyond_the_floor(self):
        """Whatever an effect takes away within it is no effect's."""
        assert "nowhere beyond its floor" in against_it(JUDGED, leaving(0.9, 0.9), leaving(0.1, 0.1), "elbow")

    def test_rms_over_the_floor(self):
        np.testing.assert_allclose(over_floor(leaving(3.0, 2.0).residual, FLOOR), [3.0, 2.0])


class TestPositionsThatChooseNothing:
    @staticmethod
    def left(size, positions, seed=0):
        rng = np.random.default_rng(seed)
        shape = (positions, 2, 41, 2)
        noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
        return np.asarray(size).reshape(-1, 1, 1, 1) * 0.1 * noise

    def test_against_a_loop(self):
        """What is beyond the floor run by run and band by band; the interval of the share against the jackknife."""
        before, after = self.left([3, 2, 3, 4, 3, 2], 6), self.left([1, 2, 1, 2, 1, 1], 6, 1)
        frequency = np.arange(41.0)
        found = compared(before, after, FLOOR, frequency)
        edges = band_edges(frequency)

        def beyond(x):
            runs = []
            for run in 0.5 * np.abs(x / 0.1).reshape(12, 41, 2) ** 2:
                more = 0.0
                for low, high in itertools.pairwise(edges):
                    here = run[(frequency >= low) & ((frequency < high) | (high == edges[-1]))]
                    more += np.maximum(here.sum(axis=0) - len(here), 0.0).sum()
                runs.append(more / 82)
            return np.array(runs)

        one, two = beyond(before), beyond(after)
        np.testing.assert_allclose([found.before, found.after], [one.mean(), two.mean()], rtol=1e-12)
        np.testing.assert_allclose(found.gain, 1 - two.sum() / one.sum(), rtol=1e-12)
        left_out = [1 - np.delete(two, i).sum() / np.delete(one, i).sum() for i in range(12)]
        std = np.sqrt(11 / 12 * np.sum((left_out - np.mean(left_out)) ** 2))
        half = scipy.stats.t.ppf(0.95, 11) * std
        np.testing.assert_allclose([found.gain - found.least, found.most - found.gain], half, rtol=0.25)
        drops = one - two
        signs = itertools.product([1, -1], repeat=12)
        assert found.p_value == np.mean([np.dot(s, drops) >= drops.sum() - 1e-9 for s in signs])

    def test_a_p_value_is_what_the_blocks_can_tell(self):
        found = compared(self.left(9.0, 5), self.left(1e-3, 5), FLOOR, np.arange(41.0))
        assert found.p_value == found.finest == 2.0**-10
        few = compared(self.left(9.0, 2), self.left(1e-3, 2), FLOOR, np.arange(41.0))  # by combs of lines, too
        assert few.p_value == few.finest == 2.0**-8

    def test_two_blocks_decide_nothing(self):
        """All that is missed in two of eight blocks: a quarter of all signs makes as much of it."""
        size = np.where(np.arange(4) == 3, 9.0, 1e-3)
        found = compared(self.left(size, 4), self.left(1e-3, 4), FLOOR, np.arange(41.0))
        assert found.p_value == found.finest == 0.25
        assert "p = 0.25" in shows_nothing(found)
        alone = compared(np.ones((1, 1, 4, 1)), np.zeros((1, 1, 4, 1)), 0.1, np.arange(4.0))
        assert alone.p_value == 1.0 and shows_nothing(alone)

    def test_two_that_are_alike(self):
        found = compared(self.left(2.0, 6), self.left(2.0, 6, 1), FLOOR, np.arange(41.0))
        assert found.least < 0 < found.most and found.p_value > 0.05
        within = compared(self.left(0.3, 6), self.left(0.1, 6, 1), FLOOR, np.arange(41.0))
        assert (within.before, within.gain, within.p_value) == (0.0, 0.0, 1.0)

    def test_who_they_are(self):
        """None where there are few; then what is fitted decides."""
        parts = lambda n: split(*(SimpleNamespace(data=made_up(n)),) * 2, None)
        few = parts(3)
        assert [x.tolist() for x in (few.fit, few.select, few.heldout)] == [[0, 1], [0, 1], [2]]
        many = parts(9)
        assert sorted([*many.fit, *many.select, *many.heldout]) == list(range(9))
        assert (len(many.fit), len(many.select), len(many.heldout)) == (4, 2, 3)


class TestStrain:
    """Numbers that are off by more than is known, against Pope's test with all covariances written out."""

    @staticmethod
    def found(robot, x, variance=1e-4):
        uncertain = numbers(robot)
        normal = np.diag(np.where([n.prior > 0 for n in uncertain], 1.0 / variance, 1.0))
        iterate = SimpleNamespace(posterior=SimpleNamespace(normal=normal))
        return Fitted(robot, Tolerances(), uncertain, np.asarray(x, float), iterate, False, (), True)

    def test_against_the_formula(self, robot):
        uncertain = numbers(robot)
        x = np.random.default_rng(0).standard_normal(len(uncertain))
        found = self.found(robot, x)
        known = np.array([n.prior > 0 and n.kind != "smoothing" for n in uncertain])
        for i in np.flatnonzero(known):
            other = known & (np.arange(len(x)) != i)
            factor = min(1.0, np.sum(x[other] ** 2) / (np.sum(other) * (1 - 1e-4)))
            assert found.tolerance_statistic[i] == pytest.approx(x[i] / np.sqrt((1 - 1e-4) * factor))
        assert found.out_of_tolerance == ()

    def test_one_that_stands_out(self, robot):
        """Two tolerances are much where all others are known better than was said."""
        uncertain = numbers(robot)
        place = [n.name for n in uncertain].index("elbow.torque_constant")
        x = np.full(len(uncertain), 0.3)
        x[place] = 2.5
        found = self.found(robot, x)
        assert found.out_of_tolerance == (place,)
        others = sum(n.prior > 0 and n.kind != "smoothing" for n in uncertain) - 1
        expected = 2 * (others + 1) * scipy.stats.t(others).sf(2.5 / 0.3)
        assert found.tolerance_p_values[place] == pytest.approx(expected, rel=0.1)
        assert self.found(robot, 2.5 * np.sign(x)).out_of_tolerance == ()  # all are off: none stands out

    @pytest.mark.parametrize("count", [1, 3, 6, 20])
    def test_false_alarms(self, robot, count):
        """Where every tolerance is what is stated, the least p-value of all numbers is as rare as it says."""
        uncertain = tuple(n for n in numbers(robot) if n.prior > 0 and n.kind != "smoothing")[:count]
        rng, draws, least = np.random.default_rng(0), 500, []
        iterate = SimpleNamespace(posterior=SimpleNamespace(normal=np.eye(count) * 1e4))
        for _ in range(draws):
            found = Fitted(robot, Tolerances(), uncertain, rng.standard_normal(count), iterate, False, (), True)
            least.append(found.tolerance_p_values[int(np.argmax(np.abs(found.tolerance_statistic)))])
        assert scipy.stats.binom.sf(np.sum(np.array(least) < 0.05) - 1, draws, 0.05) > 1e-3


class TestWaves:
    """How sure the amplitude and phase of ripple are, against draws of its sine and cosine."""

    def test_amplitude_and_phase(self):
        rng = np.random.default_rng(0)
        covariance = 1e-6 * np.array([[2.0, 0.9], [0.9, 0.7]])
        draws = rng.multivariate_normal([0.3, -0.4], covariance, 200_000)
        amplitude, phase = np.hypot(*draws.T), np.arctan2(draws[:, 1], draws[:, 0])
        found = polar_deviation(0.5, np.arctan2(-0.4, 0.3), covariance)
        assert found["amplitude"] == pytest.approx(amplitude.std(), rel=0.01)
        assert found["phase"] == pytest.approx(phase.std(), rel=0.01)

    def test_of_one_motor(self, robot):
        """Its own rows of the posterior, each as wide as its interval."""
        orders = (Order("torque", 0, 2.0), Order("torque", 1, 3.0), Order("torque", 1, 7.0))
        jackknifed = np.random.default_rng(1).standard_normal((6, 8))  # two numbers before the sines and cosines
        posterior = Posterior(np.zeros(8), 1.0, np.eye(8), jackknifed, np.zeros(8))
        iterate = SimpleNamespace(posterior=posterior, orders=orders)
        found = Fitted(robot, Tolerances(), (), np.zeros(0), iterate, False, (), True).wave_covariance("torque", 1)
        assert sorted(found) == [3.0, 7.0]
        expected = np.cov(jackknifed[:, 6:], rowvar=False, bias=True) * 5.0  # of a jackknife: (n - 1) mean squares
        np.testing.assert_allclose(found[7.0], expected * (scipy.stats.t.ppf(0.975, 5) / 1.959964) ** 2, rtol=1e-5)


class TestHypotheses:
    @staticmethod
    def view(robot):
        uncertain = numbers(robot)
        return Fitted(robot, Tolerances(), uncertain, np.zeros(len(uncertain)), None, False, (), False)

    def unknown(self, robot, effect):
        found = hypothesis(self.view(robot), effect, effect.joint)
        uncertain = numbers(found.robot.with_tolerances(found.unknown))
        own = {o.number for o in found.own}
        return found, {n.name: n.given for n in uncertain if n.name in own}

    @pytest.mark.parametrize(
        ("effect", "own"),
        [
            (fx.TorqueDelay("elbow", 3e-4), {"elbow.delay": 3e-4}),
            (fx.Backlash("elbow", 2e-4), {"elbow.backlash": 2e-4}),
            (fx.StiffnessHardening("elbow", 0.6, 3e-4), {"elbow.stiffness_ratio": 0.6, "elbow.stiffness_knee": 3e-4}),
            (
                fx.ExtraFlexibility("elbow", [0.0, 1.0, 0.0], 5e5, 90.0),
                {"elbow_flexibility.stiffness": 5e5, "elbow_flexibility.damping": 90.0},
            ),
            (
                fx.GearHysteresis("elbow", 5.0, 1e-4),
                {"elbow.gear_hysteresis.torque": 5.0, "elbow.gear_hysteresis.slip": 1e-4},
            ),
            (fx.WristCoupling("elbow", 0.02), {"elbow.wrist_coupling.ratio": 0.02}),
        ],
    )
    def test_parameters_are_numbers(self, effect, own):
        found, given = self.unknown(small_robot(), effect)
        assert given == pytest.approx(own)
        assert found.key == (effect.name, "elbow")

    def test_a_number_that_the_robot_has_is_set_free(self):
        """What it is off by is the effect's."""
        found, given = self.unknown(small_robot(), fx.CoulombFriction("elbow", 0.05))
        assert given == pytest.approx({"elbow.coulomb_friction": 0.1}) and found.own[0].minus == 0.1
        assert numbers(found.robot) == numbers(small_robot())

    def test_what_is_nothing_before(self, robot):
        smooth = jf.robot.with_parameters(robot, {"elbow.coulomb_friction": 0.0})
        found, given = self.unknown(smooth, fx.CoulombFriction("elbow", 0.05))
        assert given == pytest.approx({"elbow.coulomb_friction": 0.05}) and found.own[0].minus == 0.0

    @pytest.mark.parametrize(
        ("stated", "more", "number"),
        [
            (fx.TorqueDelay("elbow", 5e-4), fx.TorqueDelay("elbow", 3e-4), "elbow.delay"),
            (fx.TorqueConstant("elbow", 0.05), fx.TorqueConstant("elbow", -0.02), "elbow.torque_constant"),
        ],
    )
    def test_what_the_robot_states_is_not_missing(self, stated, more, number):
        """The number is the sum, what is missing is the rest."""
        found, _ = self.unknown(small_robot().with_effects(stated), more)
        field = found.own[0].parameter
        assert [(o.number, o.minus) for o in found.own] == [(number, getattr(stated, field))]

    def test_one_of_a_kind(self):
        """A second one would be taken for the number of the first."""
        effect = fx.StribeckFriction("elbow", 0.1, 3.0)
        assert is_had(small_robot().with_effects(fx.StribeckFriction("elbow", 0.05, 3.0)), effect, set())
        assert not is_had(small_robot().with_effects(fx.StribeckFriction("shoulder", 0.05, 3.0)), effect, set())
        assert not is_had(
            small_robot().with_effects(fx.TorqueDelay("elbow", 5e-4)), fx.TorqueDelay("elbow", 1e-4), set()
        )

    def test_what_cannot_be(self):
        assert hypothesis(self.view(small_robot(stiffness=np.inf)), fx.Backlash("elbow", 1e-4), "elbow") is None


class TestCounts:
    """Encoders whose counts are seen in the readings."""

    @staticmethod
    def found(robot, count):
        slow = np.cumsum(np.random.default_rng(0).standard_normal((1, 2, 4000, 2)), axis=2) * 1e-3
        data = SimpleNamespace(y_quantity="position", y=np.round(slow / count) * count)
        return [(x.name, x.joint) for x in counting(SimpleNamespace(data=data), robot)]

    def test_coarse_ones_that_the_robot_does_not_state(self):
        robot = small_robot()
        size = float(fx.EncoderQuantisation.typical(robot, "elbow").resolution)
        assert self.found(robot, size) == [("encoder_quantisation", name) for name in robot.axis_names]
        assert self.found(robot, 0.1 * size) == []  # of no harm
        assert self.found(robot.with_effects(fx.EncoderQuantisation("elbow", size)), size) == [
            ("encoder_quantisation", "shoulder")
        ]


@pytest.mark.parametrize(("runs", "lines"), [(1, 12), (1, 40), (2, 9), (6, 5)])
def test_blocks_of_few_lines(runs, lines):
    """Each of them holds some: what is beyond the floor is known everywhere."""
    left = 3.0 * np.ones((1, runs, lines, 2), complex)
    found = beyond(left, np.ones((lines, 2)), np.arange(lines) * 1.0)
    assert np.all(np.isfinite(found)) and np.all(found > 0)


def test_courses_of_a_short_period():
    """Samples of a period that is shorter than what is shown stay inside it."""
    places = shown_samples(500)
    assert places.min() == 0 and places.max() == 499


def test_candidates_that_are_fitted():
    """Those that promise most of what can be seen, or more than half of all, whatever is thought to be visible, and a
    number whose tolerance cannot be true."""
    made = lambda joint, part, size=1.0, disbelieved=False: Scored(
        fx.MotorInertia(joint, 1e-4), joint, part, 1.0, size, disbelieved
    )
    unseen, best, near, far = made("a", 0.4, 0.1), made("b", 0.2), made("c", 0.1), made("d", 0.05)
    number = made("e", 0.001, disbelieved=True)
    assert chosen([unseen, best, near, far, number], ()) == [best, near, number]
    assert chosen([best, made("b", 0.1)], ()) == [best]
    assert chosen([unseen, number], ()) == [number]
    assert chosen([unseen, made("c", 0.001)], ()) == []
    assert chosen([most := made("a", 0.9, 0.1), best], ()) == [most]


def test_what_takes_most_away_is_visible():
    """Whatever its class takes for visible on this robot: of a cost of 36, 16 is less than half and 25 is more."""
    left = lambda by: SimpleNamespace(
        left=np.full((1, 1, 1, 1), by),
        prior_cost=0.0,
        iterate=SimpleNamespace(posterior=SimpleNamespace(effect=1.0), evidence=SimpleNamespace(plain=np.ones((1, 1)))),
    )
    takes_most = lambda by: Round._takes_most(SimpleNamespace(now=left(6.0)), SimpleNamespace(found=left(by)))
    assert takes_most(4.0) and not takes_most(5.0)


def test_neighbouring_orders_that_are_told_together_only_are_not_named():
    """Where a motor hardly turns, orders 1 and 2 cancel: each may be anything."""
    order = lambda value, std: SimpleNamespace(value=value, std=std)
    told = lambda **values: {"order_1": order(1.0, np.nan), **values}
    assert holds_no_ripple(told(amplitude_1=order(0.030, 0.077), amplitude_2=order(0.026, 0.066)))
    assert not holds_no_ripple(told(amplitude_1=order(0.030, 0.077), amplitude_2=order(0.026, 0.006)))
    assert not holds_no_ripple(told(amplitude=order(0.030, 0.010)))


def test_what_a_spring_is_confused_with_is_fitted_beside_it():
    """Play, to first order, is what a spring's own numbers are: what it promises beside them says nothing."""
    made = lambda effect, part: Scored(effect, effect.joint, part, 1.0, 1.0)
    soft, play = fx.StiffnessHardening("shoulder", 0.3), made(fx.Backlash("shoulder", 3e-4), 0.01)
    others = [made(fx.Backlash("elbow", 3e-4), 0.02), made(fx.MotorInertia("shoulder", 1e-4), 0.3)]
    beside = lambda scored, effect, had: confused(scored, effect, (effect.name, effect.joint), had, small_robot())
    assert beside([*others, play], soft, ()) == [play]
    assert beside([*others, play], soft, [(play.effect, play.key)]) == []
    assert beside([play], fx.MotorInertia("shoulder", 1e-4), ()) == []


def test_what_a_number_is_confused_with_is_not_in_its_way():
    """An effect that was tried for a number, and that positions which decide refuse, leaves the number to be judged."""
    rubs, damps = fx.ViscousFriction("shoulder", 1e-3), fx.ArmViscousFriction("shoulder", 1.0)

    def made(effect, is_number=False):
        return SimpleNamespace(effect=effect, joint=effect.joint, key=(effect.name, effect.joint), is_number=is_number)

    assert is_number_confused_with(made(rubs, True), made(damps))
    assert not is_number_confused_with(made(rubs), made(damps))
    assert not is_number_confused_with(made(rubs, True), made(fx.ArmViscousFriction("elbow", 1.0)))
    assert not is_number_confused_with(made(rubs, True), made(fx.MotorInertia("shoulder", 1e-4)))


def test_what_promises_nothing_is_fitted_beside_what_it_is_confused_with():
    """A damper of the arm is what the motor's viscous friction is: nothing is left for it to first order."""
    robot, rubs = small_robot(), fx.ViscousFriction("shoulder", 1e-3)
    (damper,) = confused([], rubs, (rubs.name, rubs.joint), (), robot)
    assert damper.key == ("arm_viscous_friction", "shoulder") and damper.part == 0.0
    assert float(damper.effect.coefficient) == float(fx.ArmViscousFriction.typical(robot, "shoulder").coefficient)


def test_candidates_are_compared_over_the_highest_of_their_floors():
    """A robot without a steady torque has no floor there: one that gives it, and misses a hundredth, is better."""

    def fitted(floor, left, prior=0.0):
        evidence = SimpleNamespace(plain=np.array(floor))
        iterate = SimpleNamespace(evidence=evidence, posterior=SimpleNamespace(effect=2.0))
        return SimpleNamespace(iterate=iterate, left=np.array(left), prior_cost=prior)

    without, with_it = fitted([1e-4, 1.0], [2.0, 9.0]), fitted([0.01, 1.0], [0.02, 1.0], 3.0)
    np.testing.assert_allclose(costs_of([with_it, without]), [(2**2 + 1) / 2 + 3, (200**2 + 81) / 2])


def test_rivals_that_are_named_too():
    """Two effects that both act are no alternatives, nor are two names of one law."""
    rival = lambda name, near: SimpleNamespace(key=(name, "elbow"), near=near)
    step = lambda effect, *rivals: SimpleNamespace(
        key=(effect.name, "elbow"), hypothesis=SimpleNamespace(effect=effect), rivals=rivals
    )
    balance, play = fx.Counterbalance("elbow", 20.0), fx.Backlash("elbow", 1e-4)
    first = step(balance, rival("backlash", True), rival("torque_delay", False), rival("dress_pack", True))
    assert close_rivals((first,)) == [("backlash", "elbow")]
    assert close_rivals((first, step(play))) == []


def test_bands_against_a_loop():
    frequency, floor = np.arange(81) * 0.5, np.full((81, 2), 0.2)
    left = np.random.default_rng(0).standard_normal((3, 2, 81, 2)) * (1 + 1j)
    edges = band_edges(frequency)
    assert edges[0] == 0.0 and edges[-1] == 40.0
    found = by_band(left, floor, frequency)
    assert found.shape == (3, 2, 2, len(edges) - 1)
    for band, (low, high) in enumerate(itertools.pairwise(edges)):
        here = (frequency >= low) & ((frequency < high) | (band == len(edges) - 2))
        expected = 0.5 * np.mean(np.abs(left[:, :, here] / 0.2) ** 2, axis=2)
        np.testing.assert_allclose(found[..., band], expected, rtol=1e-12)
    few = band_edges(np.array([0.0, 7.0, 14.0, 21.0]))  # no line in some bands
    assert np.all(np.diff(few) > 0) and by_band(left[:, :, :4], floor[:4], np.array([0.0, 7, 14, 21])).shape[-1] == 3


def test_gears_that_are_rigid_take_no_effect_of_a_spring():
    """A wrist's coupling too, which a robot with rigid gears may have but which no simulation of it knows."""
    from jaxfrf.gap.simulated.candidates import candidates

    names = {(c.name, c.joint) for c in candidates(small_robot(stiffness=np.inf), np.ones(2))}
    assert ("wrist_coupling", "elbow") not in names and ("gear_hysteresis", "elbow") not in names
    assert ("wrist_coupling", "elbow") in {(c.name, c.joint) for c in candidates(small_robot(), np.ones(2))}


class TestAlike:
    """Robots whose ripple differs share what is compiled, and are what they were."""

    WAVES = (
        ((Order("torque", 0, 6.0), (3.0, 4.0)), (Order("resolver", 1, 2.0), (-5e-4, 1e-3))),
        ((Order("torque", 1, 41.0), (0.1, 0.2)), (Order("torque", 1, 3.0), (-0.1, 0.0))),
        (),
    )

    def test_one_structure(self):
        robots = [alike(small_robot(), waves) for waves in self.WAVES]
        robots += [alike_as_written(with_ripple(small_robot(), waves)) for waves in self.WAVES]
        assert len({jax.tree.structure(robot) for robot in robots}) == 1
        shapes = [[np.shape(x) for x in jax.tree.leaves(robot)] for robot in robots]
        assert all(shape == shapes[0] for shape in shapes)

    @pytest.mark.parametrize("waves", WAVES)
    def test_the_same_ripple(self, waves):
        angle = np.linspace(-4.0, 9.0, 50)
        stated = with_ripple(small_robot(), waves)
        laws = {fx.TorqueRipple: lambda e: e.torque(angle), fx.ResolverRipple: lambda e: e.measured(angle) - angle}
        for robot in (alike(small_robot(), waves), alike_as_written(stated)):
            for kind, law in laws.items():
                for joint in robot.axis_names:
                    mine, theirs = (
                        [law(e) for e in r.effects if isinstance(e, kind) and e.joint == joint] for r in (robot, stated)
                    )
                    np.testing.assert_allclose(mine, theirs or [0.0 * angle], atol=1e-12)

    def test_orders_that_no_program_learns(self):
        angle = np.linspace(-4.0, 9.0, 50)
        stated = fx.TorqueRipple("elbow", [0.1], (72,))
        ripple = [e for e in alike_as_written(small_robot().with_effects(stated)).effects if e.name == stated.name]
        (found,) = [e for e in ripple if np.max(e.order) == 72]
        np.testing.assert_allclose(found.torque(angle), stated.torque(angle))

    def test_a_gain_before_a_drive_that_clips(self):
        """Clipped behind its gain, and so it stays."""
        drive = fx.TorqueConstant("elbow", 0.1), fx.TorqueSaturation("elbow", 3.0)
        found = alike(small_robot().with_effects(*drive)).effects
        assert [type(e) for e in found if isinstance(e, type(drive[0]) | type(drive[1]))] == [type(e) for e in drive]


def test_two_that_stand_for_each_other_on_one_joint():
    """Play and a spring that hardens, both on one joint, are one law more often than two."""
    named = lambda effect: SimpleNamespace(effect=effect, name=effect.name, joint=effect.joint)
    play, bent = fx.Backlash("elbow", 1e-4), fx.StiffnessHardening("elbow", 0.1, 1e-4)
    pair = [named(play), named(fx.TorqueDelay("elbow", 1e-3)), named(bent)]
    assert {x.name for x in stand_for_each_other(pair)} == {"backlash", "stiffness_hardening"}
    assert stand_for_each_other([named(play), named(fx.StiffnessHardening("shoulder", 0.1, 1e-4))]) == ()
    assert stand_for_each_other(pair[:2]) == ()


def test_an_axis_that_got_worse_is_told():
    """Within the floor, too: whoever reads the figures finds it there."""
    before, after = np.array([0.0167, 0.05]), np.array([0.0187, 0.051])
    assert (
        worse_words(("joint3", "joint4"), before, after)
        == " The torque of joint3 is missed by 1.9 % there, 1.7 % before."
    )


@pytest.mark.parametrize(
    ("left", "worst", "verdict"),
    [(0.3, 30.0, "named"), (4.0, 30.0, "named"), (0.3, 90.0, "named"), (4.0, 90.0, "unexplained")],
)
def test_an_effect_that_leaves_much_stands_for_another(left, worst, verdict, monkeypatch):
    """Much is both: many times the floor, and a good part of a torque."""
    monkeypatch.setattr("jaxfrf.gap.simulated.conclude._named_words", lambda *given: "")
    found = SimpleNamespace(name="arm_viscous_friction", joint="elbow")
    last = SimpleNamespace(x=np.zeros(2), robot=leaving(1.0, 1.0).robot)
    told, says = _verdict(
        leaving(9.0, 40.0), True, [], [found], (), last, leaving(0.3, left), JUDGED, worst, heldout=True
    )
    assert told == verdict
    assert ("nearest that it holds is arm viscous friction on elbow" in says) == (verdict == "unexplained")


def test_a_wrong_mass_of_the_last_link_asks_for_a_load():
    (question,) = untold({"elbow.mass", "elbow.stiffness"}, small_robot())
    assert "a load that nobody told" in question
    assert not untold({"shoulder.mass", "elbow.stiffness"}, small_robot())
