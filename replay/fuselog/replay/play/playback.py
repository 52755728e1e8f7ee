"""A source on a timeline: what leaves next, and when; commands in between. No threads, no sleep, no middleware."""

from collections import deque
from collections.abc import Generator
from dataclasses import dataclass
from typing import Literal

from fuselog.replay.play.clock import ticker, with_ticks
from fuselog.replay.play.played import Played
from fuselog.replay.play.source import Source
from fuselog.replay.play.timeline import Timeline


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """How it stands: position in ns and in s from the beginning of the log; rate None has no pacing."""

    state: Literal["playing", "paused", "ended"]
    t_ns: int
    offset_s: float
    length_s: float
    rate: float | None
    rounds: int
    released: int
    slipped_s: float


class Playback:
    """Releases the messages of a source in its exact order, each when the timeline says so.

    Between two seeks nothing is left out and nothing comes twice, whatever is commanded. Wherever it begins, at the
    start, after a seek, at the start of a loop, there comes at once what latched topics said before and, with
    ``clock_hz``, the time. Raises ``CommandError`` for a rate that no clock can have.
    """

    def __init__(self, source: Source, timeline: Timeline, *, clock_hz: float | None = None) -> None:
        self.timeline = timeline
        self.released = 0
        self._source = source
        self._ticker = None if clock_hz is None else ticker(clock_hz)
        self._begin: int | None = timeline.range.start  # where to begin anew, None where it has
        self._reading: list[Generator[Played]] = []  # the last is what messages come from
        self._at_once: deque[Played] = deque()
        self._head: Played | None = None  # leaves next; None at the end, and until it is known
        self._known = False
        self._idle_round = False  # nothing has left since the loop turned
        self._stopped = False

    @property
    def over(self) -> bool:
        """Whether nothing will ever leave: stopped, or at the end and not paused, for from there one can still seek."""
        if not self._stopped:
            self._prepare()
        return self._over

    def due(self) -> int | None:
        """When to call ``take`` next, by the clock of the timeline; None when it is over, or waits for a command."""
        if self._stopped:
            return None
        self._prepare()
        if self._at_once:
            return self.timeline.since
        if self._head is not None:
            return self.timeline.due(self._head.t_ns)
        return None if self.timeline.range.again is None else self.timeline.due(self.timeline.range.finish)

    def take(self) -> Played | None:
        """What ``due`` spoke of; None when that was the turn of a loop."""
        if self._at_once:
            self.released += 1
            return self._at_once.popleft()
        played = self._head
        if played is None:
            self._turn()
            return None
        self.timeline.release(played.t_ns, is_step=not played.is_tick)
        self.released += 1
        self._idle_round = self._known = False
        return played

    def seek(self, t_ns: int) -> None:
        """Go on from log time ``t_ns``, forwards or backwards, within the log."""
        self._begin = self.timeline.seek(t_ns)
        self._idle_round = False

    def stop(self) -> None:
        """Release nothing more."""
        self._stopped = True

    def close(self) -> None:
        """Let go of the source: it is over."""
        self._stopped = True
        self._close()

    def status(self) -> Status:
        """How it stands now."""
        line = self.timeline
        return Status(
            state="ended" if self._over else "paused" if line.paused else "playing",
            t_ns=line.position,
            offset_s=(line.position - line.range.first) / 1e9,
            length_s=(line.range.last - line.range.first) / 1e9,
            rate=line.rate,
            rounds=line.rounds,
            released=self.released,
            slipped_s=line.slipped_ns / 1e9,
        )

    @property
    def _over(self) -> bool:
        """As far as it is known."""
        at_end = self._begin is None and self._known and self._head is None and not self._at_once
        return self._stopped or (at_end and self.timeline.range.again is None and not self.timeline.paused)

    def _prepare(self) -> None:
        """Begin anew where that was wanted, and know what leaves next."""
        if self._begin is not None:
            self._open(self._begin)
            self._begin = None
        elif not self._known and not self._at_once:
            self._head, self._known = next(self._reading[-1], None), True

    def _open(self, begin: int) -> None:
        self._close()
        span = self.timeline.range
        self._at_once.extend(self._source.latched(begin))
        self._reading.append(self._source.begin(begin, span.end))
        if self._ticker is not None:
            tick, step_ns = self._ticker
            self._at_once.appendleft(tick(begin))
            self._reading.append(with_ticks(self._reading[-1], tick, step_ns, first=span.first, begin=begin))
        self._head, self._known = next(self._reading[-1], None), True
        if not self._idle_round:
            self.timeline.restart()

    def _turn(self) -> None:
        self._begin = self.timeline.turn()
        if self._idle_round:  # a loop without messages would turn for ever
            self._stopped = True
        self._idle_round = True

    def _close(self) -> None:
        while self._reading:
            self._reading.pop().close()
        self._at_once.clear()
        self._head, self._known = None, False
