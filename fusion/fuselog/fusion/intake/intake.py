"""Raw messages in, events out: every sensor decoded and bound, in the order of arrival."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import Problem, did_you_mean
from fuselog.fusion.events import Decision, Events, blank_events, join
from fuselog.fusion.intake.bind import Binder, make_binder, without_noise
from fuselog.fusion.intake.learned import FieldCheck
from fuselog.fusion.intake.mounts import (
    IDENTITY,
    Mount,
    StaticTransforms,
    check_transforms,
    configured_mount,
    load_mount,
)
from fuselog.fusion.intake.stream import Stream, load_messages, own_messages, same_topic, save_messages
from fuselog.fusion.kept import take_into, take_whole
from fuselog.fusion.plan import Plan, SensorPlan
from fuselog.fusion.plan.readings import PARTS, Shape, sensor_parts
from fuselog.fusion.sealed import Tree
from fuselog.schemas import Codec, Fault, Messages, SchemaError

TF_STATIC = "/tf_static"
_FROM_FAULT = np.array([Decision.FUSED, Decision.INVALID_SIZE, Decision.INVALID_SCHEMA], np.uint8)

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Tap:
    """How one stream feeds one sensor."""

    stream: Stream
    codec: Codec
    binder: Binder
    stamped: bool  # whether the messages carry a stamp; the time of arrival stands in for one
    when: Codec | None = None  # of the number that is 0 in messages that are no samples


@dataclass(slots=True)
class _Feed:
    """One sensor, the streams that feed it, and what it holds back until its mount is known."""

    sensor: SensorPlan
    mount: Mount | None
    taps: dict[int, _Tap] = field(default_factory=dict[int, _Tap])
    held: list[Messages] = field(default_factory=list[Messages])
    taken: int = 0  # messages that became events
    reference: float = math.nan  # Pa, once it is known
    field_check: FieldCheck | None = None

    @property
    def pending(self) -> int:
        return sum(len(messages) for messages in self.held)


class Taken(NamedTuple):
    """What a batch of messages gave: events in arrival order, and the lever arm (m) of each sensor placed by it."""

    events: Events
    levers: dict[int, Floats]


class Intake:
    """Turns batches of raw messages into events.

    A sensor whose mount is to come from /tf_static holds its samples back until then; they count as pending, and
    stand in the arrival order where the transform arrived. How the input is cut into batches makes no difference.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._feeds = [_feed(sensor) for sensor in plan.sensors]
        self._transforms = StaticTransforms()
        self._tf_streams: dict[int, Stream] = {}
        self._datum = _configured_datum(plan)

    @property
    def topics(self) -> list[str]:
        """The topics that the configuration names, and the static transforms when a mount comes from them."""
        topics = [feed.sensor.settings.topic for feed in self._feeds]
        waits = any(feed.sensor.settings.mount == "from_tf" for feed in self._feeds)
        return list(dict.fromkeys([*topics, *([TF_STATIC] if waits else [])]))

    @property
    def datum(self) -> Floats | None:
        """Latitude, longitude (deg) and altitude (m) of the local frame's origin, once it is known."""
        return None if np.isnan(self._datum[0]) else self._datum

    @property
    def received(self) -> list[int]:
        """How many messages each sensor got."""
        return [feed.taken + feed.pending for feed in self._feeds]

    @property
    def pending(self) -> list[int]:
        """How many messages of each sensor wait for its mount."""
        return [feed.pending for feed in self._feeds]

    def require(self, available: Mapping[str, object]) -> None:
        """Raise ``ConfigError`` for every sensor whose topic is not among ``available``."""
        names = {same_topic(topic) for topic in available}
        missing = [
            Problem(
                ("sensors", feed.sensor.name, "topic"),
                f"no topic {topic!r} there{did_you_mean(topic, available)}",
            )
            for feed in self._feeds
            if same_topic(topic := feed.sensor.settings.topic) not in names
        ]
        if missing:
            raise self._plan.source.complain(missing)

    @property
    def streams(self) -> dict[int, Stream]:
        """The streams that are open and used, by number."""
        taps = [(number, tap.stream) for feed in self._feeds for number, tap in feed.taps.items()]
        return dict(sorted([*taps, *self._tf_streams.items()], key=lambda each: each[0]))

    def configure(self, plan: Plan) -> None:
        """Go on with a plan of the same sensors; raises ``ConfigError``, and stays as it is, for one that cannot be."""
        bound = [
            {number: self._tap(sensor, tap.stream) for number, tap in feed.taps.items()}
            for feed, sensor in zip(self._feeds, plan.sensors, strict=True)
        ]
        for feed, sensor, taps in zip(self._feeds, plan.sensors, bound, strict=True):
            feed.sensor, feed.taps = sensor, taps
        self._plan = plan

    def save(self) -> Tree:
        """What ``load`` takes."""
        feeds = [
            {
                "taken": feed.taken,
                "mount": None if feed.mount is None else feed.mount.save(),
                "held": [save_messages(own_messages(held, np.arange(len(held)))) for held in feed.held],
                "reference": np.array([feed.reference]),
                "field": None if feed.field_check is None else feed.field_check.save(),
            }
            for feed in self._feeds
        ]
        return {
            "streams": [{"number": number, **asdict(stream)} for number, stream in self.streams.items()],
            "feeds": feeds,
            "transforms": self._transforms.save(),
            "datum": self._datum,
        }

    def load(self, tree: Tree) -> None:
        """Become what an intake with the same plan was, its streams open under their numbers.

        Raises ``ValueError``, ``LookupError``, or what ``open`` does, where that cannot be.
        """
        self._feeds = [_feed(sensor) for sensor in self._plan.sensors]
        self._tf_streams.clear()
        for each in tree["streams"]:
            description = dict(each)
            self.open(take_whole(description.pop("number")), Stream(**description))
        for feed, kept in zip(self._feeds, tree["feeds"], strict=True):
            feed.taken = take_whole(kept["taken"])
            feed.mount = None if kept["mount"] is None else load_mount(kept["mount"])
            feed.held = [load_messages(each) for each in kept["held"]]
            feed.reference = float(kept["reference"][0])
            if feed.field_check is not None:
                feed.field_check.load(kept["field"])
        self._transforms.load(tree["transforms"])
        self._datum = np.empty(3)
        take_into(self._datum, tree["datum"])

    def open(self, number: int, stream: Stream) -> bool:
        """Prepare for a stream; False when nothing uses it.

        Raises ``ConfigError`` when a sensor cannot use it, ``SchemaError`` for static transforms of another type.
        """
        topic = same_topic(stream.topic)
        fed = [feed for feed in self._feeds if same_topic(feed.sensor.settings.topic) == topic]
        taps = [self._tap(feed.sensor, stream) for feed in fed]
        for feed, tap in zip(fed, taps, strict=True):
            feed.taps[number] = tap
        if topic == same_topic(TF_STATIC):
            check_transforms(stream)
            self._tf_streams[number] = stream
        return bool(fed) or number in self._tf_streams

    def take(self, messages: Messages) -> Taken:
        """The events of a batch."""
        self._learn_datum(messages)
        self._learn_references(messages)
        levers: dict[int, Floats] = {}
        parts: list[Events] = []
        for index in self._between_transforms(messages):
            for feed in self._feeds:
                if feed.mount is None and self._place(feed, messages, index):
                    levers[feed.sensor.rank] = (feed.mount or IDENTITY).lever
            parts.append(self._segment(messages, index))
        return Taken(join(parts), levers)

    def _between_transforms(self, messages: Messages) -> Iterator[Ints]:
        """The messages cut into runs, so that static transforms change at the start of a run only."""
        if not self._tf_streams:
            yield np.arange(len(messages))
            return
        told = np.flatnonzero(_carries(messages.stream, self._tf_streams))
        for first, last in zip([0, *told], [*told, len(messages)], strict=True):
            if first in told:
                at = np.array([first])
                stream = self._tf_streams[int(messages.stream[first])]
                self._transforms.learn(stream, messages.data, messages.start[at], messages.length[at])
            yield np.arange(first, last)

    def _segment(self, messages: Messages, index: Ints) -> Events:
        """The events of a run, what was held back first, then by arrival and rank."""
        batches = [(feed, *batch) for feed in self._feeds for batch in self._ready(feed, messages, index)]
        sizes = [len(places) for _, _, _, places in batches]
        events = blank_events(sum(sizes), self._plan.tables.M)
        row, first = np.arange(events.size), 0
        if len(batches) > 1:
            rank = np.repeat([feed.sensor.rank for feed, *_ in batches], sizes)
            row[np.lexsort((rank, np.concatenate([places for *_, places in batches])))] = np.arange(len(row))
        for (feed, source, chosen, _), size in zip(batches, sizes, strict=True):
            self._fill(events, row[first : first + size], feed, source, chosen)
            first += size
        return events

    def _ready(self, feed: _Feed, messages: Messages, index: Ints) -> list[tuple[Messages, Ints, Ints]]:
        """What a sensor can give now: messages, which of them, and their places in the order of arrival."""
        mine = _samples(feed, messages, index[_carries(messages.stream[index], feed.taps)])
        if feed.mount is None:
            feed.held += [own_messages(messages, mine)] if len(mine) else []
            return []
        held = [(batch, np.arange(len(batch)), np.full(len(batch), -1)) for batch in feed.held]
        feed.held.clear()
        return [*held, (messages, mine, mine)] if len(mine) else held

    def _fill(self, events: Events, rows: Ints, feed: _Feed, messages: Messages, index: Ints) -> None:
        """Decode and bind the messages at ``index``, in their order, into these rows of the events."""
        events.sensor[rows] = feed.sensor.rank
        events.seq[rows] = feed.taken + np.arange(len(rows))
        events.arrival_ns[rows] = messages.log_time[index]
        feed.taken += len(rows)
        for number, tap in feed.taps.items():
            mine = np.flatnonzero(messages.stream[index] == number)
            if len(mine) == 0:
                continue
            chosen, at = index[mine], rows[mine]
            columns = tap.codec.decode(messages.data, messages.start[chosen], messages.length[chosen])
            events.t_ns[at] = columns.t_ns if tap.stamped else messages.log_time[chosen]
            events.fault[at] = _FROM_FAULT[columns.fault]
            tap.binder.bind(columns.values, events, at, feed.mount or IDENTITY, self._datum, feed.reference)
        if not feed.sensor.settings.enabled:
            events.fault[rows] = Decision.DISABLED
        elif feed.field_check is not None:
            feed.field_check.mark(events, rows)

    def _tap(self, sensor: SensorPlan, stream: Stream) -> _Tap:
        """Decoder and binder of a stream for a sensor; every mismatch is a ``ConfigError`` at the sensor."""
        settings = sensor.settings

        def refuse(key: str, reason: str) -> Exception:
            return self._plan.source.complain([Problem(("sensors", sensor.name, key), reason)])

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
            return _Tap(stream, stream.codec(binder.fields, stamp), binder, stamp is not None, when)
        except SchemaError as error:
            raise refuse("topic", str(error)) from error

    def _place(self, feed: _Feed, messages: Messages, index: Ints) -> bool:
        """Find the mount of a sensor that waits for it, as soon as its frame and the transforms are known."""
        frame, base = feed.sensor.settings.frame, self._plan.config.output.child
        source = feed.held[0] if feed.held else messages
        mine = np.arange(1) if feed.held else index[_carries(messages.stream[index], feed.taps)][:1]
        if frame is None and len(mine):
            frame = _frame(feed.taps[int(source.stream[mine[0]])].stream, source, mine)
        feed.mount = None if frame is None else self._transforms.find(base, frame)
        return feed.mount is not None

    def _learn_datum(self, messages: Messages) -> None:
        """The first usable fix of any GNSS sensor becomes the origin, when the configuration gives none."""
        if self.datum is not None:
            return
        first = len(messages)
        enabled = [feed for feed in self._feeds if feed.sensor.settings.enabled]
        for number, tap in ((n, t) for feed in enabled for n, t in feed.taps.items() if t.binder.needs_datum):
            part = next(part for part in PARTS[tap.stream.schema_name] if part.shape == Shape.GEODETIC)
            fields = [*part.fields, *([part.status] if part.status is not None else [])]
            at, values = _first(tap.stream, fields, messages, number, lambda v: (v[:, 3:] >= 0).all(axis=1))
            if at < first:
                first, self._datum = at, values[:3]

    def _learn_references(self, messages: Messages) -> None:
        """The first usable pressure of each barometer is where its height is 0, when the configuration gives none."""
        for feed in self._feeds:
            first = len(messages)
            unknown = math.isnan(feed.reference) and feed.sensor.settings.enabled
            for number, tap in feed.taps.items() if unknown else ():
                if tap.binder.needs_reference:
                    path = tap.binder.fields[:1]
                    at, values = _first(tap.stream, path, messages, number, lambda v: (v > 0).all(axis=1))
                    if at < first:
                        first, feed.reference = at, float(values[0])


