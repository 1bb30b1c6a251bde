"""Every threshold of the diagnosis by channels, with its unit, its reason and what set it."""

LEVEL = 0.05
"""Family-wise level of every test; a convention. `test_family_wise_level_in_coloured_noise` holds it."""

DRAWS = 9999
"""Sign flips: no p-value is below 1/10000, and one of .01 is known to a tenth of it."""

MEMORY = 0.2
"""Autocorrelation of the residual below which blocks may be cut; `test_covariance_in_coloured_noise`: standard
deviations within 30 % of the scatter of estimates at a correlation of .9 from row to row."""

BLOCKS = (16, 60)
"""Blocks of a record, at least and at most: 2^16 sign patterns resolve LEVEL, more blocks would be shorter than the
residual's memory."""

LINE_BLOCKS = 24
"""Blocks of neighbouring lines of an FRF or spectrum: as for records."""

LEAST_SHARE = 0.2
"""Of the reducible gap, that an effect takes away where nothing was fitted: a fifth, as the method has it.
`tests/gap/test_gap_real.py`: what is named in real data takes .6 or more of it or is named with others."""

TIE = 0.05
"""Of what the best effect takes away, within which fewer parameters win: more of them always gain a little."""

RIVALS = 0.7
"""Cosine between what two effects explain, above which one may stand for the other."""

THE_SAME = 1e-6
"""Of a column's power beside the free numbers, and 1 - cosine of two columns, below which they are one: rounding."""

BEST = 5
"""Candidates that are tried beside each other in a step."""

MOST = 4
"""Effects in a diagnosis."""

STRETCHES = 8
"""Of records, that are held out in turn, at least: a t-test of the drop needs some degrees of freedom."""

FOLDS = 5
"""Of interleaved lines: a mode must not be held out as a whole."""

EXPLAINED = 0.5
"""Of what is systematic, that the named effects must explain together: less is *unexplained*."""

SYSTEMATIC = 0.1
"""Of the residual's power, that goes with the motion, from which a significant candidate that is not enough makes a gap
*unexplained*."""

TORQUE = 0.05
"""Of the rms torque: a residual that is surely smaller is *sufficient*;
`test_nothing_is_named_where_nothing_is_missing` has 2 % of noise."""

DEFLECTION = 0.05
"""Of the rms deflection: as for torques."""

DEFLECTION_DROP = 0.2
"""Of the power that is left, that an effect takes away on runs that were not used: a floor learned from a few runs is
none. `tests/gap/test_gap_real.py`: delays take 97 % of it."""

RESPONSE = 0.03
"""Relative error of an FRF that no model is asked to beat; the floor of a response. The bench's delay and lag stand out
of it (`tests/gap/test_gap_real.py`); its repeatability from record to record is 2 %."""

ALIKE_RESPONSES = 0.09
"""|log(measured/model)|, rms: .5 dB and 4 degrees together, the method's tolerance of *sufficient*."""

CLEAR = 10.0
"""dB above the noise, from which distortion is distortion; noise of single lines scatters by 5 dB."""

DISTORTION = 0.5
"""Of what would just be clear of the noise: noise alone is .3."""

CLEARLY = 6.0
"""dB between odd and even lines that make distortion odd or even: a factor of two."""

DEFLECTION_CUTOFF = 10.0
"""Hz, of the filter of deflections: below the modes of industrial robots, at which the motor's torque goes into its own
inertia."""

WORTH = 0.1
"""Of the residual's power: what remains and goes with a signature is worth a sentence from here on."""

BANDS = 6
"""Of maps, evenly over the logarithm of the frequency."""

AT_BOUND = 1e-3
"""Of a logarithm: a coefficient so near its bound was stopped by it, and is no finding."""
