"""Every threshold of a diagnosis, with its unit and its reason.

Those of simulated robots were set on the tuning part of the benchmark (`benchmarks/bench_gap.py --part tune`) and are
reported on its other part; those of channels name the test that holds them.
"""

# --- Of every comparison ---

LEVEL = 0.05  # p-value of a test, family-wise where there are several candidates: a convention, which
# `test_family_wise_level_in_coloured_noise` holds
CONFIDENCE = 1.0 - LEVEL  # of one-sided tests of a mean, and of intervals
STANDARD_ERROR = 0.84  # the share of a normal quantity below one deviation: "as good within a standard error"
LEAST_SHARE = 0.2  # of what is beyond the floor, that an effect takes away where nothing was fitted: a fifth, as the
# method has it; what is named in real data takes .6 or more, or is named with others (`tests/gap/test_gap_real.py`)
NEAR = 0.05  # of the same: a rival that leaves no more than this beyond the best candidate is as good
EXPLAINED = 0.5  # of the same, that named effects take away together; less is *unexplained*
MOST = 4  # effects

# --- Of simulated robots ---

# What is used of a record
EXPERIMENTS = 2  # of a position that is fitted: what limits a fit is the model, not the noise
RUNS = 16  # positions times experiments that the robot which is written is fitted to, at most: where few positions tell
# its numbers their experiments do; more than these take 3 GB for six axes
JUDGING = 6  # experiments of a position that decides or is held out: each is a block of its own
FEW = 4  # opened positions, from which on some of them choose nothing and decide
SELECT = 3  # one of so many

# How far a robot is fitted
ROUNDS = 10  # simulations of the robot as given, at most
FIRST_ROUNDS = 2  # of a candidate, before those that are far behind are given up
MORE_ROUNDS = 4  # of a candidate that is not: it begins where the robot before was fitted
LATE_ROUNDS = 8  # beyond these, as long as there is much to come: short steps of a fit that is on its way
FINAL_ROUNDS = 4  # of the robot that is left, on all opened positions: it begins where some of them have put it
SLOW = 0.7  # of what a round before left: more, and what is far from the floor will not come down to it by itself
PROMISING = 0.5  # of the misfit: a step that would leave less is worth another round, however short it must be
KEPT_WITHIN = 1.5  # times the least cost: a candidate that costs more after its first rounds is not fitted further

# What is beyond a robot whose numbers are fitted
FLOOR = 1.0  # mean square over the floor of one axis in one band: an honest model leaves less everywhere
OUT_OF_TOLERANCE = 0.01  # p-value of one number among all of a robot, from which on its tolerance is not believed
DISBELIEVED = 1e-3  # the same, from which on it is tried however little of the cost it is: nothing else speaks for it
OTHERS = 3.0  # numbers that tell a common factor of all tolerances, at least
FAR = 2.0  # tolerances that such a number is off by at least
HOPELESS = 9.0  # tolerances: a robot in which one is further off explains nothing
WORSE = 1.1  # times as much of an axis's torque missed as before: is said
OFF = 1.0  # tolerances from which on a number is told to be off

# Which candidates are fitted
CANDIDATES = 2  # of every view, by the cost that they promise to take away
SHARE = 0.3  # of what the best promises
LEAST_PART = 0.01  # of the cost
LEAST_SIZE = 0.3  # of what is just visible, of candidates that do not promise most of the cost (`EXPLAINED`)
LEAST_FITTED = 0.1  # of that, once fitted, where it leaves most of the cost: some microradians of play are another law
MUCH = 0.7  # of the cost before: where a candidate leaves less, those of the next view are not fitted
DOUBTFUL = 0.3  # of the cost: where no candidate promises as much, those that numbers imitate are fitted, too
OWN = 1e-3  # of a column's square that must be its own beside the robot's numbers

# What decides
FEWEST = 4  # blocks that show anything decide where all agree: a steady torque of four positions shows in no more
COMBED = 8  # blocks at least: runs, cut into combs of lines where there are fewer
TOOTH = 4  # neighbouring lines of a comb's tooth: excited and unexcited ones stand in each

# What the held-out positions say
PRICE = 0.1  # of the squares that some axes gain, which others may lose beyond their floor
RISES = 1.1  # of the torque that the effect's own joint is missed by

# Intervals
TIMING = 0.01  # of the sampling interval: when within it a torque acts is known no better; .005 between two simulators
LINK_ERROR = 0.01  # of what a mass, centre or inertia asks: no arm is known better; their columns are .05 to .08 off

LIKELY = 3.84  # of the cost: another minimum that costs no more above the least is as likely, at a level of 95 %

