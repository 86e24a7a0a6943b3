"""What the processes of a command need: their server imports this module while the command itself loads PyTorch.

What cannot be imported is told by the command, which needs it, too. The modules of the commands are not among these:
each process runs that of its own command once more, as Python's ``spawn`` does.
"""

import os
import warnings
from contextlib import suppress

with warnings.catch_warnings(), suppress(Exception):
    warnings.simplefilter("ignore")
    import numpy as np

    os.register_at_fork(after_in_child=np.random.seed)  # else all processes would draw the same numbers from it
    import uavrl.cli.suite
    import uavrl.evaluation.actor
    import uavrl.evaluation.position_stats
    import uavrl.training.build
    import uavrl.training.run  # noqa: F401
