"""Errors that a command prints as one sentence."""

import difflib
import signal
from collections.abc import Iterable
from typing import Any


class UavrlError(ValueError):
    """A mistake that the user can mend: what was expected, what came, and what to do."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Whole out of another process: pickle would make it anew of its sentence, where other arguments are asked."""
        return _made_again, (type(self), self.args), self.__dict__


def _made_again(kind: type[UavrlError], args: tuple[Any, ...]) -> UavrlError:
    return kind.__new__(kind, *args)  # which keeps them; __init__ made the sentence once


class OtherFormat(UavrlError):
    """A file of the right name, perhaps whole, is not of the kind that is read."""

    def __init__(self, path: object, lacks: str, writer: str = "uavrl-train") -> None:
        super().__init__(f"{path} has no {lacks}: it was not written by this version of {writer}.")


class Stopped(KeyboardInterrupt):
    """A command that a signal has ended: how to go on, and the exit code that shells expect."""

    def __init__(self, how_to_go_on: str = "stopped.", number: int = signal.SIGINT) -> None:
        super().__init__(how_to_go_on)
        self.number, self.exit_code = number, 128 + number


def reason(error: BaseException | None) -> str:
    """What went wrong, in the words of the error; of the system's with the file, and without its number.

    Examples:
        >>> reason(OSError(28, "No space left on device", "page.html"))
        'page.html: No space left on device'
        >>> reason(ValueError("expected a number"))
        'expected a number'
    """
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    return error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"


def was_interrupted(error: BaseException | None) -> bool:
    """Whether an error is Ctrl-C, or came out of its handling.

    TensorDict's ``to_module`` answers an exception inside its ``with`` block by one of its own.

    Examples:
        >>> was_interrupted(KeyboardInterrupt()), was_interrupted(ValueError())
        (True, False)
    """
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__context__
    return False


def did_you_mean(given: str, known: Iterable[str], before: str = "", otherwise: str = "", cutoff: float = 0.6) -> str:
    """A question about the nearest known name, or the text ``otherwise`` if none is near.

    Of dotted names in one place only the last part counts: what they share makes them no nearer.

    Examples:
        >>> did_you_mean("plane", ["planes", "traps"], ": ")
        ': did you mean planes?'
        >>> did_you_mean("lidar.channels", ["lidar.range_noise"], ": ", "look at the list.")
        ': look at the list.'
    """
    near = difflib.get_close_matches(given, list(known), n=1, cutoff=cutoff)
    text = f"did you mean {near[0]}?" if near and _ends_alike(given, near[0], cutoff) else otherwise
    return before + text if text else "."


def _ends_alike(given: str, near: str, cutoff: float) -> bool:
    """Whether two dotted names that differ in the last part alone are near in that."""
    (place, _, last), (other_place, _, other) = given.rpartition("."), near.rpartition(".")
    return place != other_place or difflib.SequenceMatcher(None, last, other).ratio() >= cutoff
