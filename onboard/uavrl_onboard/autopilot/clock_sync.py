"""How old messages are that may have waited on their way."""

from __future__ import annotations

from dataclasses import dataclass

_RESTART = 10.0  # s by which a sender's clock goes back when it has started anew, and not for a late message
_DRIFT = 1.1  # how much faster than its own the clock of a sender may seem


@dataclass
class SenderClock:
    """Gives messages a time on our clock by their time on their sender's, of which we know no more than that it runs.

    A message that waited somewhere is as old as the sender's clock says it is, from the stamp of the one before. One
    that comes late or twice has none.

    Examples:
        >>> clock = SenderClock()
        >>> [clock.stamp(sent, now) for sent, now in [(7.0, 100.0), (7.1, 100.1), (7.1, 100.2), (7.2, 100.5)]]
        [100.0, 100.1, None, 100.21]
    """

    _before: tuple[float, float] | None = None

    def stamp(self, sent: float, now: float) -> float | None:
        """When a message came, in s of our clock; ``None`` where it is no newer than the one before.

        Args:
            sent: when it was sent, in s of its sender's clock.
            now: our clock at its arrival.
        """
        if self._before is None or self._before[0] - sent > _RESTART:
            stamp = now
        elif sent <= self._before[0]:
            return None
        else:
            stamp = min(now, self._before[1] + _DRIFT * (sent - self._before[0]))
        self._before = sent, stamp
        return stamp
