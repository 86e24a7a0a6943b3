"""The age of messages that may have waited on their way, by a sender's clock that may be set while it runs."""

from __future__ import annotations

import logging
from dataclasses import dataclass

_logger = logging.getLogger(__name__)

_RESTART = 10.0  # s back that are never a late message: the sender's clock was set, or its sender has started again
_FORWARD = 1.0  # s that a message is ahead of the one before, beyond the time between their arrivals
_DRIFT = 1.1  # rate of a sender's clock relative to ours that is still taken for a clock that runs
_RUNNING = 3  # messages in a row from the past whose stamps run on, which late messages do not do
_OFTEN, _SOON = 3, 10.0  # steps within so many s that are no clock's: two senders are taken for one
_PACE = 0.5  # least time between two of their arrivals, as a share of that between their stamps: a burst is no clock


@dataclass
class SenderClock:
    """Convert the stamps of a sender's clock, of which we only know that it runs, to times on our clock.

    A message that waited on its way is as old as its stamp says, relative to the message before. A message that comes
    late or twice has no time. A clock that steps back (by NTP, a bag that starts again, a restart) would make every
    message late until it has caught up; so three messages in a row whose stamps run on from an earlier time are a
    step, and the third one counts from its arrival. Each step is logged and counted. Where the clock steps again and
    again, two senders are taken for one, which is logged instead, once.

    Args:
        name: of the sender's messages, for the log.

    Attributes:
        steps: the number of steps so far.
        offset: sum of all steps, in s; negative where the clock has gone back.

    Examples:
        >>> clock = SenderClock("the example")
        >>> [clock.stamp(sent, now) for sent, now in [(7.0, 100.0), (7.1, 100.1), (7.1, 100.2), (7.2, 100.5)]]
        [100.0, 100.1, None, 100.21]
        >>> [clock.stamp(sent, now) for sent, now in [(4.3, 100.6), (4.4, 100.7), (4.5, 100.8)]], clock.steps
        ([None, None, 100.8], 1)
    """

    name: str
    steps: int = 0
    offset: float = 0.0
    _before: tuple[float, float] | None = None  # stamp of the newest message, and when it was sent by our clock
    _stepped: tuple[float, ...] = ()  # when it did, by our clock
    _is_shared: bool = False  # whether that was told of two senders
    _past: tuple[tuple[float, float], ...] = ()  # stamp and arrival of messages in a row that are older than that

    def stamp(self, sent: float, now: float) -> float | None:
        """Return when a message was sent, in s of our clock; ``None`` where it is no newer than the one before.

        Args:
            sent: when it was sent, in s of its sender's clock.
            now: our clock at its arrival.
        """
        if self._before is None:
            stamp = now
        elif sent <= self._before[0] and not self._has_stepped_back(sent, now):
            return None
        elif sent <= self._before[0]:
            by = max(made - self._before[0] - (came - self._before[1]) for made, came in self._past)
            self._step(by, now)
            stamp = now
        else:
            ahead = sent - self._before[0] - (now - self._before[1])
            if ahead > _FORWARD:
                self._step(ahead, now)
            stamp = min(now, self._before[1] + _DRIFT * (sent - self._before[0]))
        self._before, self._past = (sent, stamp), ()
        return stamp

    def _has_stepped_back(self, sent: float, now: float) -> bool:
        """Whether a message from the past is the one that shows that the clock has stepped."""
        assert self._before is not None
        if self._past and sent == self._past[-1][0]:  # sent twice
            return False
        follows = self._past and sent > self._past[-1][0]
        self._past = (*self._past, (sent, now)) if follows else ((sent, now),)
        (first, came), enough = self._past[0], len(self._past) >= _RUNNING
        return self._before[0] - sent > _RESTART or (enough and now - came >= _PACE * (sent - first))

    def _step(self, by: float, now: float) -> None:
        """Note a step of the clock, in s, forward or back."""
        self.steps += 1
        self.offset += by
        self._stepped = (*(each for each in self._stepped if now - each < _SOON), now)
        if len(self._stepped) > _OFTEN:
            if not self._is_shared:
                _logger.warning(
                    "The stamps of %s step back and forth: two senders are taken for one. Turn one off, or give each a "
                    "number or a topic of its own.",
                    self.name,
                )
            self._is_shared = True
            return
        way = "forward" if by > 0.0 else "back"
        _logger.warning(
            "The clock that stamps %s has stepped %s by %.1f s: it was set, as by NTP, or its sender has started "
            "again. The stream goes on.",
            self.name,
            way,
            abs(by),
        )
