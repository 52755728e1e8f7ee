"""The transport of a player: which time of the log it is, and when a message is due. No messages, threads or sleep."""

from collections.abc import Callable
from dataclasses import dataclass

from fuselog.schemas import FuselogError

SLACK_NS = 50_000_000  # of lateness that is caught up; more than that shifts the timeline
SLOWEST, FASTEST = 1e-3, 1e6


class CommandError(FuselogError):
    """A command that a player cannot follow, and why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """What of a log is played, in ns of its own time; raises ``CommandError`` when nothing is left of it."""

    first: int  # of the log: offsets count from here
    last: int
    start: int  # where playing begins
    end: int | None = None  # what comes from here on is not played; None plays the last message as well
    again: int | None = None  # where a loop goes back to at the end; None plays once

    def __post_init__(self) -> None:
        end = self.last if self.end is None else self.end
        if self.start > end or self.start == self.end:
            raise CommandError(f"nothing to play: start {self._offset(self.start)}, end {self._offset(end)}")
        if self.again is not None and self.again >= end:
            raise CommandError(f"nothing to loop: from {self._offset(self.again)} to {self._offset(end)}")

    @property
    def finish(self) -> int:
        """Where the loop turns: its end, or the last message of the log."""
        return self.last if self.end is None else self.end

    def _offset(self, t_ns: int) -> str:
        return f"{(t_ns - self.first) / 1e9:.3f} s"


class Timeline:
    """A position in a log that moves with ``clock`` (ns) at a rate, stands still, jumps, and turns where a loop ends.

    A message at t is due (t - position) / rate after the instant at which the position was set; with ``rate`` None at
    that instant. What leaves later than ``SLACK_NS`` moves the whole timeline back by its lateness, for all topics
    alike: a slow consumer slows playing down, and gets no burst afterwards.
    """

    def __init__(
        self,
        range: Range,
        clock: Callable[[], int],
        *,
        rate: float | None = 1.0,
        paused: bool = False,
        delay_ns: int = 0,
    ) -> None:
        self.range = range
        self.paused = paused
        self.rounds = 0  # of the loop that are over
        self.slipped_ns = 0  # how far it was moved back in all
        self.rate = checked_rate(rate)
        self._clock = clock
        self._delay_ns = delay_ns
        self._steps = 0  # messages that may leave while paused
        self._set(range.start, clock() + delay_ns)

    @property
    def position(self) -> int:
        """Log time in ns."""
        if self.paused or self.rate is None:
            return self._t_ns
        moved = self._t_ns + max(0, round((self._clock() - self.since) * self.rate))
        return max(self._t_ns, min(moved, self._limit))

    def due(self, t_ns: int) -> int | None:
        """When the next message, which lies at ``t_ns``, is to leave; None while only a command can say."""
        self._limit = t_ns
        if self.paused:
            return self.since if self._steps else None
        if self.rate is None:
            return self.since
        return self.since + max(0, round((t_ns - self._t_ns) / self.rate))

    def release(self, t_ns: int, *, is_step: bool = True) -> None:
        """The next message leaves now; one that ``is_step`` uses up a step."""
        self._limit = t_ns  # the position stays here until the next message is known
        if self.paused or self.rate is None:
            self._t_ns = max(self._t_ns, t_ns)
            self._steps -= is_step and self._steps > 0
            return
        due, now = self.due(t_ns), self._clock()
        if due is not None and now - due > SLACK_NS:
            self.slipped_ns += now - due
            self._set(t_ns, now)

    def restart(self) -> None:
        """What is to be played from here is ready only now: opening a log is no lateness."""
        self.since = max(self.since, self._clock())

    def turn(self) -> int | None:
        """Go back to the start of the loop, its end being due; returns where that is, None without a loop."""
        if self.range.again is None:
            return None
        due, now = self.due(self.range.finish), self._clock()
        late = due is None or self.paused or self.rate is None or now - due > SLACK_NS
        self.rounds += 1
        self._set(self.range.again, (now if late or due is None else due) + self._delay_ns)
        return self.range.again

    def pause(self) -> None:
        """Stand still, after what has left already."""
        if not self.paused:
            self._set(self.position, self._clock())
            self.paused = True
        self._steps = 0

    def resume(self) -> None:
        """Go on from where it stands; nothing when it moves."""
        if self.paused:
            self.paused, self._steps = False, 0
            self._set(self._t_ns, self._clock())

    def toggle(self) -> None:
        """Pause, or go on."""
        if self.paused:
            self.resume()
        else:
            self.pause()

    def set_rate(self, rate: float | None) -> None:
        """Go on at another speed from here; None as fast as the consumer takes it. Raises ``CommandError``."""
        rate = checked_rate(rate)
        self._set(self.position, max(self.since, self._clock()))
        self.rate = rate

    def step(self, count: int = 1) -> None:
        """Pause, and let the next ``count`` messages leave at once; raises ``CommandError`` below 1."""
        if count < 1:
            raise CommandError(f"{count} messages cannot be stepped: one or more")
        left = self._steps
        self.pause()
        self._steps = left + count
        self.since = min(self.since, self._clock())

    def seek(self, t_ns: int) -> int:
        """Jump, within the log and before the end of the range; returns where it is now. Steps left are forgotten."""
        self._steps = 0
        self._set(max(self.range.first, min(t_ns, self.range.finish)), self._clock())
        return self._t_ns

    def _set(self, t_ns: int, since: int) -> None:
        self._t_ns = t_ns
        self.since = since  # of the clock: when the position was, or will be, ``t_ns``
        self._limit = t_ns  # of the position: the next message, and this until it is known


def checked_rate(rate: float | None) -> float | None:
    """The rate, None for 0; raises ``CommandError`` for one that cannot be."""
    if not rate:
        return None
    if not SLOWEST <= rate <= FASTEST:
        raise CommandError(f"rate {rate:g} is not between {SLOWEST:g} and {FASTEST:g}, or 0 for no pacing")
    return rate
