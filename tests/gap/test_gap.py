"""Diagnosis of missing effects from multisine records: its pieces against plain NumPy and against simulations, and the
whole on a small robot in which something is hidden."""

import dataclasses
import json
import operator
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from marks import slow
from small_arm import FS, PERIOD, STEPS, Q, made_up, record, small_robot

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.gap import diagnose
from jaxfrf.gap.simulated.quantised import resolution
from jaxfrf.gap.simulated.records import opened_positions, split
from jaxfrf.gap.simulated.rounds import PART_FILES
from jaxfrf.parts import Parts
from jaxfrf.robot import linearise, motor_directions, operating_point, parameters, with_parameters
from jaxfrf.simulation import Motion, replay_motion
from jaxfrf.trajectory.evidence import Evidence
from jaxfrf.trajectory.frozen import frozen, other_impedance
from jaxfrf.trajectory.joined import joined
from jaxfrf.trajectory.measured import fewer, measured
from jaxfrf.trajectory.scene import Scene
from jaxfrf.trajectory.signature import signature


def changed(data, **fields):
    return dataclasses.replace(data, **fields)


def rms(x):
    return np.sqrt(np.mean(np.abs(x) ** 2))


class Drag(fx.AbstractFriction):
    """An effect that the library does not hold: drag against the motor that grows with the square of its speed."""

    name: ClassVar = "drag"
    units: ClassVar = {"coefficient": "N m s^2/rad^2"}
    bounds: ClassVar = {"coefficient": (0.0, 1e-2)}
    signature: ClassVar = "torque residual grows with the square of the speed"
    confusable: ClassVar = {"viscous_friction": "another amplitude of the slow motion"}

    joint: int | str = eqx.field(static=True)
    coefficient: jax.Array | float

    @classmethod
    def typical(cls, robot, joint):
        return cls(joint, 2e-5)

    def torque(self, speed, load):
        return self.coefficient * speed * jnp.abs(speed)


class TestFrozen:
    """The robot with its motors held, or moved, against the library's FRF and against one solve for all unknowns."""

    @staticmethod
    def one(robot, q):
        z = np.asarray(operating_point(robot, q).z)
        rng = np.random.default_rng(0)
        waves = np.sin(2 * np.pi * np.arange(400)[:, None] / 400 + rng.uniform(0, 6, (1, 2, 1, robot.dof)))
        move = 1e-4 * waves * np.where(np.arange(robot.dof) < robot.n_motors, 100.0, 1.0)
        signal = np.zeros((1, 2, 400, robot.n_axes))
        motion = Motion(signal, signal, z + move, 400.0)
        frequency = np.array([0.0, 3.0, 11.0, 19.0, 42.0])
        return frozen(robot, motion, q[None], frequency, motion.fs)[0], motion

    @pytest.mark.parametrize(
        "rigid",
        [
            pytest.param(False, id="flexible", marks=pytest.mark.slow),
            pytest.param(True, id="rigid elbow and an elastic joint"),
        ],
    )
    def test_against_the_frf_and_one_solve(self, rigid):
        robot = small_robot()
        if rigid:
            hinge = fx.ExtraFlexibility("elbow", [0.0, 1.0, 0.0], 8e4, 30.0)
            robot = small_robot(stiffness=np.inf).with_effects(hinge)
        q = np.linspace(0.3, 0.9, robot.n_axes)
        still, _ = self.one(robot, q)
        model = linearise(robot, operating_point(robot, q), still.friction, still.deflection)
        G = np.asarray(jf.robot.frf(model, still.frequency[1:], "position"))
        eye = np.broadcast_to(np.eye(robot.n_axes), G.shape)
        np.testing.assert_allclose(G @ still.impedance[1:], eye, atol=1e-8)

        B, n = np.asarray(motor_directions(robot)), robot.dof
        s = 2j * np.pi * still.frequency[:, None, None]
        Z = s**2 * np.asarray(model.mass) + s * np.asarray(model.damping) + np.asarray(model.stiffness)
        corner = np.zeros((len(Z), robot.n_axes, robot.n_axes))
        across = np.broadcast_to(B, (len(Z), *B.shape))
        whole = np.block([[Z, -across], [across.swapaxes(1, 2), corner]])  # Z z - B u = d, motors at rest
        found = np.linalg.inv(whole)[:, :, :n]
        for ours, theirs in ((still.compliance, found[:, :n]), (still.to_torque, found[:, n:])):
            np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())

    @pytest.mark.slow
    def test_hinge_against_a_robot_with_the_joint(self):
        """Gravity off: its part of the hinge's stiffness is left out."""
        robot = eqx.tree_at(lambda r: r.chain.gravity, small_robot(), jnp.zeros(3))
        still, motion = self.one(robot, Q[0])
        scene = Scene(robot, motion, 0, still)
        for joint in robot.axis_names:
            effect = fx.ExtraFlexibility(joint, [0.0, 1.0, 0.0], 8e4, 30.0)
            other = other_impedance(robot.with_effects(effect), still, robot.spring_names)
            assert rms(other - still.impedance) > 1e-3 * rms(still.impedance)
            ours, theirs = signature(effect, scene), scene.by_impedance(other)
            np.testing.assert_allclose(ours, theirs, atol=1e-6 * np.abs(theirs).max())

    @pytest.mark.slow
    def test_hinge_that_the_robot_has(self):
        """Its spring is another then; there is no second hinge."""
        effect = fx.ExtraFlexibility("elbow", [0.0, 1.0, 0.0], 8e4, 30.0)
        robot = small_robot().with_effects(effect)
        still, motion = self.one(robot, Q[0])
        scene = Scene(robot, motion, 0, still)
        assert not np.any(signature(effect, scene))
        other = with_parameters(robot, {"elbow_flexibility.stiffness": 9e4, "elbow_flexibility.damping": 40.0})
        ours = signature(fx.ExtraFlexibility("elbow", [0.0, 1.0, 0.0], 9e4, 40.0), scene)
        assert np.any(ours)
        np.testing.assert_allclose(ours, scene.by_robot(other), rtol=1e-12)


