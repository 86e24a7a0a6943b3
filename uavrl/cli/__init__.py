"""The command line: one small file for each command."""

import sys
from types import TracebackType

_otherwise = sys.excepthook


def _tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Report Ctrl-C during the imports of a command as :mod:`uavrl_onboard.cli.process` does later."""
    if issubclass(kind, KeyboardInterrupt):
        print("uavrl: stopped.", file=sys.stderr)
    else:
        _otherwise(kind, error, trace)


sys.excepthook = _tell
