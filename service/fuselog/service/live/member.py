"""One filter of a service: samples in, results to its outbox, and a snapshot of it for whoever asks."""

import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fuselog.fusion import Estimate, Filter, Ledger, Outputs, Plan, Track
from fuselog.fusion.captures import Captures, fill
from fuselog.fusion.commands import Command, CommandError, Configure
from fuselog.fusion.health import (
    Health,
    HealthChange,
    HealthMemory,
    Losses,
    Recent,
    Seen,
    health_message,
    no_judgement,
    no_samples,
    remember,
    seen,
    watch,
)
from fuselog.fusion.intake import same_topic
from fuselog.fusion.sealed import CheckpointError, seal, unseal
from fuselog.fusion.together import shape_of
from fuselog.fusion.track import Share, whole
from fuselog.replay.recording import RecordingStatus
from fuselog.schemas import FuselogError, Messages
from fuselog.service.batch import Batch
from fuselog.service.live.group import Group
from fuselog.service.live.outbox import Outbox
from fuselog.service.live.sources import Progress, Run, Sources
from fuselog.service.streams import Learn, Streams, stream_types

ESTIMATES_ALONE = {0}  # the streams of an outbox of which nothing else is wanted

_MOST_CHANGES = 1000
_MOST_SEEN = 16  # batches that are remembered at once, as a filter has to wait meanwhile
_ABOUT = {"kind": "member of a service"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Delay:
    """From the arrival of a sample to the publication of its results, s: of the last thousand batches."""

    median_s: float
    p99_s: float
    most_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """A filter at one moment. Never changed, only replaced: who holds one may read it on any thread."""

    plan: Plan
    estimate: Estimate
    ledger: Ledger
    recent: Recent
    health: Health  # as it was judged last, within a quarter of a second
    changes: tuple[HealthChange, ...]  # of health, the last thousand; times by the clock of the machine
    losses: dict[str, Losses]  # by key
    progress: dict[str, dict[str, Progress]]  # by publisher and key
    unpublished: int
    delay: Delay | None = None  # None while nothing was published
    last_arrival: float | None  # monotonic s
    origin: str  # how it began: anew, or from a checkpoint, or why not from that
    unpredicted: str = ""  # why nothing was predicted to the machine's time when it was last to be
    unsaved: str = ""  # why the last checkpoint could not be written
    recording: RecordingStatus | None = None  # None: there is to be none


class Member:
    """A filter and what goes with it. All methods belong to the thread that owns the filters; ``snapshot`` to all."""

    def __init__(self, group: Group, captures: Captures, plan: Plan, outbox: Outbox, *, learn: Learn) -> None:
        self.group, self.outbox = group, outbox
        self._captures = captures
        self._plan, self._learn = plan, learn  # the plan at the start: a command may give the filter another
        self.shape = shape_of(plan)
        self._begin()
        self.last_arrival: float | None = None  # monotonic s
        self.watched = time.monotonic()  # when health was judged, and the snapshot made
        self._outputs = Outputs(plan)
        self._recent = no_samples(plan)
        self._seen: list[tuple[Seen, slice]] = []  # not yet remembered
        self._shed, self._oversized, self._missed = ([0] * len(self.keys) for _ in range(3))
        self._origin, self._unpredicted = "it began anew", ""
        self._predict_from = 0.0  # monotonic s
        self._memory: HealthMemory = no_judgement()
        self._changes: deque[HealthChange] = deque(maxlen=_MOST_CHANGES)
        self._shown: tuple[HealthChange, ...] = ()
        self.snapshot = self._look()

    @property
    def id(self) -> str:
        """What the filter is called."""
        return self.filter.plan.config.id

    def collect(self, runs: Sequence[Run], batch: Batch) -> slice:
        """Put samples of ``keys``, by their numbers, into a batch; returns where in it they are."""
        first = len(batch)
        self._sources.collect(runs, batch)
        self.last_arrival = time.monotonic()
        return slice(first, len(batch))

    @property
    def form(self) -> bytes | None:
        """``Outputs.form``, if nobody wants anything else than that."""
        return self._outputs.form if self.outbox.wanted == ESTIMATES_ALONE else None

    def give(self, share: Share, encoded: Messages | None = None, *, since_ns: int | None = None) -> None:
        """Give away what the filter made of samples of which the oldest arrived then (monotonic).

        ``encoded``: what goes out, where that has been written together with what others give.
        """
        if encoded is None:
            encoded = self._outputs.encode(share.alone(), self.filter.beside(), wanted=self.outbox.wanted)
        self.outbox.offer(encoded, since_ns=since_ns)
        self._seen.append((seen(share.track), share.rows))
        if len(self._seen) >= _MOST_SEEN:
            self._remember()

    def encode_shared(self, track: Track, spans: Sequence[slice]) -> list[Messages]:
        """``Outputs.encode_shared``, for members of one form."""
        return self._outputs.encode_shared(track, spans)

    def command(self, command: Command, asked_ns: int) -> None:
        """Follow a command asked for at ``asked_ns``; raises ``CommandError`` or ``ConfigError`` where it cannot.

        What became of it is published either way.
        """
        if isinstance(command, Configure):
            command = Configure(fill(command.text, self._captures))
        try:
            self.give(whole(self.filter.command(command, asked_ns)))
        except FuselogError:
            self.give(whole(self.filter.feed(Batch().messages())))
            raise

    def turn_away(self, *, shed: Sequence[int], oversized: Sequence[int], missed: Sequence[int]) -> None:
        """So many samples of each key have not come in so far.

        For want of room, as too large, and by what the network says of those that it could not bring.
        """
        self._shed, self._oversized, self._missed = list(shed), list(oversized), list(missed)

    def watch(self) -> None:
        """Judge the health anew, publish it, and renew the snapshot."""
        self.snapshot = self._look()
        if self.outbox.wants("health"):
            health = self.snapshot.health
            payload = health_message(health, filter_id=self.id, frame=self.filter.plan.config.output.frame)
            self.outbox.tell("health", payload, health.t_ns or 0)

    def predict_when_due(self, now: float) -> float:
        """Publish the state predicted to the time of the machine's clock, if it is due at ``now`` (monotonic s).

        Returns when it is due next; never, where it is not wanted.
        """
        rate = self.filter.plan.config.output.now
        if rate is None:
            return math.inf
        if now >= self._predict_from:
            self._predict_from = max(self._predict_from + 1 / rate, now)
            self._predict()
        return self._predict_from

    def finish(self) -> None:
        """Give away what was held back."""
        self.give(whole(self.filter.finish()))
        self.outbox.offer(self._outputs.finish())
        self.snapshot = self._look()
        self.outbox.close()

    def checkpoint(self) -> bytes:
        """All that it remembers, and how far publishers were."""
        filter = np.frombuffer(self.filter.checkpoint(), np.uint8)
        about = {"at_ns": time.time_ns(), "given": self._plan.source.text, "text": self.filter.plan.source.text}
        return seal(_ABOUT, {**about, "sources": self._sources.save(), "filter": filter})

    def resume(self, data: bytes) -> None:
        """Go on where a checkpoint was made; where that is not possible, begin anew and say why in ``origin``."""
        try:
            tree = unseal(data, _ABOUT)
            if tree["given"] != self._plan.source.text:
                raise CheckpointError("is of another configuration")
            if tree["text"] != tree["given"]:
                self.filter.command(Configure(tree["text"]))
            self.filter.restore(tree["filter"].tobytes())
            self._streams.resume(self.filter.intake.streams)
            self._sources.load(tree["sources"])
            age_s = (time.time_ns() - tree["at_ns"]) / 1e9
            self._origin = f"it went on from a checkpoint that was {age_s:.1f} s old"
        except (FuselogError, LookupError, AttributeError, TypeError, ValueError) as error:
            self._begin()  # nothing of a checkpoint that holds in part
            self._origin = f"it began anew: {error}"
        self.snapshot = self._look()

    def progress(self) -> dict[str, dict[str, Progress]]:
        """By publisher and key, exact."""
        return self._sources.progress()

    def _predict(self) -> None:
        self._unpredicted = ""
        if self.snapshot.health.t_ns is None or not self.outbox.wants("now"):
            return
        t_ns = time.time_ns()
        try:
            estimate = self.filter.estimate_at(t_ns)
        except CommandError as error:
            self._unpredicted = str(error)
        else:
            if estimate.known.all():
                self.outbox.tell("now", self._outputs.message(estimate), t_ns)

    def _begin(self) -> None:
        self.filter = Filter(self._plan, order="as_received", compare=True)
        self.keys = [same_topic(topic) for topic in self.filter.intake.topics]
        types = {sensor.settings.topic: sensor.settings.type for sensor in self._plan.sensors}
        self._streams = Streams(self.filter.intake, stream_types(types), self._learn)
        self._sources = Sources(self.keys, self._streams.identify)

    def _remember(self) -> None:
        if self._seen:
            self._recent = remember(self._recent, [each.take(rows) for each, rows in self._seen])
            self._seen.clear()

    def _look(self) -> Snapshot:
        """The filter as it is, its health judged anew; what that changed goes to the changes that are shown."""
        self._remember()
        self.watched = time.monotonic()
        plan, estimate, ledger, losses = self.filter.plan, self.filter.estimate, self.filter.ledger, self._losses()
        self._memory = watch(
            self._memory,
            plan,
            now_ns=time.monotonic_ns(),
            estimate=estimate,
            ledger=ledger,
            recent=self._recent,
            losses=losses,
            optimality_ratio=self.filter.optimality_ratio,
        )
        assert self._memory.health is not None
        if self._memory.changes:
            wall_ns = time.time_ns() - time.monotonic_ns()
            self._changes.extend(change._replace(t_ns=change.t_ns + wall_ns) for change in self._memory.changes)
            self._shown = tuple(self._changes)
        return Snapshot(
            plan=plan,
            estimate=estimate,
            ledger=ledger,
            recent=self._recent,
            health=self._memory.health,
            changes=self._shown,
            losses=losses,
            progress=self._sources.progress(),
            unpublished=self.outbox.dropped,
            delay=_delay(self.outbox.latencies_ns.copy()),
            last_arrival=self.last_arrival,
            origin=self._origin,
            unpredicted=self._unpredicted,
        )

    def _losses(self) -> dict[str, Losses]:
        """Samples that were not let in show as gaps in the numbering too; they are counted once.

        So are those that a publisher's numbers and the network both know to be lost.
        """
        sources = self._sources
        gaps = [max(ours, theirs) for ours, theirs in zip(sources.missed, self._missed, strict=True)]
        columns = zip(self.keys, self._shed, self._oversized, gaps, strict=True)
        return {
            key: Losses(
                shed=shed,
                missed=max(missed - shed - oversized, 0),
                unknown=sources.unknown[number] + oversized,
                reason=sources.reasons[number] or (f"{oversized} payloads were too large" if oversized else ""),
            )
            for number, (key, shed, oversized, missed) in enumerate(columns)
        }


def _delay(latencies_ns: deque[int]) -> Delay | None:
    if not latencies_ns:
        return None
    ordered = sorted(latencies_ns)
    last = len(ordered) - 1
    return Delay(median_s=ordered[last // 2] / 1e9, p99_s=ordered[last * 99 // 100] / 1e9, most_s=ordered[last] / 1e9)