@pytest.fixture(scope="module")
def carrier():
    """The small robot without Coulomb friction and with one effect of every kind, none of which does anything yet: one
    program simulates all."""
    robot = with_parameters(small_robot(), dict.fromkeys(parameters(small_robot(), ["coulomb_friction"]), 0.0))
    robot = robot.with_effects(
        Drag("shoulder", 0.0),
        fx.Counterbalance("elbow", 0.0, 0.2),
        fx.TorqueRipple("elbow", [0.0], [2], [0.4]),
        fx.CurrentLoopLag("shoulder", 1e-9),
        fx.TorqueConstant("elbow", 0.0),
        fx.ResolverRipple("shoulder", [0.0], [2], [0.3]),
        fx.TransmissionError("elbow", [0.0], 160.0, (1,), [0.2]),
        fx.WristCoupling("elbow", 0.0),
        fx.GearHysteresis("shoulder", 0.0, 1e-4),
    )
    return jax.tree.map(jnp.asarray, robot)


@pytest.fixture(scope="module")
def quiet(carrier):
    """A record without noise at two positions, in which the arm moves little: to first order it is the frozen one."""
    data = record(carrier, Q[:2], 0.0, slow=5.0)
    return data, Evidence(carrier, measured(data), steps=STEPS)


@pytest.mark.slow
def test_replays_have_settled(carrier, quiet):
    """Of a robot whose motors are held so well, and whose gears damp so little, that it has not when others have: it
    plays as it would after twenty seconds."""
    less = {name: 0.1 * float(value) for name, value in parameters(carrier, ["damping"]).items()}
    robot = with_parameters(carrier, less)
    robot = eqx.tree_at(lambda r: r.controller.velocity_gain, robot, 8.0 * carrier.controller.velocity_gain)
    early, ours, late = (replay_motion(robot, quiet[0], steps=STEPS, run_in=t).u for t in (2.9, None, 20.0))
    size = late.std(axis=2).max(axis=(0, 1))
    off = [np.max(np.abs(x - late) / size) for x in (early, ours)]
    assert off[0] > 1e-3 and off[1] < 1e-4


