"""Wrong arguments of public functions are one sentence: what was found, what was expected, what to do."""

import dataclasses

import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.machine import Machine, fit_machine, rank_effects

NAN = float("nan")
U = np.tile(np.random.default_rng(0).standard_normal((50, 1)), (3, 1))
DATA = jf.Experiment(U, np.roll(U, 1, axis=0), 1000.0, 50)
FRF = jf.io.frf_from_arrays(np.full((1, 3, 2, 2), 1.0 + 1j), np.array([1.0, 2.0, 3.0]), q=np.zeros((1, 2)))
FEWER = jf.io.frf_from_arrays(np.full((1, 2, 2, 2), 1.0 + 1j), np.array([1.0, 2.0]))
OTHER = jf.io.frf_from_arrays(np.full((1, 3, 2, 1), 1.0 + 1j), np.array([1.0, 2.0, 3.0]))
MOVED = jf.io.frf_from_arrays(np.full((1, 3, 2, 2), 1.0 + 1j), np.array([1.0, 2.0, 4.0]))
BENT = jf.io.frf_from_arrays(np.full((1, 3, 2, 2), 1.0 + 1j), np.array([1.0, 2.0, 3.0]), q=np.zeros((1, 3)))
ARM = jf.robot.r3x()
ONE_AXIS = dataclasses.replace(DATA, q=np.zeros((1, 1)))
NO_CHANNELS = dataclasses.replace(DATA, q=np.zeros((1, 6)))


def in_motion(data):
    model = jf.RobotModel(ARM)
    return jf.graybox.response_in_motion(
        model, {n: p.start for n, p in model.parameters.items()}, np.array([5.0]), data
    )


def information(frequency=(5.0, 6.0), points=None, **options):
    points = np.zeros((1, 6)) if points is None else points
    return jf.graybox.position_information(jf.RobotModel(ARM), np.asarray(frequency), points, **options)


def own(omega, values):
    return 1 / (values["m"] * 1j * omega + values["k"])


def machine(matrices=lambda p: (np.eye(1), np.eye(1), p["k"] * np.eye(1)), **options):
    return Machine(matrices, {"k": 1.0}, **({"inputs": [[1.0]], "outputs": [[1.0]]} | options))


def plan(candidates=None, **options):
    candidates = [[0.0] * 6] * 2 if candidates is None else candidates
    return jf.graybox.plan_positions(jf.RobotModel(ARM), FRF.frequency, candidates, 1, **options)


ONE = jf.io.frf_from_arrays(np.ones((1, 3, 1, 1), complex), FRF.frequency)
OWN = jf.GrayBox(own, {"k": 1.0, "m": 1.0})
LONG = jf.Experiment(U, np.roll(U, 1, axis=0), 1000.0)

