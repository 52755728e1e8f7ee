"""Streams and the sensors that they feed: how messages of one become samples of the other."""

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import Problem
from fuselog.fusion.events import Decision, Events
from fuselog.fusion.intake.bind import Binder, make_binder, without_noise
from fuselog.fusion.intake.learned import FieldCheck
from fuselog.fusion.intake.mounts import IDENTITY, Mount, configured_mount
from fuselog.fusion.intake.stream import Stream
from fuselog.fusion.plan import Plan, SensorPlan
from fuselog.fusion.plan.readings import sensor_parts
from fuselog.schemas import Codec, Fault, Messages, SchemaError

_FROM_FAULT = np.array([Decision.FUSED, Decision.INVALID_SIZE, Decision.INVALID_SCHEMA], np.uint8)

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Tap:
    """How one stream feeds one sensor."""

    stream: Stream
    codec: Codec
    binder: Binder
    stamped: bool  # whether the messages carry a stamp; the time of arrival stands in for one
    kind: bytes  # the same for taps that make the same of the same bytes, where the mount and origins are the same
    when: Codec | None = None  # of the number that is 0 in messages that are no samples

    def fill(self, events: Events, rows: Ints, messages: Messages, index: Ints, feed: "Feed", datum: Floats) -> None:
        """Decode and bind the messages at ``index`` into these blank rows of the events."""
        columns = self.codec.decode(messages.data, messages.start[index], messages.length[index])
        events.t_ns[rows] = columns.t_ns if self.stamped else messages.log_time[index]
        events.fault[rows] = _FROM_FAULT[columns.fault]
        self.binder.bind(columns.values, events, rows, feed.mount or IDENTITY, datum, feed.reference)


@dataclass(slots=True)
class Feed:
    """One sensor, the streams that feed it, and what it holds back until its mount is known."""

    sensor: SensorPlan
    mount: Mount | None
    taps: dict[int, Tap] = field(default_factory=dict[int, Tap])
    held: list[Messages] = field(default_factory=list[Messages])
    taken: int = 0  # messages that became events
    reference: float = math.nan  # Pa, once it is known
    field_check: FieldCheck | None = None

    @property
    def pending(self) -> int:
        """How many messages it holds back."""
        return sum(len(messages) for messages in self.held)


class Route(NamedTuple):
    """Where the messages of a stream go that can become events at once, whatever comes with them."""

    feed: Feed
    tap: Tap
    datum: Floats
    kind: bytes  # the same for routes of any filters that make the same of the same bytes

    def number(self) -> tuple[int, int]:
        """The sensor and the number of its next sample, which this makes it."""
        self.feed.taken += 1
        return self.feed.sensor.rank, self.feed.taken - 1

    def fill(self, events: Events, rows: Ints, messages: Messages, index: Ints) -> None:
        """Decode and bind the messages at ``index`` into these rows of the events."""
        self.tap.fill(events, rows, messages, index, self.feed, self.datum)


def make_feed(sensor: SensorPlan) -> Feed:
    """A sensor that nothing feeds yet."""
    settings = sensor.settings
    return Feed(
        sensor,
        configured_mount(settings),
        reference=math.nan if settings.reference == "first_sample" else settings.reference,
        field_check=None if settings.field is None else FieldCheck(settings.field),
    )


def make_tap(plan: Plan, sensor: SensorPlan, stream: Stream) -> Tap:
    """Decoder and binder of a stream for a sensor; every mismatch is a ``ConfigError`` at the sensor."""
    settings = sensor.settings

    def refuse(key: str, reason: str) -> Exception:
        return plan.source.complain([Problem(("sensors", sensor.name, key), reason)])

    if settings.type is not None and settings.type != stream.schema_name:
        raise refuse("type", f"{settings.topic} carries {stream.schema_name}, not {settings.type}")
    parts = sensor_parts(settings, sensor.names, stream.schema_name)
    if isinstance(parts, str):
        raise refuse("fuse", parts)
    bare = without_noise(sensor, parts)
    if bare:
        raise refuse("noise", f"{settings.topic} gives none for {', '.join(bare)}; say noise: {{{bare[0]}: sd}}")
    binder = make_binder(sensor, parts)
    try:
        stamp = settings.stamp or stream.stamp
        when = None if settings.when is None else stream.codec([settings.when])
        kind = _digest(replace(stream, topic=""), stamp, binder.fields, *binder.recipe)
        return Tap(stream, stream.codec(binder.fields, stamp), binder, stamp is not None, kind, when)
    except SchemaError as error:
        raise refuse("topic", str(error)) from error


def route(feed: Feed, tap: Tap, datum: Floats) -> Route | None:
    """The route from a stream to a sensor; None where what becomes of a message hangs on others still.

    ``datum``: of the local frame (3,), NaN while it is not known.
    """
    settings = feed.sensor.settings
    plain = settings.enabled and settings.when is None and feed.field_check is None
    placed = feed.mount is not None and not feed.held
    known = not (tap.binder.needs_datum and math.isnan(datum[0]))
    known &= not (tap.binder.needs_reference and math.isnan(feed.reference))
    if feed.mount is None or not (plain and placed and known):
        return None
    origins = datum if tap.binder.needs_datum else None, feed.reference if tap.binder.needs_reference else None
    return Route(feed, tap, datum, _digest(tap.kind, feed.mount.quaternion, *origins))


def samples_of(feed: Feed, messages: Messages, index: Ints) -> Ints:
    """Those of a sensor's messages that are samples: not the ones whose ``when`` is 0."""
    if feed.sensor.settings.when is None:
        return index
    kept = np.ones(len(index), bool)
    for number, tap in feed.taps.items():
        if tap.when is not None:
            mine = np.flatnonzero(messages.stream[index] == number)
            at = index[mine]
            columns = tap.when.decode(messages.data, messages.start[at], messages.length[at])
            kept[mine] = (columns.values[:, 0] != 0.0) | (columns.fault != Fault.NONE)
    return index[kept]


def carries(stream: NDArray[np.int32], numbers: Iterable[int]) -> NDArray[np.bool_]:
    """Which messages come from one of these few streams."""
    found: NDArray[np.bool_] | None = None
    for number in numbers:
        found = stream == number if found is None else found | (stream == number)
    return np.zeros(len(stream), bool) if found is None else found


def _digest(*values: object) -> bytes:
    """Sixteen bytes that differ where anything in the values does."""
    digest = hashlib.blake2b(digest_size=16)
    for value in values:
        if isinstance(value, np.ndarray):
            array = cast(NDArray[Any], value)
            digest.update(repr(array.shape).encode() + array.tobytes())
        else:
            digest.update(repr(value).encode())
    return digest.digest()