def asked(changed, quiet):
    """Torque that a changed robot asks beyond the other, less what the difference in motion does: two simulations."""
    data, evidence = quiet
    motion, count = replay_motion(changed, data, steps=STEPS), evidence.U.shape[2]
    U, Y = (np.fft.rfft(x, axis=2)[:, :, :count] / x.shape[2] for x in (motion.u, motion.y))
    Y[:, :, 0] = 0.0
    moved = Y - evidence.Y
    pairs = zip(evidence.scenes, moved, strict=True)
    through = [np.einsum("lab,elb->ela", s.still.impedance, m) / s.still.command for s, m in pairs]
    return U - evidence.U - np.stack(through)


def with_value(robot, kind, **values):
    """One of the robot's effects with other parameters, alone and in the robot."""
    place = next(i for i, e in enumerate(robot.effects) if isinstance(e, kind))
    effect = robot.effects[place]
    for name, value in values.items():
        value = jnp.asarray(value, jnp.asarray(getattr(effect, name)).dtype)
        effect = eqx.tree_at(operator.attrgetter(name), effect, value)
    return effect, eqx.tree_at(lambda r: r.effects[place], robot, effect)


class TestSignatures:
    """What an effect asks along the motion, against a simulation with a little of it."""

    def compare(self, found, robot, quiet):
        theirs = asked(robot, quiet)
        ours = np.stack([found(scene) for scene in quiet[1].scenes])
        assert rms(ours - theirs) < 0.04 * rms(theirs)

    def test_the_record_itself(self, quiet):
        """No effect, no residual."""
        _, evidence = quiet
        assert rms(evidence.residual) < 1e-6 * rms(evidence.U)

    @pytest.mark.parametrize(
        ("name", "factor", "more"),
        [
            ("shoulder.stiffness", 1.01, 0.0),
            slow("elbow.damping", 1.05, 0.0),
            slow("elbow.viscous_friction", 1.1, 0.0),
            slow("shoulder.coulomb_friction", 1.0, 0.002),
            slow("elbow.motor_inertia", 1.02, 0.0),
            slow("elbow.mass", 1.01, 0.0),
            slow("shoulder.inertia", 1.02, 0.0),
        ],
    )
    def test_numbers_of_the_robot(self, carrier, quiet, name, factor, more):
        other = with_parameters(carrier, {name: factor * parameters(carrier, [name.split(".")[1]])[name] + more})
        self.compare(lambda scene: scene.by_robot(other), other, quiet)

    @pytest.mark.slow
    def test_lines_above_125_hz(self, carrier):
        """Springs and links are sampled as their highest line needs."""
        data = record(carrier, Q[:2], 0.0, slow=5.0, highest=840)
        fast = data, Evidence(carrier, measured(data), steps=STEPS)
        assert fast[1].scenes[0].lines > 200 * PERIOD / FS
        for name, factor in (("elbow.mass", 1.01), ("shoulder.stiffness", 1.01)):
            other = with_parameters(carrier, {name: factor * parameters(carrier, [name.split(".")[1]])[name]})
            self.compare(lambda scene, other=other: scene.by_robot(other), other, fast)

    @pytest.mark.parametrize(
        ("kind", "values"),
        [
            (Drag, {"coefficient": 1e-6}),
            slow(fx.Counterbalance, {"stiffness": 2.0}),
            slow(fx.TorqueRipple, {"amplitude": [1e-3]}),
            slow(fx.CurrentLoopLag, {"time_constant": 2e-5}),
            slow(fx.TorqueConstant, {"error": 2e-3}),
            slow(fx.ResolverRipple, {"amplitude": [2e-5]}),
            slow(fx.TransmissionError, {"amplitude": [1e-6]}),
            slow(fx.WristCoupling, {"ratio": 1e-3}),
            slow(fx.GearHysteresis, {"torque": 0.2}),
        ],
    )
    def test_effects(self, carrier, quiet, kind, values):
        effect, other = with_value(carrier, kind, **values)
        self.compare(lambda scene: signature(effect, scene), other, quiet)


