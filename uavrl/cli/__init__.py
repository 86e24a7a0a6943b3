"""The command line: one small file for each command."""

import sys
import time
from types import TracebackType

from uavrl.errors import MissingExtra, missing_extra

BEGAN = time.monotonic()  # the first command of this process, before it imports what it needs
_otherwise = sys.excepthook


def _tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Report Ctrl-C or a missing extra during the imports of a command as the command does later."""
    if issubclass(kind, KeyboardInterrupt):
        print("uavrl: stopped.", file=sys.stderr)
    elif missing := error if isinstance(error, MissingExtra) else missing_extra(error):
        print(f"uavrl: {missing}", file=sys.stderr)
    else:
        _otherwise(kind, error, trace)


sys.excepthook = _tell
