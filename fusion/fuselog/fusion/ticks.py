"""Estimates at event-time ticks: the multiples of a period, each predicted from what the filter knew until then."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.commands import CommandError
from fuselog.fusion.engine import Engine
from fuselog.fusion.events import Decision, Events
from fuselog.fusion.kept import take_whole
from fuselog.fusion.kernel.tables import NEVER
from fuselog.fusion.plan import Plan
from fuselog.fusion.track import Track, join_tracks, period_ns

Floats = NDArray[np.float64]


class Ticked(NamedTuple):
    """n estimates, every state of which is known."""

    t_ns: NDArray[np.int64]  # (n,)
    x: Floats  # (n, N)
    P: Floats  # (n, N (N + 1) / 2) upper triangle, row by row


class Ticks:
    """Moves an engine, and stops at every tick on the way.

    A tick is told when the first sample with a stamp after it comes, from all that came before that sample; in a
    silence the ticks go on for ``lag.max_step``. Cutting the input into batches changes no bit.
    """

    def __init__(self, plan: Plan, rate: float) -> None:
        """``rate`` in Hz; the period is a whole number of ns."""
        self._period_ns = period_ns(rate)
        self._most_ns = round(plan.config.lag.max_step * 1e9)
        self._packed = np.triu_indices(len(plan.states))
        self._told: list[tuple[int, Floats, Floats]] = []
        self.newest = NEVER

    def load(self, newest: int) -> None:
        """Go on after a newest stamp."""
        self.newest, self._told = take_whole(newest), []

    def reset(self) -> None:
        """Wait for a first sample again."""
        self.newest = NEVER

    def take(self) -> Ticked | None:
        """The estimates since this was last asked; None where there were none."""
        told, self._told = self._told, []
        if not told:
            return None
        t_ns, x, P = zip(*told, strict=True)
        return Ticked(np.array(t_ns), np.stack(x), np.stack(P))

    def advance(self, engine: Engine, events: Events) -> Track:
        """As ``Engine.advance``, by pieces."""
        tracks, first = list[Track](), 0
        for at, begin, end in self._passed(events):
            tracks.append(engine.advance(events.take(slice(first, at))))
            self._tell(engine, begin, end)
            first = at
        tracks.append(engine.advance(events.take(slice(first, None)) if first else events))
        return join_tracks(tracks) if len(tracks) > 1 else tracks[0]

    def _passed(self, events: Events) -> Iterator[tuple[int, int, int]]:
        """The events that pass ticks, and the stamps between which these are: [begin, end)."""
        stamps = np.where(events.fault == Decision.FUSED, events.t_ns, NEVER)
        newest = np.maximum.accumulate(np.append(self.newest, stamps))
        for at in np.flatnonzero(newest[1:] > newest[:-1]).tolist():
            begin, end = int(newest[at]), int(newest[at + 1])
            if begin != NEVER and -(-begin // self._period_ns) < -(-end // self._period_ns):
                yield at, begin, end
        self.newest = int(newest[-1])

    def _tell(self, engine: Engine, begin: int, end: int) -> None:
        first = -(-begin // self._period_ns) * self._period_ns
        for t_ns in range(first, min(end, begin + self._most_ns + 1), self._period_ns):
            try:
                estimate = engine.estimate_at(t_ns)
            except CommandError:  # nothing was fused yet, or the model has no estimate there
                continue
            if estimate.known.all():
                self._told.append((t_ns, estimate.x, estimate.P[self._packed]))
