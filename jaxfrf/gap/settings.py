"""Every threshold of a diagnosis, with its unit and its reason."""

# What is used of a record
EXPERIMENTS = 2  # of a position that is fitted: what limits a fit is the model, not the noise
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
OFF = 1.0  # tolerances from which on a number is told to be off
DATA_SHARE = 0.9  # of what was not known of a number, from the record, before it is told to be off

# Which candidates are fitted
CANDIDATES = 2  # of every view, by the cost that they promise to take away
SHARE = 0.3  # of what the best promises
LEAST_PART = 0.01  # of the cost
LEAST_SIZE = 0.3  # of what is just visible
MUCH = 0.7  # of the cost before: where a candidate leaves less, those of the next view are not fitted
DOUBTFUL = 0.3  # of the cost: where no candidate promises as much, those that numbers imitate are fitted, too
OWN = 1e-3  # of a column's square that must be its own beside the robot's numbers

# What decides
MOST = 4  # effects
SIGNIFICANT = 0.05  # p-value of the gain on positions that chose nothing, signs of its blocks flipped
LEAST_GAIN = 0.2  # of what is beyond the floor there, of all axes or of its own, that must be gained
BLOCKS = 8  # at least: runs, cut into combs of lines where there are fewer
TOOTH = 4  # neighbouring lines of a comb's tooth: excited and unexcited ones stand in each
NEAR = 0.05  # of what was beyond the floor: a rival that leaves no more than this beyond the best candidate is as good

# What the held-out positions say
PRICE = 0.1  # of the squares that some axes gain, which others may lose beyond their floor
RISES = 1.1  # of the torque that the effect's own joint is missed by

# Intervals
TIMING = 0.01  # of the sampling interval: when within it a torque acts is known no better; .005 between two simulators
LINK_ERROR = 0.01  # of what a mass, centre or inertia asks: no arm is known better; their columns are .05 to .08 off

# Words
UNEXPLAINED = 2.0  # mean square over the floor of one axis, which must not be left
EXPLAINED = 0.5  # of the misfit above the floor that must be gone on positions that chose nothing, or be a number's
TOLERANCE = 0.06  # of the torque, rms of an axis: half a decibel
SHOWN = 12  # candidates in a ranking
