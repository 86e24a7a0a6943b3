"""How a command's process begins and ends: its log, its terminal, its arguments, and errors in one sentence."""

import codecs
import errno
import io
import logging
import os
import select
import signal
import sys
import threading
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

from uavrl.errors import Stopped, UavrlError, reason, was_interrupted
from uavrl.runs.shared_memory import shared_memory_explained

SAFE_PATH = "PYTHONSAFEPATH"  # with it set no Python that starts imports from the working folder
PLAIN = "uavrl.plain"  # the name of :func:`_plain` among Python's handlers of what cannot be encoded
_LEFT = {errno.EPIPE: signal.SIGPIPE, errno.EIO: signal.SIGHUP}  # by what writing to it answers
_PLAINER = {"–": "-", "—": "-", "→": "->", "×": "x", "’": "'"}  # where Unicode knows no plainer form


def sentence(error: BaseException | None) -> str:
    """What the user can mend."""
    of_a_disk = isinstance(error, OSError) and not isinstance(error, ConnectionError)
    return f"{reason(error)}. Check the folder and the space left on its disk." if of_a_disk else reason(error)


def _reader_left(error: BaseException) -> signal.Signals | None:
    """What ends a command whose output nobody reads on: ``uavrl-evaluate … | head``, or a terminal that was closed.

    None: somebody does; another pipe may have broken as well.
    """
    number = _LEFT.get(error.errno or 0) if isinstance(error, OSError) else None
    return number if number is not None and _to_nowhere(sys.stdout) else None


def _to_nowhere(stream: TextIO) -> bool:
    """Leads what Python flushes at its end to nowhere, if nobody reads the stream any more; whether nobody does."""
    try:
        out = stream.fileno()
    except (OSError, ValueError):  # no file of the system's, as in tests, or closed
        return False
    asked = select.poll()
    asked.register(out, 0)
    if not any(event & (select.POLLERR | select.POLLHUP) for _, event in asked.poll(0)):
        return False
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, out)
    os.close(nowhere)
    return True


@contextmanager
def one_sentence() -> Iterator[None]:
    """Prints what the user can mend, without a traceback, and exits with 1.

    Ctrl-C exits with 130, SIGTERM with 143, a terminal that was closed with 129.
    """
    try:
        with shared_memory_explained():
            yield
    except SystemExit:  # told by one inside of this
        raise
    except (UavrlError, OSError) as error:
        if (number := _reader_left(error)) is not None:
            raise SystemExit(128 + number) from error
        print(f"uavrl: {sentence(error)}", file=sys.stderr)
        raise SystemExit(1) from error
    except BaseException as error:
        if not was_interrupted(error):
            raise
        stopped = error if isinstance(error, Stopped) else Stopped()
        with suppress(OSError):  # of a terminal that was closed
            print(f"uavrl: {stopped}", file=sys.stderr, flush=True)
        for stream in (sys.stdout, sys.stderr):  # else what is left to flush would fail, and Python exit with 120
            _to_nowhere(stream)
        raise SystemExit(stopped.exit_code) from stopped


@contextmanager
def terminable() -> Iterator[None]:
    """Lets SIGTERM, and a terminal that closes, end what a command does as Ctrl-C does, so that it writes what it has.

    What is ignored stays ignored, as under ``nohup``.
    """

    def stop(number: int, _: object) -> None:
        raise Stopped(number=number)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    taken = [number for number, handler in before.items() if handler not in (signal.SIG_IGN, None)]
    for number in taken:
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, before[number])


def configure_logging() -> None:
    """Sends the library's log to standard error, in short lines; call it before TorchRL is imported."""
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")
    os.environ.setdefault("RL_WARNINGS", "False")
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr, force=True)
    logging.captureWarnings(True)  # so that they keep out of a progress line as all that is logged does
    logging.getLogger("torch").setLevel(logging.WARNING)  # if it is interrupted while it loads, it tells of its caches
    logging.getLogger("torch.utils.cpp_extension").setLevel(logging.ERROR)  # a CUDA compiler without a GPU is no news
    for name in logging.root.manager.loggerDict:
        if name.startswith("uavrl."):
            logging.getLogger(name).disabled = False  # Hydra silences those of an earlier run of the sweep


@contextmanager
def command_process() -> Iterator[None]:
    """Around all that a command does: a mistake ends in one sentence, in whatever encoding the terminal has.

    Processes that are started import nothing from the working folder, which may be the run folder of somebody else.
    """
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    codecs.register_error(PLAIN, _plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=PLAIN)
    try:
        with one_sentence(), terminable():
            _check_arguments()
            yield
            sys.stdout.flush()  # here, where somebody hears of a pipe that was closed
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before


def _plain(error: UnicodeError) -> tuple[str, int]:
    """What an encoding cannot hold, in ASCII.

    Examples:
        >>> codecs.register_error(PLAIN, _plain)
        >>> "ABR⁺: 81–89 m³ … 空".encode("ascii", PLAIN)
        b'ABR+: 81-89 m3 ... ?'
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    plainer = (_PLAINER.get(letter) or unicodedata.normalize("NFKD", letter) for letter in text)
    return "".join(each.encode("ascii", "ignore").decode() or "?" for each in plainer), error.end


def _check_arguments() -> None:
    """Refuses an argument whose bytes are no text: it could be written into no file."""
    for argument in sys.argv[1:]:
        shown = argument.encode("utf-8", "replace").decode()
        if shown != argument:
            raise UavrlError(
                f"The argument {shown!r} holds letters that are no text in the encoding of this terminal "
                f"({sys.getfilesystemencoding()}): rename what it names, or set LC_ALL=C.UTF-8."
            )
