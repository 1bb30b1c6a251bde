"""What keeps a diagnosis from naming what is not there: positions that choose nothing, and sealed ones."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
from test_gap import made_up, small_robot
from two_axes import ROBOT

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.calibration.numbers import numbers
from jaxfrf.gap.conclude import against_it, close_rivals
from jaxfrf.gap.contest import Records
from jaxfrf.gap.diagnose import split
from jaxfrf.gap.fitted import Fitted
from jaxfrf.gap.hypothesis import hypothesis
from jaxfrf.gap.judge import compared, over_floor
from jaxfrf.robot import Tolerances
from jaxfrf.trajectory.evidence import band_edges, by_band

FLOOR = np.full((41, 2), 0.1)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "two.toml"
    path.write_text(ROBOT)
    return jf.io.read_robot(path)


def made_records(sealed=(1, 2)):
    """Of a record with a torque of 1 N m in every line."""
    whole = SimpleNamespace(U=np.ones((3, 2, 41, 2), complex), frequency=np.arange(41.0))
    fit = np.setdiff1d(np.arange(3), sealed)
    return Records(whole, fit, fit, np.array(sealed, int))


def leaving(opened, sealed):
    """A robot that leaves so many floors on the fitted and on the sealed positions, one number for each axis."""
    one = lambda times: np.sqrt(2) * FLOOR * np.asarray(times) * np.ones((1, 2, 41, 2))
    return SimpleNamespace(
        residual=np.concatenate([one(opened), one(sealed), one(sealed)]).astype(complex),
        evidence=SimpleNamespace(plain=FLOOR),
        robot=SimpleNamespace(axis_names=("shoulder", "elbow")),
    )


class TestSealedPositions:
    @pytest.mark.parametrize(
        ("joint", "sealed", "says"),
        [
            ("shoulder", [1.0, 1.1], ""),  # both axes gain
            ("shoulder", [1.0, 2.0], ""),  # one does, the other stays
            ("shoulder", [1.0, 2.1], ""),  # or loses little beside that
            ("", [1.0, 1.9], ""),
            ("shoulder", [3.0, 2.0], "the gap is 2.55 times the floor, 2.55 without"),  # nothing gained
            ("shoulder", [1.0, 2.5], "elbow rises from 2 to 2.5"),  # one pays for the other
            ("shoulder", [4.0, 2.0], "the gap is 3.16"),
            ("elbow", [1.0, 2.1], "the torque of elbow itself"),  # its own joint loses
        ],
    )
    def test_gap_of_every_axis(self, joint, sealed, says):
        """Whatever the fitted positions say."""
        base, extended = leaving([9.0, 9.0], [3.0, 2.0]), leaving([0.1, 0.1], sealed)
        against = against_it(made_records(), base, extended, joint)
        assert (says in against) if says else against == ""

    def test_an_axis_within_its_floor_may_move(self):
        """But not that of the effect itself."""
        base, extended = leaving([9.0, 9.0], [3.0, 0.3]), leaving([0.1, 0.1], [1.0, 0.6])
        assert against_it(made_records(), base, extended, "shoulder") == ""
        assert "torque of elbow itself" in against_it(made_records(), base, extended, "elbow")

    def test_none_are_sealed(self):
        records = made_records(())
        base, extended = leaving([3.0, 3.0], [3.0, 3.0]), leaving([1.0, 1.0], [1.0, 1.0])
        assert against_it(records, base, extended, "elbow") == ""
        np.testing.assert_allclose(over_floor(base.residual, FLOOR, records.judged), 3.0)


class TestPositionsThatChooseNothing:
    @staticmethod
    def left(size, positions, seed=0):
        rng = np.random.default_rng(seed)
        shape = (positions, 2, 41, 2)
        return (
            np.asarray(size).reshape(-1, 1, 1, 1) * 0.1 * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
        )

    def test_against_a_paired_interval(self):
        """Of the squares of every position, as SciPy has it."""
        before, after = self.left([3, 2, 3, 4, 3, 2], 6), self.left([1, 2, 1, 2, 1, 1], 6, 1)
        found = compared(before, after, FLOOR, np.arange(41.0))
        one, two = (np.sum(np.abs(x / 0.1) ** 2, axis=(1, 2, 3)) for x in (before, after))
        interval = scipy.stats.ttest_rel(one, two).confidence_interval(0.9)
        np.testing.assert_allclose([found.least, found.most], 6 * np.array(interval) / one.sum(), rtol=1e-10)
        np.testing.assert_allclose(found.gain, 1 - two.sum() / one.sum(), rtol=1e-10)
        drops = one - two
        signs = itertools.product([1, -1], repeat=6)
        assert found.p_value == np.mean([np.dot(s, drops) >= drops.sum() - 1e-9 for s in signs])

    def test_a_p_value_is_what_the_blocks_can_tell(self):
        found = compared(self.left(9.0, 5), self.left(1e-3, 5), FLOOR, np.arange(41.0))
        assert found.p_value == 2.0**-5
        few = compared(self.left(9.0, 2), self.left(1e-3, 2), FLOOR, np.arange(41.0))  # by bands of lines, too
        assert few.p_value == 1 / 4096

    def test_two_that_are_alike(self):
        found = compared(self.left(2.0, 6), self.left(2.0, 6, 1), FLOOR, np.arange(41.0))
        assert found.least < 0 < found.most and found.p_value > 0.05

    def test_who_they_are(self):
        """None where there are few; then what is fitted decides."""
        whole = lambda n: SimpleNamespace(data=made_up(n))
        few = split(whole(3), None)
        assert [x.tolist() for x in (few.fit, few.select, few.sealed)] == [[0, 1], [0, 1], [2]]
        many = split(whole(9), None)
        assert sorted([*many.fit, *many.select, *many.sealed]) == list(range(9))
        assert (len(many.fit), len(many.select), len(many.sealed)) == (4, 2, 3)


class TestHypotheses:
    @staticmethod
    def view(robot):
        return Fitted(robot, Tolerances(), numbers(robot), None, False)

    def unknown(self, robot, effect):
        found = hypothesis(self.view(robot), effect, effect.joint)
        these = numbers(found.robot.with_tolerances(found.unknown))
        own = {o.number for o in found.own}
        return found, {n.name: n.given for n in these if n.name in own}

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

    def test_what_cannot_be(self):
        assert hypothesis(self.view(small_robot(stiffness=np.inf)), fx.Backlash("elbow", 1e-4), "elbow") is None


def test_rivals_that_are_named_too():
    """Two effects that both act are no alternatives, nor are two names of one law."""
    rival = lambda name, near: SimpleNamespace(key=(name, "elbow"), near=near)
    step = lambda name, *rivals: SimpleNamespace(key=(name, "elbow"), rivals=rivals)
    first = step("counterbalance", rival("backlash", True), rival("torque_delay", False), rival("dress_pack", True))
    assert close_rivals((first,)) == [("backlash", "elbow")]
    assert close_rivals((first, step("backlash"))) == []


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
    from jaxfrf.gap.candidates import candidates

    names = {(c.name, c.joint) for c in candidates(small_robot(stiffness=np.inf), np.ones(2))}
    assert ("wrist_coupling", "elbow") not in names and ("gear_hysteresis", "elbow") not in names
    assert ("wrist_coupling", "elbow") in {(c.name, c.joint) for c in candidates(small_robot(), np.ones(2))}
