"""Turns errors into one sentence and an exit code."""

import logging
import os
import select
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from uavrl.errors import Stopped, UavrlError, was_interrupted


def sentence(error: BaseException | None) -> str:
    """What the user can mend."""
    of_a_disk = isinstance(error, OSError) and not isinstance(error, ConnectionError)
    return f"{error}. Check the folder and the space left on its disk." if of_a_disk else str(error)


def _reader_left(error: BaseException) -> bool:
    """Whether nobody reads on what is printed: ``uavrl-evaluate … | head``. Another pipe may have broken as well."""
    if not isinstance(error, BrokenPipeError):
        return False
    out = sys.stdout.fileno()
    asked = select.poll()
    asked.register(out, 0)
    left = any(event & (select.POLLERR | select.POLLHUP) for _, event in asked.poll(0))
    if left:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, out)  # for what Python flushes at its end
        os.close(nowhere)
    return left


@contextmanager
def one_sentence() -> Iterator[None]:
    """Prints what the user can mend, without a traceback, and exits with 1; Ctrl-C exits with 130, SIGTERM with 143."""
    try:
        yield
    except SystemExit:  # told by one inside of this
        raise
    except (UavrlError, OSError) as error:
        if _reader_left(error):
            raise SystemExit(128 + signal.SIGPIPE) from error
        print(f"uavrl: {sentence(error)}", file=sys.stderr)
        raise SystemExit(1) from error
    except BaseException as error:
        if not was_interrupted(error):
            raise
        stopped = error if isinstance(error, Stopped) else Stopped()
        print(f"uavrl: {stopped}", file=sys.stderr)
        raise SystemExit(stopped.exit_code) from stopped


def configure_logging() -> None:
    """Sends the library's log to standard error, in short lines; call it before TorchRL is imported."""
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")
    os.environ.setdefault("RL_WARNINGS", "False")
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr, force=True)
    logging.captureWarnings(True)  # so that they keep out of a progress line as all that is logged does
    logging.getLogger("torch.utils.cpp_extension").setLevel(logging.ERROR)  # a CUDA compiler without a GPU is no news
    for name in logging.root.manager.loggerDict:
        if name.startswith("uavrl."):
            logging.getLogger(name).disabled = False  # Hydra silences those of an earlier run of the sweep