def _feed(sensor: SensorPlan) -> _Feed:
    settings = sensor.settings
    return _Feed(
        sensor,
        configured_mount(settings),
        reference=math.nan if settings.reference == "first_sample" else settings.reference,
        field_check=None if settings.field is None else FieldCheck(settings.field),
    )


def _first(
    stream: Stream, fields: Sequence[str], messages: Messages, number: int, usable: Callable[[Floats], Any]
) -> tuple[int, Floats]:
    """The first message of a stream whose fields are finite and usable, and their values; else (how many, none)."""
    index = np.flatnonzero(messages.stream == number)
    columns = stream.codec(fields).decode(messages.data, messages.start[index], messages.length[index])
    good = np.isfinite(columns.values).all(axis=1) & usable(columns.values) & (columns.fault == Fault.NONE)
    found = np.flatnonzero(good)[:1]
    return (int(index[found[0]]), columns.values[found[0]].copy()) if len(found) else (len(messages), np.empty(0))


def _samples(feed: _Feed, messages: Messages, index: Ints) -> Ints:
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


def _carries(stream: NDArray[np.int32], numbers: Iterable[int]) -> NDArray[np.bool_]:
    """Which messages come from one of these few streams."""
    found = np.zeros(len(stream), bool)
    for number in numbers:
        found |= stream == number
    return found


def _configured_datum(plan: Plan) -> Floats:
    given = [s.settings.datum for s in plan.sensors if s.settings.datum != "first_fix"]
    return np.array(given[0] if given else (np.nan, np.nan, np.nan))


def _frame(stream: Stream, messages: Messages, index: Ints) -> str | None:
    """The frame that a message says it is in."""
    if "header.frame_id" not in stream.fields:
        return None
    columns = stream.codec(["header.frame_id"]).decode(messages.data, messages.start[index], messages.length[index])
    return columns.texts["header.frame_id"][0] or None
