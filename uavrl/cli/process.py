"""The process of a command: how it ends, what its terminal can show, and what the processes that it starts import."""

import codecs
import io
import os
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager

from uavrl.cli.errors import one_sentence
from uavrl.errors import UavrlError

SAFE_PATH = "PYTHONSAFEPATH"  # with it set no Python that starts imports from the working folder
PLAIN = "uavrl.plain"  # the name of :func:`_plain` among Python's handlers of what cannot be encoded
_PLAINER = {"–": "-", "—": "-", "→": "->", "×": "x", "’": "'"}  # where Unicode knows no plainer form


@contextmanager
def command_process() -> Iterator[None]:
    """Around all that a command does.

    A mistake ends in one sentence. Texts are shown in whatever encoding the terminal has. Processes that are started
    import nothing from the working folder, which may be the run folder of somebody else: what a user wants to be
    imported is installed, or stands in ``PYTHONPATH``.
    """
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    codecs.register_error(PLAIN, _plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=PLAIN)
    try:
        with one_sentence():
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
