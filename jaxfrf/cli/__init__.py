"""The commands: each module adds its options to a parser (`add`), runs (`run`), and says how it is used
(`EXAMPLES`); what they do is done by public functions.

Libraries are imported when a command runs, so that `jaxfrf --help` costs nothing.
"""

from . import diagnose, distortion, estimate, example, excite, identify, modal, positions, simulate, study, view

COMMANDS = (example, excite, positions, simulate, estimate, view, distortion, modal, identify, diagnose, study)
