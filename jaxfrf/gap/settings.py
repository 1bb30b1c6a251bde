"""Every threshold of a diagnosis, with its unit and its reason."""

# What is used of a record
EXPERIMENTS = 2  # of a position: what limits a diagnosis is the model, not the noise
FEW = 4  # opened positions, from which on some of them choose nothing and decide
SELECT = 3  # one of so many

# How far a robot is fitted
ROUNDS = 8  # simulations of a robot that is fitted, at most; from a start that was fitted before
LOOKS_FOR_RIPPLE = 3  # first rounds, in which further orders are looked for
FIRST_HEAT = 2  # of them, for a candidate, before those that are far behind are given up
SLOW = 0.7  # of what a round before left: more, and what is far from the floor will not come down to it by itself
IN_THE_RACE = 1.5  # times the least cost: more after the first heat is not fitted further

# What is beyond a robot whose numbers are fitted
FLOOR = 1.0  # mean square over the floor of one axis in one band: an honest model leaves less everywhere
FAR = 3.0  # tolerances: a number that is further off is not believed, unless the data leave no other way
HOPELESS = 9.0  # tolerances: a robot in which one is further off explains nothing
OFF = 1.0  # tolerances from which on a number is told to be wrong
TOLD = 0.9  # of what was not known of a number, by the record, before it is told to be wrong

# Which candidates are fitted
FINALISTS = 2  # of every view, by the cost that they promise to take away
SHARE = 0.3  # of what the best promises
LEAST_PART = 0.01  # of the cost
LEAST_SIZE = 0.3  # of what is just visible
OWN = 1e-3  # of a column's square that must be its own beside the robot's numbers
DOUBTFUL = 0.3  # of the cost: where no candidate promises as much, shapes of springs are fitted, whatever they promise

# What decides
MOST = 4  # effects
SIGNIFICANT = 0.05  # p-value of the gain on positions that chose nothing, signs of its blocks flipped
LEAST_GAIN = 0.05  # of the misfit there, that is gained at least
CREDIBLE = 9.0  # squares of tolerances that an effect must save where the misfit is within the floor without it
NO_WORSE = 1.05  # of the misfit, for such an effect
BLOCKS = 8  # bands of lines, which count as blocks beside positions where there are few of these
POSITIONS = 5  # from which on positions alone are blocks
NEAR = 0.03  # of the floor's mean square: a rival that leaves no more than this beyond the winner is as good

# What the sealed positions say
GAINS = 0.98  # of the gap that was there: more left is no gain
PRICE = 0.1  # of the squares that some axes gain, which others may lose beyond their floor
RISES = 1.1  # of the torque that the effect's own joint is missed by

# Words
UNEXPLAINED = 2.0  # mean square over the floor of one axis, which must not be left
EXPLAINED = 0.5  # of the misfit above the floor that must be gone on positions that chose nothing
TOLERANCE = 0.06  # of the torque, rms of an axis: half a decibel
SHOWN = 12  # candidates in a ranking
