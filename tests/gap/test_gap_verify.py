"""What keeps a diagnosis from naming what is not there: intervals, sealed positions, rivals that are named too."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from two_axes import ROBOT

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.gap import verify
from jaxfrf.gap.present import _close_rivals
from jaxfrf.gap.refine import absent
from jaxfrf.gap.search import _Trial
from jaxfrf.gap.verify import _against, motors_ripple, over_floor
from jaxfrf.trajectory.evidence import band_edges, by_band

FLOOR = np.full((41, 2), 0.1)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "two.toml"
    path.write_text(ROBOT)
    return jf.io.read_robot(path)


def made_search(sealed=(False, True, True)):
    """Of a record with a torque of 1 N m in every line."""
    opened = ~np.array(sealed)
    base = SimpleNamespace(evidence=SimpleNamespace(plain=FLOOR))
    record = SimpleNamespace(U=np.ones((3, 2, 41, 2), complex))
    given = SimpleNamespace(axis_names=("shoulder", "elbow"))
    return SimpleNamespace(opened=opened, base=base, record=record, given=given)


def leaving(opened, sealed):
    """A robot that leaves so many floors on the fitted and on the sealed positions, one number for each axis."""
    one = lambda times: np.sqrt(2) * FLOOR * np.asarray(times) * np.ones((1, 2, 41, 2))
    return SimpleNamespace(residual=np.concatenate([one(opened), one(sealed), one(sealed)]).astype(complex))


class TestSealedPositions:
    @pytest.mark.parametrize(
        ("joint", "sealed", "says"),
        [
            ("shoulder", [1.0, 1.1], None),  # both axes gain
            ("shoulder", [1.0, 2.0], None),  # one does, the other stays
            ("shoulder", [1.0, 2.1], None),  # or loses little beside that
            ("", [1.0, 1.9], None),
            ("shoulder", [3.0, 2.0], "the gap is 2.55 times the floor, 2.55 without"),  # nothing gained
            ("shoulder", [1.0, 2.5], "elbow rises from 2 to 2.5"),  # one pays for the other
            ("shoulder", [4.0, 2.0], "the gap is 3.16"),
            ("elbow", [1.0, 2.1], "the torque of elbow itself"),  # its own joint loses
        ],
    )
    def test_gap_of_every_axis(self, joint, sealed, says):
        """Whatever the fitted positions say."""
        base, extended = leaving([9.0, 9.0], [3.0, 2.0]), leaving([0.1, 0.1], sealed)
        against = _against(made_search(), base, extended, joint)
        assert (against is None) if says is None else (says in against)

    def test_an_axis_within_its_floor_may_move(self):
        """But not that of the effect itself."""
        base, extended = leaving([9.0, 9.0], [3.0, 0.3]), leaving([0.1, 0.1], [1.0, 0.6])
        assert _against(made_search(), base, extended, "shoulder") is None
        assert "torque of elbow itself" in _against(made_search(), base, extended, "elbow")

    def test_none_are_sealed(self):
        search = made_search((False, False, False))
        base, extended = leaving([3.0, 3.0], [3.0, 3.0]), leaving([1.0, 1.0], [1.0, 1.0])
        assert _against(search, base, extended, "elbow") is None
        np.testing.assert_allclose(over_floor(base.residual, FLOOR, verify.judged_positions(search)), 3.0)

    @pytest.mark.parametrize(
        ("first", "both", "kept"),
        [
            ([1.5, 1.5], [1.0, 1.0], 2),
            ([1.0, 1.0], [1.0, 1.0], 1),  # the second one is imaginary: smaller than the base's, no smaller than that
            ([1.0, 1.0], [0.2, 4.0], 1),
            ([3.5, 1.0], [1.0, 1.0], 2),  # the first one shows only beside the second
            ([3.5, 1.0], [4.0, 1.0], 0),
        ],
    )
    def test_every_effect_must_gain(self, monkeypatch, first, both, kept):
        key = lambda name: SimpleNamespace(option=SimpleNamespace(key=(name, "elbow")), effect=name, stage=name)
        steps = (key("torque_delay"), key("backlash"))
        leaves = [leaving([9, 9], [3, 3]), leaving([1, 1], first), leaving([0.5, 0.5], both)]
        monkeypatch.setattr(verify, "written", lambda setting, stage, effects: leaves[len(effects)])
        monkeypatch.setattr(verify, "Verified", lambda *fields: fields)
        search = made_search()
        search.setting, search.steps = None, steps
        base, stands, extended, refused = verify.verified(search)
        assert (base, stands, extended) == (leaves[0], steps[:kept], leaves[kept])
        assert len(refused) == 2 - kept
        assert all("was taken back" in text for text in refused)


class TestIntervals:
    @staticmethod
    def sure(robot, effect, std):
        option = SimpleNamespace(key=(effect.name, effect.joint))
        trial = SimpleNamespace(
            fitted=SimpleNamespace(effect=effect, std=std), view=SimpleNamespace(robot=robot), option=option
        )
        return _Trial.is_sure(trial, lambda text: None)

    def test_a_level_of_none(self, robot):
        assert self.sure(robot, fx.CoulombFriction("elbow", -0.1), (0.05,))
        assert not self.sure(robot, fx.CoulombFriction("elbow", 0.1), (0.06,))

    def test_a_stiffness_that_may_be_infinite(self, robot):
        """The case that was named once: 3.7e6 +- 5.8e6 N m/rad (95 %)."""
        assert not self.sure(robot, fx.ExtraFlexibility("elbow", [0, 0, 1], 3.7e6, 700.0), (5.8e6 / 1.96, 1.0))
        assert self.sure(robot, fx.ExtraFlexibility("elbow", [0, 0, 1], 3.7e5, 70.0), (5e4, 1.0))

    def test_a_spring_that_is_as_it_was(self, robot):
        """A ratio of one is no hardening, not a ratio of zero."""
        hard = lambda ratio: fx.StiffnessHardening("elbow", ratio, 1e-4)
        assert absent(hard(0.5), robot) == 1.0
        assert not self.sure(robot, hard(0.9), (0.06, 1e-5))
        assert self.sure(robot, hard(0.6), (0.1, 1e-5))
        bent = robot.with_effects(hard(0.7))
        assert not self.sure(bent, hard(0.6), (0.06, 1e-5))


def test_rivals_that_are_named_too():
    """Two effects that both act are no alternatives."""
    rival = lambda name, near: SimpleNamespace(option=SimpleNamespace(key=(name, "elbow")), near=near)
    step = lambda name, *rivals: SimpleNamespace(
        option=SimpleNamespace(key=(name, "elbow")), effect=SimpleNamespace(name=name), rivals=rivals
    )
    rivals = (rival("backlash", True), rival("stiffness_hardening", False), rival("current_loop_lag", True))
    first = step("torque_delay", *rivals)
    assert _close_rivals((first,), first) == [("backlash", "elbow")]
    assert _close_rivals((first, step("backlash")), first) == []


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


def test_ripple_that_is_written_is_what_was_fitted(robot):
    """A cos, b sin of the columns as amplitude and phase of the effect; what is unsure is left out."""
    from jaxfrf.gap.score import BaseFit, Gram, Limits
    from jaxfrf.trajectory.ripple import Order

    orders = (Order("torque", 1, 6.0), Order("resolver", 0, 2.0), Order("torque", 1, 9.0))
    c = np.array([3.0, 4.0, -5.0, 12.0, 1e-3, 0.0])
    gram = Gram(np.eye(6)[None] * 1e2, c[None] * 1e2, np.array([1.0]), np.zeros(1, int), 100)
    free = np.full(6, np.inf)
    fit = BaseFit(np.arange(6), Limits.between(-free, free), c, free > 0, 1.0, 1.0, 1.0, np.array([True]))
    stage = SimpleNamespace(fit=fit, knobs=(), orders=orders, weighed=SimpleNamespace(gram=gram), robot=robot)
    torque, resolver = sorted(motors_ripple(stage), key=lambda effect: effect.name, reverse=True)
    assert (torque.joint, torque.order) == ("elbow", (6,)) and (resolver.joint, resolver.order) == ("shoulder", (2,))
    angle = np.linspace(0.0, 6.0, 7)
    np.testing.assert_allclose(torque.torque(angle), 3.0 * np.sin(6 * angle) + 4.0 * np.cos(6 * angle), atol=1e-12)
    expected = angle - 5.0 * np.sin(2 * angle) + 12.0 * np.cos(2 * angle)
    np.testing.assert_allclose(resolver.measured(angle), expected, atol=1e-12)


def test_gears_that_are_rigid_take_no_effect_of_a_spring():
    """A wrist's coupling too, which a robot with rigid gears may have but which no simulation of it knows."""
    from small_arm import small_robot

    from jaxfrf.gap.candidates import candidates

    names = {(c.name, c.joint) for c in candidates(small_robot(stiffness=np.inf), np.ones(2))}
    assert ("wrist_coupling", "elbow") not in names and ("gear_hysteresis", "elbow") not in names
    assert ("wrist_coupling", "elbow") in {(c.name, c.joint) for c in candidates(small_robot(), np.ones(2))}