class TestResolution:
    """Counts of an encoder in made-up readings."""

    time: ClassVar = np.arange(4000) / 1000.0
    position: ClassVar = np.stack([3 * np.sin(2.1 * time), np.cos(3.3 * time) + 0.2 * np.sin(40 * time)])

    @pytest.mark.parametrize("count", [2 * np.pi / 4096, 2 * np.pi / 10000])
    def test_counts(self, count):
        assert resolution(count * np.round(self.position / count), 0.0) == pytest.approx(count, rel=1e-3)

    def test_behind_noise(self):
        count, noise = 2e-3, 1e-4
        reading = count * np.round(self.position / count)
        reading = reading + noise * np.random.default_rng(0).standard_normal(reading.shape)
        assert resolution(reading, noise) == pytest.approx(count, rel=1e-2)

    def test_beside_a_jump(self):
        """A lost reading is no count, and costs no time: what is tried would grow with its size."""
        count = 2 * np.pi / 4096
        reading = count * np.round(self.position / count)
        reading[0, 2000:] += 500.0
        assert resolution(reading, 0.0) == pytest.approx(count, rel=1e-3)

    def test_none(self):
        assert resolution(self.position[:, :1], 0.0) == 0.0
        short = self.position[:, :2000]
        assert resolution(short, 0.0) == 0.0
        assert resolution(np.ones((2, 100)), 0.0) == 0.0
        noisy = short + 1e-4 * np.random.default_rng(0).standard_normal(short.shape)
        assert resolution(noisy, 0.0) == 0.0
        assert resolution(1e-4 * np.round(noisy / 1e-4), 1e-3) == 0.0  # finer than the noise: not looked for


