"""The command line: one small file for each command."""

import sys
from types import TracebackType

_otherwise = sys.excepthook


def _tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Ctrl-C while the modules of a command are still being imported is told as later (:mod:`uavrl.cli.errors`)."""
    if issubclass(kind, KeyboardInterrupt):
        print("uavrl: stopped.", file=sys.stderr)
    else:
        _otherwise(kind, error, trace)


sys.excepthook = _tell