# Words
UNEXPLAINED = 2.0  # mean square over the floor of one axis, which must not be left
INTERVAL = 1.96  # standard deviations, that a number which is told to be off is away from what was given
FAR_LEFT, MISSED = 50.0, 0.25
"""Mean square over the floor of one axis, and part of a torque: where effects leave more of both, they stand for
something else. Coulomb friction on the arm side, on records of another simulator, was called arm viscous friction,
which left .21 to .30 of a torque; of 234 hidden cases the named ones leave .24 at most, rightly named."""
TOLERANCE = 0.06  # of the torque, rms of an axis: half a decibel
SHOWN = 12  # candidates in a ranking
EVERYWHERE, SOMEWHERE = 2.0, 3.0  # times the floor, of cells of a map that are told: at all positions, or at one, where
# twice the others'; noise makes 1, what is *unexplained* 1.4 and more
CELLS = 8  # of a map, that are told
AT_MOST = 0.9  # of the gap is floor: a steady torque alone hardly lifts the rms of all lines
NOTHING = 1e-3  # of the floor: a gap that is smaller has nothing to shrink

# Encoders, by the characteristic function of their readings' increments (`TestResolution`)
COUNT_CLEAR = 0.5  # at one count: 1 without noise, 0 for a smooth distribution
COUNT_FIRST = 0.8  # of the largest: the first count that is so clear is meant, not its parts
COUNT_FINEST = 5.0  # deviations of the noise: finer counts are not resolved
COUNT_JUMP = 30.0  # times the median of increments that move: others, as a lost reading, tell no count

# --- Of channels ---

# Tests
DRAWS = 9999  # sign flips: no p-value is below 1/10000, and one of .01 is known to a tenth of it
MEMORY = 0.2  # autocorrelation of the residual below which blocks may be cut; `test_covariance_in_coloured_noise`:
# deviations within 30 % of the scatter of estimates at a correlation of .9 from row to row
BLOCKS = 16, 60  # of a record: 2^16 sign patterns resolve `LEVEL`, more blocks would be shorter than the memory
LINE_BLOCKS = 24  # of neighbouring lines of an FRF or spectrum: as for records
STRETCHES = 8  # of records, held out in turn, at least: a t-test of the drop needs some degrees of freedom
FOLDS = 5  # of interleaved lines: a mode must not be held out as a whole

# Candidates
BEST = 5  # that are tried beside each other in a step
RIVALS = 0.7  # cosine between what two effects explain, above which one may stand for the other
THE_SAME = 1e-6  # of a column's power beside the free numbers, and 1 - cosine of two columns, below which they are one
AT_BOUND = 1e-3  # of a logarithm: a coefficient so near its bound was stopped by it, and is no finding

# What nothing is asked for
SYSTEMATIC = 0.1  # of the residual's power, that goes with the motion, from which a significant candidate that is not
# enough makes a gap *unexplained*
TORQUE = 0.05  # of the rms torque; `test_nothing_is_named_where_nothing_is_missing` has 2 % of noise
DEFLECTION = 0.05  # of the rms deflection: as for torques
DEFLECTION_DROP = 0.2  # of the power that is left, that an effect takes away on runs that were not used: a floor that a
# few runs tell is none; delays take 97 % of it (`tests/gap/test_gap_real.py`)
DEFLECTION_CUTOFF = 10.0  # Hz, of the filter of deflections: below the modes of industrial robots, at which the motor's
# torque goes into its own inertia
SMALLEST = 0.005  # of the rms torque or deflection of its axis, beyond what free numbers explain: less is no finding,
# for constants of motors are known to 1 % at best (`test_a_linear_spring_needs_nothing`)
GIVES = 2.0  # tolerances, within which numbers of a rigid robot go before effects that look like them: 95 % of them are
# (`test_numbers_within_their_tolerance_are_no_missing_effect`)
RESPONSE = 0.03  # relative error of an FRF that no model is asked to beat: the floor of a response; the bench's delay
# and lag stand out of it (`tests/gap/test_gap_real.py`), its repeatability from record to record is 2 %
ALIKE_RESPONSES = 0.09  # |log(measured/model)|, rms: .5 dB and 4 degrees together
CLEAR = 10.0  # dB above the noise, from which distortion is distortion; noise of single lines scatters by 5 dB
DISTORTION = 0.5  # of what would just be clear of the noise: noise alone is .3
CLEARLY = 6.0  # dB between odd and even lines that make distortion odd or even: a factor of two

# Words
REFITTED = 0.8  # of the rms of the robot as given: where its own numbers leave less, it is said that they were wrong
WORTH = 0.1  # of the residual's power: what remains and goes with a signature is worth a sentence from here on
BANDS = 6  # of maps, evenly over the logarithm of the frequency
