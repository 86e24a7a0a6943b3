"""Turns errors into one sentence and an exit code."""

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from uavrl.errors import Stopped, UavrlError, was_interrupted


def sentence(error: BaseException | None) -> str:
    """What the user can mend."""
    return f"{error}. Check the folder and the space left on its disk." if isinstance(error, OSError) else str(error)


@contextmanager
def one_sentence() -> Iterator[None]:
    """Prints what the user can mend, without a traceback, and exits with 1; Ctrl-C exits with 130, SIGTERM with 143."""
    try:
        yield
    except SystemExit:  # told by one inside of this
        raise
    except (UavrlError, OSError) as error:
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
