"""One filter of a service: samples in, results to its outbox, and a snapshot of it for whoever asks."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from fuselog.fusion import Estimate, Filter, Ledger, Outputs, Plan, Track, join_tracks
from fuselog.fusion.health import Health, Losses, Recent, assess, no_samples, remember
from fuselog.fusion.intake import same_topic
from fuselog.replay.recording import RecordingStatus
from fuselog.service.live.group import Group
from fuselog.service.live.outbox import Outbox
from fuselog.service.live.sources import Numbered, Progress, Sources
from fuselog.service.streams import Learn, Streams, stream_types


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


class Member:
    """A filter and what goes with it. All methods belong to the thread that owns the filters; ``snapshot`` to all."""

    def __init__(self, group: Group, plan: Plan, outputs: Outputs, outbox: Outbox, *, learn: Learn) -> None:
        self.group, self.plan, self.outbox = group, plan, outbox
        self.filter = Filter(plan, order="as_received", compare=True)
        self.keys = [same_topic(topic) for topic in self.filter.intake.topics]
        self.last_arrival: float | None = None  # monotonic s
        self._outputs = outputs
        types = {sensor.settings.topic: sensor.settings.type for sensor in plan.sensors}
        streams = Streams(self.filter.intake, stream_types(types), learn)
        self._sources = Sources(self.keys, streams.identify)
        self._recent = no_samples(plan)
        self._tracks: list[Track] = []  # since the last look
        self._shed = [0] * len(self.keys)
        self.snapshot = self._look()

    def feed(self, arrivals: Sequence[Numbered]) -> None:
        """Fuse samples of ``keys``, by their numbers, and give the results away."""
        self.last_arrival = time.monotonic()
        track = self.filter.feed(self._sources.batch(arrivals))
        self._tracks.append(track)
        self.outbox.offer(self._outputs.encode(track, self.filter.beside()))

    def look(self, shed: Sequence[int]) -> None:
        """Renew the snapshot; ``shed``: samples of each key that were not let in."""
        self._shed = list(shed)
        self.snapshot = self._look()

    def finish(self) -> None:
        """Give away what was held back."""
        track = self.filter.finish()
        self._tracks.append(track)
        self.outbox.offer(self._outputs.encode(track, self.filter.beside()))
        self.outbox.offer(self._outputs.finish())
        self.outbox.close()
        self.snapshot = self._look()

    def command(self, command: Command, asked_ns: int) -> None:
        """Follow a command; raises ``CommandError`` or ``ConfigError`` where it cannot. What it did is published."""
        try:
            track = self.filter.command(command, asked_ns)
            self._tracks.append(track)
        finally:
            self.outbox.offer(self._outputs.encode(self._nothing if track is None else track, self.filter.beside()))
            self.plan = self.filter.plan

    def progress(self) -> dict[str, dict[str, Progress]]:
        """By publisher and key, exact."""
        return self._sources.progress()

    def _look(self) -> Snapshot:
        if self._tracks:
            self._recent = remember(self._recent, join_tracks(self._tracks))
            self._tracks.clear()
        return Snapshot(
            plan=self.plan,
            estimate=self.filter.estimate,
            ledger=self.filter.ledger,
            recent=self._recent,
            optimality_ratio=self.filter.optimality_ratio,
            losses=self._losses(),
            progress=self._sources.progress(),
            unpublished=self.outbox.dropped,
            last_arrival=self.last_arrival,
        )

    def _losses(self) -> dict[str, Losses]:
        """Samples that were shed show as gaps in the numbering too; they are counted once."""
        sources = self._sources
        columns = zip(self.keys, self._shed, sources.missed, sources.unknown, sources.reasons, strict=True)
        return {
            key: Losses(shed, max(missed - shed, 0), unknown, reason) for key, shed, missed, unknown, reason in columns
        }
