"""A log through a filter, as fast as the machine allows: tracks out, and an output log when asked for."""

import contextlib
import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuselog.fusion import Filter, Order, Outputs, Plan, Stream, Track, join_tracks
from fuselog.fusion.report import estimate_json, ledger_json
from fuselog.replay.channels import Channel
from fuselog.replay.log import Log, open_log
from fuselog.replay.loss import Loss
from fuselog.replay.tracks import TrackWriter, is_output

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
    losses: list[Loss]

    @property
    def lossy(self) -> bool:
        """Whether anything of the log could not be read."""
        return bool(self.losses)

    def to_json(self) -> dict[str, Any]:
        """The summary as plain data."""
        losses = [{"offset": loss.offset, "reason": loss.reason, "messages": loss.messages} for loss in self.losses]
        return {
            "schema": 1,
            "output": self.output,
            "messages": self.messages,
            "seconds": round(self.seconds, 6),
            "ledger": self.ledger,
            "final": self.final,
            "sha256": self.sha256,
            "losses": losses,
        }


def reprocess(log: Log | str | Path, plan: Plan, *, order: Order | None = None) -> Track:
    """The whole track of a log, in memory. Raises ``LogError`` and ``ConfigError``."""
    if not isinstance(log, Log):
        with open_log(log) as opened:
            return reprocess(opened, plan, order=order)
    return join_tracks([track for _, track in run(log, Filter(plan, order=order or plan.config.lag.order))])


def run(log: Log, filter: Filter) -> Iterator[tuple[int, Track]]:
    """Feed a log to a filter, a chunk at a time; yields (messages fed, rows), the held rows at the end."""
    for messages in log.batches(open_inputs(log, filter)):
        for first in range(0, len(messages), _BATCH):
            batch = messages.take(slice(first, first + _BATCH))
            yield len(batch), filter.feed(batch)
    yield 0, filter.finish()


def reprocess_to(
    log: Log, plan: Plan, output: str | Path | None, *, order: Order | None = None, advance: Advance | None = None
) -> Summary:
    """Run a log through a filter and write its tracks as an MCAP log; memory is bounded by a chunk of either."""
    started = time.perf_counter()
    order = order or plan.config.lag.order
    filter, outputs, digest, messages = Filter(plan, order=order), Outputs(plan), hashlib.sha256(), 0
    first, last = log.time_range or (0, 0)
    with contextlib.ExitStack() as stack:
        writer = None if output is None else stack.enter_context(TrackWriter(output, outputs))
        for fed, track in run(log, filter):
            messages += fed
            encoded = outputs.encode(track)
            digest.update(outputs.estimates(encoded).data)
            if writer is not None:
                writer.write(encoded)
            if advance is not None and len(track):
                advance(float(track.arrival_ns[-1] - first), float(max(last - first, 1)))
        if writer is not None:
            writer.describe(plan, order, filter.intake.datum)
    return Summary(
        output=None if output is None else str(output),
        messages=messages,
        seconds=time.perf_counter() - started,
        ledger=ledger_json(filter.ledger),
        final=estimate_json(plan, filter.estimate),
        sha256=digest.hexdigest(),
        losses=list(log.losses),
    )


def stream_of(channel: Channel) -> Stream:
    """A channel of a log as the fusion takes it."""
    return Stream(
        topic=channel.topic,
        encoding=channel.encoding,
        schema_name=channel.schema.name,
        schema_encoding=channel.schema.encoding,
        schema_text=channel.schema.data.decode(errors="replace"),
    )


def open_inputs(log: Log, filter: Filter) -> set[str]:
    """Connect the log's channels, but for outputs of an earlier run, to the filter; returns the topics that it uses.

    Raises ``ConfigError`` for a topic that is not there, or whose messages cannot feed the sensor.
    """
    inputs = [channel for channel in log.channels.values() if not is_output(channel)]
    filter.intake.require({channel.topic: None for channel in inputs})
    return {channel.topic for channel in inputs if filter.intake.open(channel.id, stream_of(channel))}
