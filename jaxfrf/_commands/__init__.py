"""The commands: each module adds its options to a parser and runs; what they do is done by public functions.

Libraries are imported when a command runs, so that `jaxfrf --help` costs nothing.
"""

from . import diagnose, distortion, estimate, example, excite, identify, modal, positions, simulate, study

COMMANDS = (example, excite, positions, simulate, estimate, distortion, modal, identify, diagnose, study)