class TestRecords:
    def test_positions_that_are_held_out(self):
        data = made_up()
        assert opened_positions(data, None).tolist() == [True, True, False]
        assert opened_positions(data, 0).all()
        assert opened_positions(made_up(2), None).all()
        assert opened_positions(made_up(7), None).sum() == 5
        twice = joined([data, changed(data, u=2 * np.asarray(data.u))])  # another amplitude at the same places
        assert opened_positions(twice, None).tolist() == [True, True, False] * 2
        for wrong in (-1, 3):
            with pytest.raises(jf.InputError, match=r"held-out positions.*0 to 2"):
                opened_positions(data, wrong)

    @pytest.mark.parametrize("positions, most", [(3, 6), (6, 4), (12, 2)])
    def test_experiments_of_the_robot_that_is_written(self, positions, most):
        """Sixteen runs at most of the positions that are not held out; two of each at least."""
        data = made_up(positions, n_exp=6, lines=np.array([3, 5]))
        every = measured(data)
        records = split(measured(fewer(data, 2)), every, None)
        found = records.final
        assert found.data.u.shape[:2] == (positions - positions // 3, most)
        some = np.linspace(0, 5, most).round().astype(int)
        np.testing.assert_array_equal(found.U, every.U[records.opened][:, some])
        np.testing.assert_array_equal(found.data.u, np.asarray(data.u)[records.opened][:, some])

    def test_joined(self):
        first, second = made_up(lines=np.array([3, 5])), made_up(1, seed=1, lines=np.array([5, 7]))
        both = joined([first, second])
        assert (both.n_pos, both.lines.tolist()) == (4, [3, 5, 7])
        for name in ("u", "y", "r", "q"):
            expected = np.concatenate([getattr(first, name), getattr(second, name)])
            np.testing.assert_array_equal(getattr(both, name), expected)
        assert joined([first]) is first

    def test_joined_with_different_numbers_of_experiments(self):
        first, second = made_up(2, n_exp=4), made_up(1, seed=1, n_exp=6)
        both = joined([first, second])
        assert (both.n_pos, both.n_exp) == (2 * 2 + 3, 2)
        np.testing.assert_array_equal(both.u[2], first.u[1, :2])
        np.testing.assert_array_equal(both.u[6], second.u[0, 4:])
        np.testing.assert_array_equal(both.q[4:], np.repeat(second.q, 3, axis=0))

    @pytest.mark.parametrize(
        ("others", "match"),
        [
            ([], "no record"),
            ([made_up(), made_up(fs=200.0)], "fs of the records.*100.*200"),
            ([made_up(), made_up(r=None)], "in some of the records only"),
            ([made_up(), made_up(q=None)], "arm configuration"),
        ],
    )
    def test_records_that_do_not_belong_together(self, others, match):
        with pytest.raises(jf.InputError, match=match):
            joined(others)

    def test_fewer_experiments(self):
        data = made_up(n_exp=5)
        some = fewer(data, 3)
        for name in ("u", "y", "r"):
            np.testing.assert_array_equal(getattr(some, name), np.asarray(getattr(data, name))[:, [0, 2, 4]])
        assert fewer(data, 5) is data
        assert fewer(changed(data, r=None), 2).r is None


@pytest.fixture(scope="module")
def machine():
    """The robot as built: other springs, dampers and links than stated, and ripple."""
    off = {"stiffness": 1.02, "damping": 0.95, "mass": 1.006, "viscous_friction": 1.02}
    robot = small_robot()
    robot = with_parameters(robot, {n: f * x for kind, f in off.items() for n, x in parameters(robot, [kind]).items()})
    return robot.with_effects(fx.TorqueRipple(0, [0.01], [6], [0.3]), fx.TorqueRipple(1, [0.006], [2], [0.3]))


def first(diagnosis):
    """The effect that was named first; the positions that were kept for it agree."""
    assert diagnosis.verdict in ("named", "ambiguous"), diagnosis.says
    assert (diagnosis.fitted, diagnosis.heldout) == ((0, 1), (2,))
    assert diagnosis.gap.shrink > 0.7
    assert all(x.std > 0 for x in diagnosis.effects[0].parameters.values())
    return diagnosis.effects[0]


@pytest.fixture(scope="module")
def rubbing(machine, tmp_path_factory):
    """A record of more friction, its diagnosis, and the parts that this keeps."""
    data = record(machine.with_effects(fx.CoulombFriction("shoulder", 0.15)))
    with Parts(tmp_path_factory.mktemp("parts") / "gap.json", "diagnose") as parts:
        parts.begin({}, PART_FILES)
        yield data, diagnose(small_robot(), data, parts=parts), parts


class TestDiagnosis:
    @pytest.mark.slow
    def test_nothing_hidden(self, machine):
        told, parts = [], []
        found = diagnose(small_robot(), record(machine), say=told.append, progress=parts.append)
        assert found.verdict == "sufficient", found.says
        assert found.effects == ()
        assert found.gap.before == found.gap.after
        assert told and parts == sorted(parts) and 0 <= parts[0] <= parts[-1] <= 1
        for name, change in found.changed.items():
            assert change == pytest.approx(0.02 if "stiffness" in name else -0.05, abs=0.01), name

    @pytest.mark.slow
    def test_coulomb_friction(self, rubbing):
        named = first(rubbing[1])
        assert (named.name, named.joint) == ("coulomb_friction", "shoulder")
        assert named.parameters["level"].value == pytest.approx(0.15, rel=0.15)
        assert named.p_value == 2.0**-8 and named.visible > 1 and named.explains > 0.9
        assert named.is_number and "number of the robot is wrong" in rubbing[1].says

    @pytest.mark.slow
    def test_torque_delay(self, machine):
        found = diagnose(small_robot(), record(machine.with_effects(fx.TorqueDelay("elbow", 6e-4))))
        named = first(found)
        assert "torque_delay" in (named.name, *named.equivalent)
        assert named.joint == "elbow"
        (late,) = named.parameters.values()
        assert late.value == pytest.approx(6e-4, rel=0.15)
        assert [f.G.shape[-2:] for f in found.frf] == [(2, 2)] * 3

    @pytest.mark.slow
    def test_spring(self, machine):
        hidden = fx.Counterbalance("shoulder", 60.0, 0.2)
        named = first(diagnose(small_robot(), record(machine.with_effects(hidden))))
        assert (named.name, named.joint) == ("counterbalance", "shoulder")
        assert "dress_pack" in named.equivalent
        assert named.parameters["stiffness"].value == pytest.approx(60.0, rel=0.15)

    @pytest.mark.slow
    def test_interrupted_after_the_last_round(self, rubbing):
        """Nothing is tried again, and it ends alike."""
        (data, found, parts), told = rubbing, []
        again = diagnose(small_robot(), data, parts=parts, say=told.append)
        assert not any("tries" in text for text in told)
        assert (again.verdict, again.says) == (found.verdict, found.says)
        for name, value in found.effects[0].parameters.items():  # numbers are kept, coordinates made from them
            assert again.effects[0].parameters[name].value == pytest.approx(value.value, rel=1e-6)
            assert again.effects[0].parameters[name].std == pytest.approx(value.std, rel=1e-4)
        assert again.effects[0].equivalent == found.effects[0].equivalent
        assert again.gap.after == pytest.approx(found.gap.after, rel=0.01)

    @pytest.mark.slow
    def test_an_effect_of_your_own(self, machine):
        found = diagnose(small_robot(), record(machine.with_effects(Drag("elbow", 1e-4))), own=(Drag,))
        named = first(found)
        assert isinstance(named.effect, Drag)
        assert named.joint == "elbow"
        assert named.parameters["coefficient"].value == pytest.approx(1e-4, rel=0.15)

    @pytest.mark.slow
    def test_a_rigid_transmission(self):
        robot = small_robot(stiffness=np.inf)
        found = diagnose(robot, record(robot.with_effects(fx.CoulombFriction("elbow", 0.1))))
        named = first(found)
        assert (named.name, named.joint) == ("coulomb_friction", "elbow")
        assert named.parameters["level"].value == pytest.approx(0.1, rel=0.15)
        assert "elbow.stiffness" not in found.parameters

    @pytest.mark.slow
    def test_without_controller(self, machine):
        """The motors follow the measured motion then."""
        data = record(machine.with_effects(fx.CoulombFriction("shoulder", 0.15)))
        found = diagnose(changed(small_robot(), controller=None), changed(data, r=None))
        named = first(found)
        assert "measured motion" in found.compared
        assert (named.name, named.joint) == ("coulomb_friction", "shoulder")
        assert named.parameters["level"].value == pytest.approx(0.15, rel=0.15)

    def test_records_that_cannot_be_compared(self):
        data = made_up(fs=FS)
        with pytest.raises(jf.InputError, match="springs at shoulder, elbow, and a record that is not periodic"):
            diagnose(small_robot(), changed(data, period=0))
        with pytest.raises(jf.InputError, match="arm configuration"):
            diagnose(small_robot(), changed(data, q=None))


@pytest.mark.slow
@pytest.mark.timeout(1800)
class TestHiddenCases:
    """Cases of the benchmark, of the library's own simulator and positions: ripple, every number off by what a data
    sheet is, another payload."""

    @staticmethod
    def diagnosed(part, number, robot, folder):
        from _hidden_cases import cases, make

        case = cases(part)[number]
        assert (case.robot, case.simulator) == (robot, "jaxfrf")
        make(case, folder)
        place = folder / "cases" / case.name
        found = diagnose(jf.io.read_robot(place / "robot.toml"), jf.io.read(place / "data.nc"))
        return found, json.loads((folder / "truth" / f"{case.name}.json").read_text())["effects"]

    def test_nothing_hidden(self, tmp_path):
        found, hidden = self.diagnosed("tune", 51, "r3x", tmp_path)
        assert hidden == []
        assert found.verdict == "sufficient", found.says
        assert found.effects == ()

    def test_current_loop_lag(self, tmp_path):
        found, (hidden,) = self.diagnosed("tune", 15, "r3x", tmp_path)
        named = found.effects[0]
        assert hidden["name"] in (named.name, *named.equivalent)
        assert named.joint == hidden["joint"]
        assert found.gap.shrink > 0.7

    def test_numbers_that_only_some_positions_tell(self, tmp_path):
        """What a position misses that was not fitted is no missing effect where numbers explain it; nothing is called
        held out then."""
        found, hidden = self.diagnosed("report", 18, "small", tmp_path)
        assert hidden == []
        assert (found.verdict, found.effects) == ("sufficient", ()), found.says
        assert (found.fitted, found.heldout) == ((0, 1, 2, 3, 4, 5), ())
        assert "none were held out" in found.gap.on

    def test_a_number_that_costs_little_and_cannot_be_right(self, tmp_path):
        found, (hidden,) = self.diagnosed("report", 33, "small", tmp_path)
        (named,) = found.effects
        assert (named.name, named.is_number, hidden["name"]) == ("payload", True, "payload"), found.says
        assert 0.5 < named.parameters["mass"].value / hidden["true"] < 1.5  # intervals: the benchmark