WRONG = {
    "read_robot(None)": lambda: jf.io.read_robot(None),
    "read_robot(3)": lambda: jf.io.read_robot(3),
    "read(None)": lambda: jf.io.read(None),
    "read()": lambda: jf.io.read(),
    "read_frf([])": lambda: jf.io.read_frf([]),
    "read_design(nan)": lambda: jf.io.read_design(NAN),
    "read_fit(None)": lambda: jf.io.read_fit(None),
    "read_gap(b'x')": lambda: jf.io.read_gap(b"x"),
    "read_reference(None)": lambda: jf.io.read_reference(None),
    "read_uff(1)": lambda: jf.io.read_uff(1),
    "read_urdf(None)": lambda: jf.io.read_urdf(None, None),
    "write(None, data)": lambda: jf.io.write(None, DATA),
    "write_frf of data": lambda: jf.io.write_frf("a.nc", DATA),
    "write_robot of text": lambda: jf.io.write_robot("r.toml", "r3x"),
    "write_mjcf(None)": lambda: jf.io.write_mjcf("r.xml", None),
    "write_robot(robot, path)": lambda: jf.io.write_robot(ARM, "r.toml"),
    "write_mjcf(robot, path)": lambda: jf.io.write_mjcf(ARM, "r.xml"),
    "write_gap of text": lambda: jf.io.write_gap("gap.json", "abc"),
    "write_positions of an FRF": lambda: jf.io.write_positions("q.csv", FRF),
    "write_positions of text": lambda: jf.io.write_positions("q.csv", "abc"),
    "frf_from_uff of text": lambda: jf.io.frf_from_uff("abc"),
    "frf_from_uff(None)": lambda: jf.io.frf_from_uff(None),
    "from_sep005(None)": lambda: jf.io.from_sep005(None),
    "from_sep005 of FRFs": lambda: jf.io.from_sep005([FRF]),
    "to_control at x": lambda: jf.io.to_control(FRF, "x"),
    "known_unit(5)": lambda: jf.units.known_unit(5),
    "differentiated by 0.5": lambda: jf.units.differentiated("rad", 0.5),
    "with_effects of a list": lambda: ARM.with_effects([jf.effects.TorqueDelay(0, 1e-3)]),
    "with_effects of a class": lambda: ARM.with_effects(jf.effects.TorqueDelay),
    "with_parameters of a negative stiffness": lambda: jf.robot.with_parameters(ARM, {"joint1.stiffness": -1.0}),
    "with_parameters of nan": lambda: jf.robot.with_parameters(ARM, {"joint1.damping": NAN}),
    "with_parameters of text": lambda: jf.robot.with_parameters(ARM, {"joint1.mass": "heavy"}),
    "with_parameters of a list": lambda: jf.robot.with_parameters(ARM, {"joint1.mass": [1.0, 2.0]}),
    "with_parameters of one number for three": lambda: jf.robot.with_parameters(ARM, {"joint1.com": 0.1}),
    "reference by a key of 1.5": lambda: jf.reference(jf.Multisine(1000.0, 100, [3, 5]), key=1.5),
    "parse_map(None)": lambda: jf.io.parse_map(None),
    "parse_values(3)": lambda: jf.io.parse_values(3),
    "parse_factor({})": lambda: jf.io.parse_factor({}),
    "segments(nan)": lambda: jf.segments(NAN, 100),
    "segments of nan": lambda: jf.segments(LONG, NAN),
    "segments of text": lambda: jf.segments(LONG, "100"),
    "segments of an array": lambda: jf.segments(LONG, np.zeros(3)),
    "segments of -1": lambda: jf.segments(LONG, -1),
    "segments of 1e300": lambda: jf.segments(LONG, 1e300),
    "segment_spectra(None)": lambda: jf.segment_spectra(None, 100),
    "select_periods(None)": lambda: jf.select_periods(None, 0),
    "select_periods of nan": lambda: jf.select_periods(DATA, NAN),
    "full_lines of text": lambda: jf.full_lines("1", 9),
    "full_lines of nan": lambda: jf.full_lines(1, NAN),
    "odd_lines(None)": lambda: jf.odd_lines(None, 9),
    "random_odd_lines(-1)": lambda: jf.random_odd_lines(-1, 9, key=None),
    "log_odd_lines of []": lambda: jf.log_odd_lines(1, 99, []),
    "band_lines of period 0": lambda: jf.band_lines(1.0, 9.0, 1000.0, 0),
    "band_lines of inf": lambda: jf.band_lines(1.0, np.inf, 1000.0, 50),
    "excited_lines without a period": lambda: jf.excited_lines(LONG),
    "estimate(None)": lambda: jf.estimate(None, jf.H1()),
    "estimate by a name": lambda: jf.estimate(DATA, "h1"),
    "dft of a file": lambda: jf.dft("run.nc"),
    "examine([])": lambda: jf.examine([]),
    "screen(None)": lambda: jf.screen(None),
    "Experiment of nothing": lambda: jf.Experiment(np.zeros(0), np.zeros(0), 1000.0),
    "Experiment at nan Hz": lambda: jf.Experiment(U, U, NAN),
    "Experiment at -1 Hz": lambda: jf.Experiment(U, U, -1.0),
    "Experiment of other lengths": lambda: jf.Experiment(U, U[:-1], 1000.0),
    "Experiment of NaN": lambda: jf.Experiment(U * NAN, U, 1000.0),
    "Experiment in deg/s": lambda: jf.Experiment(U, U, 1000.0, y_unit="deg/s"),
    "Experiment of unit 5": lambda: jf.Experiment(U, U, 1000.0, u_unit=5),
    "Experiment of sources None": lambda: jf.Experiment(U, U, 1000.0, sources=None),
    "Experiment with one warning as text": lambda: jf.Experiment(U, U, 1000.0, warnings="noisy"),
    "distortion of data": lambda: jf.distortion(DATA, DATA),
    "with_distortion(None)": lambda: jf.with_distortion(None, DATA),
    "concatenate([])": lambda: jf.concatenate([]),
    "concatenate(None)": lambda: jf.concatenate(None),
    "concatenate of arrays": lambda: jf.concatenate([U]),
    "concatenate_positions([])": lambda: jf.concatenate_positions([]),
    "concatenate_positions of data": lambda: jf.concatenate_positions([DATA]),
    "concatenate_positions of other lines": lambda: jf.concatenate_positions([FRF, FEWER]),
    "concatenate_positions of moved lines": lambda: jf.concatenate_positions([FRF, MOVED]),
    "concatenate_positions of other inputs": lambda: jf.concatenate_positions([FRF, OTHER]),
    "concatenate_positions of other robots": lambda: jf.concatenate_positions([FRF, BENT]),
    "features of output 9": lambda: jf.features(FRF, out=9),
    "features of input 9": lambda: jf.features(FRF, into=9),
    "features of position 9": lambda: jf.features(FRF, position=9),
    "features of position 0.5": lambda: jf.features(FRF, position=0.5),
    "focus_band of axis 9": lambda: jf.graybox.focus_band(FRF, 9, 0),
    "focus_band of position 9": lambda: jf.graybox.focus_band(FRF, 0, 9),
    "fit_bode of position 9": lambda: jf.plot.fit_bode(FRF, {}, position=9),
    "fit_bode of element (9, 9)": lambda: jf.plot.fit_bode(FRF, {}, elements=[(9, 9)]),
    "fit_bode of other lines": lambda: jf.plot.fit_bode(FRF, {"model": FEWER.G}),
    "slow_motion without angles": lambda: jf.graybox.slow_motion(ARM, DATA, 1.0),
    "slow_motion of one axis": lambda: jf.graybox.slow_motion(ARM, ONE_AXIS, 1.0),
    "slow_motion of one channel": lambda: jf.graybox.slow_motion(ARM, NO_CHANNELS, 1.0),
    "response_in_motion of one axis": lambda: in_motion(ONE_AXIS),
    "robot_points of one channel": lambda: jf.graybox.robot_points(ARM, NO_CHANNELS),
    "with_numbers of a short x": lambda: jf.calibration.with_numbers(ARM, jf.calibration.numbers(ARM), [0.0]),
    "starting_near an unknown name": lambda: jf.graybox.starting_near(jf.RobotModel(ARM), {"joint9.stiffness": 1.0}),
    "starting_at an unknown name": lambda: jf.graybox.starting_at(jf.RobotModel(ARM), {"joint9.stiffness": 1.0}),
    "random_positions(nan)": lambda: jf.random_positions(NAN, None),
    "random_positions(-3)": lambda: jf.random_positions(-3, None),
    "example_response([])": lambda: jf.example_response(np.zeros(0)),
    "quality(None)": lambda: jf.quality(None, None),
    "derived(None)": lambda: jf.derived(None, lambda x: x),
    "initial_guess(None)": lambda: jf.initial_guess(None, None),
    "identify of None": lambda: jf.identify_springs(jf.robot.r3x(), None),
    "calibrate of None": lambda: jf.calibrate(jf.robot.r3x(), None),
    "identify(None)": lambda: jf.identify_springs(None, None),
    "calibrate(None)": lambda: jf.calibrate(None, None),
    "calibrate of files": lambda: jf.calibrate("r.toml", ["a.nc"]),
    "random_odd_lines by a key of 3.5": lambda: jf.random_odd_lines(1, 99, key=3.5),
    "random_odd_lines in groups of 2.5": lambda: jf.random_odd_lines(1, 99, group=2.5, key=0),
    "detection_lines of none": lambda: jf.detection_lines([]),
    "band_lines at 0 Hz": lambda: jf.band_lines(1.0, 9.0, 0.0, 50),
    "select_positions of none": lambda: jf.select_positions(jf.dft(DATA), []),
    "select_positions(5)": lambda: jf.select_positions(jf.dft(DATA), [5]),
    "segment_spectra overlapping wholly": lambda: jf.segment_spectra(LONG, 20, overlap=1.0),
    "segment_spectra overlapping by -0.5": lambda: jf.segment_spectra(LONG, 20, overlap=-0.5),
    "segment_spectra overlapping by nan": lambda: jf.segment_spectra(LONG, 20, overlap=NAN),
    "segment_spectra of 32.5": lambda: jf.segment_spectra(LONG, 32.5),
    "segment_spectra with another window": lambda: jf.segment_spectra(LONG, 32, window="round"),
    "best_linear_approximation(None)": lambda: jf.best_linear_approximation(None),
    "RobotModel(None)": lambda: jf.RobotModel(None),
    "RobotModel without a hold by its name": lambda: jf.RobotModel(ARM, hold="none"),
    "RobotModel held for 5": lambda: jf.RobotModel(ARM, hold=5),
    "RobotModel of a speed": lambda: jf.RobotModel(ARM, quantity="Velocity"),
    "RobotModel of three amplitudes": lambda: jf.RobotModel(ARM, slow_amplitude=[1.0, 2.0, 3.0]),
    "fix(None)": lambda: jf.graybox.fix(OWN, None),
    "fix of a letter": lambda: jf.graybox.fix(OWN, "km"),
    "share of none": lambda: jf.graybox.share(OWN, []),
    "share of one": lambda: jf.graybox.share(OWN, "k"),
    "GrayBox(5)": lambda: jf.GrayBox(5, {"k": 1.0}),
    "GrayBox of a class": lambda: jf.GrayBox(jf.Weights, {"k": 1.0}),
    "GrayBox of one argument": lambda: jf.GrayBox(lambda s: s, {"k": 1.0}),
    "GrayBox of four arguments": lambda: jf.GrayBox(lambda s, p, q, x: s, {"k": 1.0}),
    "GrayBox with a list": lambda: jf.GrayBox(own, ["k"]),
    "GrayBox with three numbers": lambda: jf.GrayBox(own, {"k": np.ones(3)}),
    "GrayBox with a number in quotes": lambda: jf.GrayBox(own, {"k": "1e3"}),
    "GrayBox with a number as a name": lambda: jf.GrayBox(own, {1: 1.0}),
    "Parameter with one bound": lambda: jf.Parameter(1.0, bounds=5),
    "Parameter without bounds": lambda: jf.Parameter(1.0, bounds=[]),
    "Parameter without a spread": lambda: jf.Parameter(1.0, spread=None),
    "Machine driven by text": lambda: machine(inputs="abc"),
    "Machine of place 5": lambda: machine(places=5),
    "Machine of no effects": lambda: machine(effects=None),
    "Machine of an effect's class": lambda: machine(effects=[jf.effects.CoulombFriction]),
    "Machine of two matrices": lambda: machine(lambda p: (np.eye(1), np.eye(1))).response(FRF.frequency, {}, None),
    "Machine of scalars": lambda: machine(lambda p: (1.0, 1.0, 1.0)).response(FRF.frequency, {}, None),
    "Machine of a name that is none": lambda: machine(lambda p: p["d"]).response(FRF.frequency, {"k": 1.0}, None),
    "rank_effects of a class": lambda: rank_effects(machine(), DATA, [jf.effects.CoulombFriction]),
    "select_band from text": lambda: jf.select_band(jf.dft(DATA), "5", None),
    "unexcited_spectra in one number": lambda: jf.unexcited_spectra(DATA, 5),
    "record_spectra in no band": lambda: jf.record_spectra(LONG, []),
    "plot.spectrum of a record": lambda: jf.plot.spectrum(DATA),
    "plot.spectrum of channel '0'": lambda: jf.plot.spectrum(jf.dft(DATA), channels=["0"]),
    "plot.distortion of an FRF": lambda: jf.plot.distortion(FRF),
    "plot.stabilisation of an FRF": lambda: jf.plot.stabilisation(FRF),
    "plot.multisine of a record": lambda: jf.plot.multisine(DATA),
    "plot.plan(None)": lambda: jf.plot.plan(None),
    "plot.numbers_found(None)": lambda: jf.plot.numbers_found(None),
    "plot.start_paths of an FRF": lambda: jf.plot.start_paths(FRF),
    "plot.residual_maps of an FRF": lambda: jf.plot.residual_maps(FRF),
    "plot.correlation_map(None)": lambda: jf.plot.correlation_map(None),
    "plot.confidence_radius(None)": lambda: jf.plot.confidence_radius(None),
    "plot.gap_bode of one FRF": lambda: jf.plot.gap_bode([FRF], 0, 0),
    "plot.save(None)": lambda: jf.plot.save(None, "x"),
    "plot.bode of a file": lambda: jf.plot.bode("a.nc"),
    "plot.bode at position '0'": lambda: jf.plot.bode([FRF], position="0"),
    "plot.bode of half a pair": lambda: jf.plot.bode(FRF, elements=[0]),
    "modal delayed by text": lambda: jf.modal(FRF, delay="0"),
    "modal at two positions": lambda: jf.modal(FRF, position=[0, 1]),
    "features of any height": lambda: jf.features(FRF, prominence_db=None),
    "example without a number of noise": lambda: jf.example(noise=None),
    "fit with weights in text": lambda: jf.fit(OWN, ONE, weights="abc"),
    "fit that keeps text": lambda: jf.fit(OWN, ONE, keep="abc"),
    "fit from no starts": lambda: jf.fit(OWN, ONE, starts=None),
    "fit that reports to 5": lambda: jf.fit(OWN, ONE, progress=5),
    "Weights with a focus in text": lambda: jf.Weights(focus="x"),
    "Weights of one band": lambda: jf.Weights(bands=(1.0, 2.0, 0.5)),
    "plan_positions of one number of blocks": lambda: plan(blocks=4),
    "plan_positions of 1.5 blocks": lambda: plan(blocks=[1.5]),
    "plan_positions of rows of other lengths": lambda: plan(candidates=[[0.0] * 6, [0.0]]),
    "expected_accuracy without names": lambda: jf.graybox.expected_accuracy(np.ones((2, 1, 1)), None),
    "expected_accuracy of fewer names": lambda: jf.graybox.expected_accuracy(np.ones((2, 2, 2)), ("k",)),
    "select_periods to 1.5": lambda: jf.select_periods(DATA, 0, 1.5),
    "differentiate abc times": lambda: jf.spectra.differentiate(np.ones((3, 1)), FRF.frequency, "abc"),
    "with_output_quantity of a list": lambda: jf.with_output_quantity(jf.dft(DATA), ["velocity"]),
    "estimate that reports to 5": lambda: jf.estimate(DATA, jf.H1(), progress=5),
    "diagnose of a file": lambda: jf.diagnose(ARM, "run.nc"),
    "diagnose with an effect 5": lambda: jf.diagnose(ARM, DATA, own=5),
    "fit_machine in text": lambda: fit_machine(machine(), DATA, band="ab"),
    "modal in one number": lambda: jf.modal(FRF, band=(10.0,)),
    "fit from 1.5 starts": lambda: jf.fit(jf.GrayBox(lambda s, p: p["g"] * FRF.G[0], {"g": 1.0}), FRF, starts=1.5),
    "position_information with noise 0": lambda: information(noise=0.0),
    "position_information with noise below 0": lambda: information(noise=-0.05),
    "position_information with noise nan": lambda: information(noise=NAN),
    "position_information of wrong weights": lambda: information(weights=np.ones((2, 2))),
    "position_information without lines": lambda: information(frequency=np.zeros(0)),
    "position_information without points": lambda: information(points=np.zeros((0, 6))),
    "FRF of lines that fall": lambda: dataclasses.replace(FRF, frequency=FRF.frequency[::-1]),
    "FRF of lines that are nan": lambda: dataclasses.replace(FRF, frequency=np.array([1.0, NAN, 3.0])),
    "frf_from_arrays with one line twice": lambda: jf.io.frf_from_arrays(FRF.G, np.array([1.0, 1.0, 3.0])),
    "modal of data": lambda: jf.modal(DATA),
    "fit of arrays": lambda: jf.fit(None, U),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_argument_is_one_sentence(name):
    with pytest.raises(jf.InputError, match=r"found .+; expected .+\."):
        WRONG[name]()


def test_diagnose_of_nothing_asks_for_records():
    with pytest.raises(jf.InputError, match=r"data: found .*; expected a list of jaxfrf\.Experiment or jaxfrf\.FRF"):
        jf.diagnose(ARM, [])
