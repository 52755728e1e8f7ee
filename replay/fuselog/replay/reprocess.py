"""A log through a filter, as fast as the machine allows: tracks out, and an output log when asked for."""

import hashlib
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fuselog.fusion import Beside, Filter, Order, Outputs, Plan, Stream, Track, join_tracks, load_plan
from fuselog.fusion.captures import require_none
from fuselog.fusion.preparation import Prepared
from fuselog.fusion.report import estimate_json, ledger_json
from fuselog.replay.ahead import ahead
from fuselog.replay.commanded import Commanded
from fuselog.replay.log import Log
from fuselog.replay.log.channels import Channel
from fuselog.replay.log.loss import Loss
from fuselog.replay.opening import open_log
from fuselog.replay.smoothing import smoothed, smoothing_plan
from fuselog.replay.tracks import TrackWriter, is_output, was_turned_away
from fuselog.schemas import Messages, schema_to_text

_UNDER_WAY = 3  # batches of tracks that may wait to be written
_AHEAD = 2  # batches that may be prepared before the filter takes them
_BATCH = 4096  # messages fed at a time: what they become stays in the processor's cache

Advance = Callable[[float, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """What a run did; ``sha256`` is over the published estimates, message after message."""

    output: str | None
    messages: int
    seconds: float
    ledger: dict[str, dict[str, Any]]
    final: dict[str, Any]
    sha256: str
    smoothed: bool
    losses: list[Loss]
    followed: int = 0  # commands that the log has
    passed_over: list[str] = field(default_factory=list[str])  # why each of the others was not followed

    @property
    def lossy(self) -> bool:
        """Whether anything of the log could not be read."""
        return bool(self.losses)

    def to_json(self) -> dict[str, Any]:
        """The summary as plain data."""
        return {
            "schema": 1,
            "output": self.output,
            "messages": self.messages,
            "seconds": round(self.seconds, 6),
            "ledger": self.ledger,
            "final": self.final,
            "sha256": self.sha256,
            "smoothed": self.smoothed,
            "commands": {
                "followed": self.followed,
                "not_followed": len(self.passed_over),
                "reasons": list(dict.fromkeys(self.passed_over)),
            },
            "losses": [asdict(loss) for loss in self.losses],
        }


def reprocess(
    log: Log | str | Path, config: Plan | str | Path, *, order: Order | None = None, smooth: bool = False
) -> Track:
    """The whole track of a log, in memory; ``config`` is a plan or a file. Raises ``LogError`` and ``ConfigError``.

    ``smooth``: every estimate knows the whole log; in the order of stamps and with the optimal gain, whatever the
    configuration says.
    """
    plan = config if isinstance(config, Plan) else load_plan(config)
    if not isinstance(log, Log):
        with open_log(log) as opened:
            return reprocess(opened, plan, order=order, smooth=smooth)
    if smooth:
        filter = Filter(smoothing_plan(plan), order="by_stamp")
        return join_tracks(list(smoothed((taken for _, taken in _prepared(log, filter)), filter)))
    return join_tracks([track for _, track in run(log, Filter(plan, order=order or plan.config.lag.order))])


def run(log: Log, filter: Filter, commanded: Commanded | None = None) -> Iterator[tuple[int, Track]]:
    """Feed a log to a filter, a chunk at a time; yields (messages fed, rows), the held rows at the end."""
    for fed, taken in _prepared(log, filter, commanded):
        yield fed, filter.apply(taken)
    yield 0, filter.finish()


def _prepared(log: Log, filter: Filter, commanded: Commanded | None = None) -> Iterator[tuple[int, Prepared]]:
    """A log ready to be applied: (messages taken, what they gave).

    Reading and preparing go on in a thread, ahead of the estimate.
    """
    commanded = commanded or Commanded(log, filter)
    topics = open_inputs(log, filter) | commanded.topics

    def batches() -> Iterator[tuple[int, Prepared]]:
        for messages in log.batches(topics):
            for first in range(0, len(messages), _BATCH):
                yield from commanded.prepare(messages.take(slice(first, first + _BATCH)))

    return ahead(batches(), _AHEAD)


def reprocess_to(
    log: Log, plan: Plan, output: str | Path | None, *, order: Order | None = None, advance: Advance | None = None
) -> Summary:
    """Run a log through a filter and write its tracks as an MCAP log; memory is bounded by a chunk of either."""
    order = order or plan.config.lag.order
    filter, fed = Filter(plan, order=order), list[int]()
    commanded = Commanded(log, filter)
    first, last = log.time_range or (0, 0)

    def tracks() -> Iterator[Track]:
        for count, track in run(log, filter, commanded):
            fed.append(count)
            yield track
            if advance is not None and len(track):
                advance(float(track.arrival_ns[-1] - first), float(max(last - first, 1)))

    return _write(log, filter, tracks(), fed, output, {"order": order}, commanded)


def smooth_to(
    log: Log, plan: Plan, output: str | Path | None, *, spill: Path | None = None, advance: Advance | None = None
) -> Summary:
    """As ``reprocess_to``, but every estimate knows the whole log: the filter's, corrected by what came later.

    In the order of stamps and with the optimal gain, whatever the plan says. Puts aside some kB a sample in ``spill``,
    by default the system's folder for temporary files; raises ``SpillError`` where that cannot be done.
    """
    filter, fed = Filter(smoothing_plan(plan), order="by_stamp"), list[int]()
    commanded = Commanded(log, filter)
    first, last = log.time_range or (0, 0)

    def report(share: float) -> None:
        if advance is not None:
            advance(share, 2.0)

    def batches() -> Iterator[Prepared]:
        for count, taken in _prepared(log, filter, commanded):
            fed.append(count)
            yield taken
            if taken.events.size:
                report(float(taken.events.arrival_ns[-1] - first) / max(last - first, 1))

    rate = plan.config.output.rate
    tracks = smoothed(batches(), filter, rate=rate, spill=spill, report=lambda share: report(1.0 + share))
    made = {"order": "by_stamp", "smoothed": "true", "gain": "optimal"}
    return _write(log, filter, tracks, fed, output, made, commanded)


def _write(
    log: Log,
    filter: Filter,
    tracks: Iterator[Track],
    fed: list[int],
    output: str | Path | None,
    made: dict[str, str],
    commanded: Commanded,
) -> Summary:
    """Write the tracks of a filter, and how they were ``made``; ``fed`` counts the messages of each batch."""
    started = time.perf_counter()
    with _Sink(filter.plan, output) as sink:
        for track in tracks:
            sink.take(track, filter.beside())
        digest = sink.finish(made, filter)
    return Summary(
        output=None if output is None else str(output),
        messages=sum(fed),
        seconds=time.perf_counter() - started,
        ledger=ledger_json(filter.ledger),
        final=estimate_json(filter.plan, filter.estimate),
        sha256=digest,
        smoothed="smoothed" in made,
        losses=list(log.losses),
        followed=commanded.followed,
        passed_over=commanded.passed_over,
    )


class _Sink:
    """Encodes, hashes and writes tracks in a thread of its own, in order, so that the filter need not wait."""

    def __init__(self, plan: Plan, output: str | Path | None) -> None:
        self._plan = plan
        self._outputs = Outputs(plan)
        self._writer = None if output is None else TrackWriter(output, self._outputs)
        self._digest = hashlib.sha256()
        self._thread = ThreadPoolExecutor(1, "tracks")
        self._under_way: deque[Future[None]] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.shutdown(cancel_futures=True)
        if self._writer is not None:
            self._writer.__exit__(kind, error, trace)

    def take(self, track: Track, beside: Beside) -> None:
        """Hand over the next rows; waits while too much is under way. Raises what writing earlier ones raised."""
        self._under_way.append(self._thread.submit(lambda: self._put(self._outputs.encode(track, beside))))
        while len(self._under_way) > _UNDER_WAY:
            self._under_way.popleft().result()

    def finish(self, made: dict[str, str], filter: Filter) -> str:
        """Write what is left, and how it was made; returns the hash of the estimates."""
        while self._under_way:
            self._under_way.popleft().result()
        self._put(self._outputs.finish())
        if self._writer is not None:
            self._writer.describe(self._plan, made, filter.intake.datum)
        return self._digest.hexdigest()

    def _put(self, encoded: Messages) -> None:
        self._digest.update(self._outputs.estimates(encoded).data)
        if self._writer is not None:
            self._writer.write(encoded)


def stream_of(channel: Channel) -> Stream:
    """A channel of a log as the fusion takes it."""
    return Stream(
        topic=channel.topic,
        encoding=channel.encoding,
        schema_name=channel.schema.name,
        schema_encoding=channel.schema.encoding,
        schema_text=schema_to_text(channel.schema.encoding, channel.schema.data),
    )


def open_inputs(log: Log, filter: Filter) -> set[str]:
    """Connect the log's channels, but for outputs of an earlier run, to the filter; returns the topics that it uses.

    Nor does one ``as_received`` get what the service that recorded the log had no room for.
    Raises ``ConfigError`` for a topic that is not there, or whose messages cannot feed the sensor, and for topics that
    capture names.
    """
    require_none(filter.plan)
    inputs = [channel for channel in log.channels.values() if not is_output(channel)]
    if filter.order == "as_received":
        inputs = [channel for channel in inputs if not was_turned_away(channel)]
    filter.intake.require({channel.topic: None for channel in inputs})
    return {channel.topic for channel in inputs if filter.intake.open(channel.id, stream_of(channel))}
