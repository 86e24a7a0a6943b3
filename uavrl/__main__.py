"""``python -m uavrl COMMAND …`` is ``uavrl COMMAND …``."""

import sys
from pathlib import Path

if __name__ == "__main__":
    if not sys.flags.safe_path and Path(sys.path[0]) != Path(__file__).parent.parent:
        # Python has put the working folder there to find uavrl, which lies elsewhere: what else that folder holds may
        # be the run of somebody else, and is not imported.
        del sys.path[0]

    from uavrl.cli.main import main

    main()
