"""The one thread that owns a filter: takes what has come, fuses it, gives away the results, and shows a snapshot."""

import time
from dataclasses import dataclass

from fuselog.fusion import Estimate, Filter, Ledger, Outputs, Plan, Track, join_tracks
from fuselog.fusion.health import Health, Losses, Recent, assess, no_samples, remember
from fuselog.fusion.intake import same_topic
from fuselog.replay.recording import RecordingStatus
from fuselog.service.live.inbox import Inbox
from fuselog.service.live.outbox import Outbox
from fuselog.service.live.sources import Progress, Sources
from fuselog.service.streams import Learn, Streams, stream_types

_LOOK_EVERY_S = 0.02  # how old a snapshot may be
_IDLE_S = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """A filter at one moment. Never changed, only replaced: who holds one may read it on any thread."""

    plan: Plan
    estimate: Estimate
    ledger: Ledger
    recent: Recent
    optimality_ratio: float | None
    losses: dict[str, Losses]  # by key
    progress: dict[str, dict[str, Progress]]  # by publisher and key
    unpublished: int
    last_arrival: float | None  # monotonic s
    recording: RecordingStatus | None = None  # None: there is to be none

    @property
    def health(self) -> Health:
        """What is wrong with the filter, and why."""
        return assess(
            self.plan,
            estimate=self.estimate,
            ledger=self.ledger,
            recent=self.recent,
            losses=self.losses,
            optimality_ratio=self.optimality_ratio,
        )


class Runner:
    """Feeds a filter from its inbox until ``stop``, then finishes what is there; ``snapshot`` is always the latest.

    ``heartbeat`` is the monotonic time (s) of its last turn.
    """

    def __init__(self, plan: Plan, outbox: Outbox, *, learn: Learn) -> None:
        self.plan = plan
        self._filter = Filter(plan, order="as_received", compare=True)
        self._outputs, self._outbox = Outputs(plan), outbox
        topics = {sensor.settings.topic: sensor.settings.type for sensor in plan.sensors}
        streams = Streams(self._filter.intake, stream_types(topics), learn)
        self.keys = [same_topic(topic) for topic in self._filter.intake.topics]
        self.inbox = Inbox(len(self.keys))
        self._sources = Sources(self.keys, streams.identify)
        self._recent = no_samples(plan)
        self._tracks: list[Track] = []  # since the last look
        self._last_arrival: float | None = None
        self._stopping = False
        self.heartbeat = time.monotonic()
        self.snapshot = self._look()

    def stop(self) -> None:
        """Let ``run`` end when the inbox is empty."""
        self._stopping = True

    def run(self) -> None:
        """Turn after turn until ``stop``."""
        looked, stale = 0.0, False
        while True:
            stopping = self._stopping
            arrivals = self.inbox.take(_LOOK_EVERY_S if stale or stopping else _IDLE_S)
            self.heartbeat = time.monotonic()
            if arrivals:
                self._tracks.append(self._filter.feed(self._sources.batch(arrivals)))
                self._outbox.offer(self._outputs.encode(self._tracks[-1], self._filter.beside()))
                self._last_arrival, stale = self.heartbeat, True
            if stale and (not arrivals or self.heartbeat - looked > _LOOK_EVERY_S):
                self.snapshot, looked, stale = self._look(), self.heartbeat, False
            if stopping and not arrivals:
                self._outbox.offer(self._outputs.encode(self._filter.finish(), self._filter.beside()))
                self._outbox.offer(self._outputs.finish())
                return

    def _look(self) -> Snapshot:
        if self._tracks:
            self._recent = remember(self._recent, join_tracks(self._tracks))
            self._tracks.clear()
        return Snapshot(
            plan=self.plan,
            estimate=self._filter.estimate,
            ledger=self._filter.ledger,
            recent=self._recent,
            optimality_ratio=self._filter.optimality_ratio,
            losses=self._losses(),
            progress=self._sources.progress(),
            unpublished=self._outbox.dropped,
            last_arrival=self._last_arrival,
        )

    def _losses(self) -> dict[str, Losses]:
        """Samples that were shed show as gaps in the numbering too; they are counted once."""
        sources, shed = self._sources, self.inbox.shed
        columns = zip(self.keys, shed, sources.missed, sources.unknown, sources.reasons, strict=True)
        return {
            key: Losses(shed, max(missed - shed, 0), unknown, reason) for key, shed, missed, unknown, reason in columns
        }
