"""Raw messages in, events out: every sensor decoded and bound, in the order of arrival."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.config import Problem, did_you_mean
from fuselog.fusion.events import Decision, Events, blank_events, join
from fuselog.fusion.intake.feeds import Feed, Floats, Ints, Route, carries, make_feed, make_tap, route, samples_of
from fuselog.fusion.intake.mounts import (
    IDENTITY,
    StaticTransforms,
    check_transforms,
    load_mount,
)
from fuselog.fusion.intake.stream import Stream, load_messages, own_messages, same_topic, save_messages
from fuselog.fusion.kept import take_into, take_whole
from fuselog.fusion.plan import Plan
from fuselog.fusion.plan.readings import PARTS, Shape
from fuselog.fusion.sealed import Tree
from fuselog.schemas import Fault, Messages

TF_STATIC = "/tf_static"
_FEW = 256  # messages whose streams it pays to look at first


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
        self._routes: dict[int, tuple[Route, ...]] | None = None  # until something changes
        self._feeds = [make_feed(sensor) for sensor in plan.sensors]
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

    @property
    def routes(self) -> Mapping[int, tuple[Route, ...]]:
        """By stream, in the order of the ranks: where its messages go, where that depends on nothing that is to come.

        A stream that is not there needs ``take``.
        """
        if self._routes is None:
            found: dict[int, list[Route | None]] = {number: [None] for number in self._tf_streams}
            for feed in self._feeds:
                for number, tap in feed.taps.items():
                    found.setdefault(number, []).append(route(feed, tap, self._datum))
            whole = {number: [each for each in routes if each is not None] for number, routes in found.items()}
            self._routes = {number: tuple(each) for number, each in whole.items() if len(each) == len(found[number])}
        return self._routes

    def configure(self, plan: Plan) -> None:
        """Go on with a plan of the same sensors; raises ``ConfigError``, and stays as it is, for one that cannot be."""
        bound = [
            {number: make_tap(self._plan, sensor, tap.stream) for number, tap in feed.taps.items()}
            for feed, sensor in zip(self._feeds, plan.sensors, strict=True)
        ]
        for feed, sensor, taps in zip(self._feeds, plan.sensors, bound, strict=True):
            feed.sensor, feed.taps = sensor, taps
        self._plan, self._routes = plan, None

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
        self._feeds, self._routes = [make_feed(sensor) for sensor in self._plan.sensors], None
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
        taps = [make_tap(self._plan, feed.sensor, stream) for feed in fed]
        for feed, tap in zip(fed, taps, strict=True):
            feed.taps[number] = tap
        self._routes = None
        if topic == same_topic(TF_STATIC):
            check_transforms(stream)
            self._tf_streams[number] = stream
        return bool(fed) or number in self._tf_streams

    def take(self, messages: Messages) -> Taken:
        """The events of a batch."""
        self._routes = None
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
        told = np.flatnonzero(carries(messages.stream, self._tf_streams))
        for first, last in zip([0, *told], [*told, len(messages)], strict=True):
            if first in told:
                at = np.array([first])
                stream = self._tf_streams[int(messages.stream[first])]
                self._transforms.learn(stream, messages.data, messages.start[at], messages.length[at])
            yield np.arange(first, last)

    def _segment(self, messages: Messages, index: Ints) -> Events:
        """The events of a run, what was held back first, then by arrival and rank."""
        streams = messages.stream[index]
        there = set(streams.tolist()) if len(index) <= _FEW else None
        batches = [
            (feed, *batch)
            for feed in self._feeds
            if there is None or feed.held or not there.isdisjoint(feed.taps)
            for batch in self._ready(feed, messages, index, streams)
        ]
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

    def _ready(
        self, feed: Feed, messages: Messages, index: Ints, streams: NDArray[np.int32]
    ) -> list[tuple[Messages, Ints, Ints]]:
        """What a sensor can give now: messages, which of them, and their places in the order of arrival."""
        mine = samples_of(feed, messages, index[carries(streams, feed.taps)])
        if feed.mount is None:
            feed.held += [own_messages(messages, mine)] if len(mine) else []
            return []
        now = [(messages, mine, mine)] if len(mine) else []
        if not feed.held:
            return now
        held = [(batch, np.arange(len(batch)), np.full(len(batch), -1)) for batch in feed.held]
        feed.held.clear()
        return held + now

    def _fill(self, events: Events, rows: Ints, feed: Feed, messages: Messages, index: Ints) -> None:
        """Decode and bind the messages at ``index``, in their order, into these rows of the events."""
        events.sensor[rows] = feed.sensor.rank
        events.seq[rows] = feed.taken + np.arange(len(rows))
        events.arrival_ns[rows] = messages.log_time[index]
        feed.taken += len(rows)
        for number, tap in feed.taps.items():
            chosen, at = index, rows
            if len(feed.taps) > 1:
                mine = (messages.stream[index] == number).nonzero()[0]
                if len(mine) == 0:
                    continue
                chosen, at = index[mine], rows[mine]
            tap.fill(events, at, messages, chosen, feed, self._datum)
        if not feed.sensor.settings.enabled:
            events.fault[rows] = Decision.DISABLED
        elif feed.field_check is not None:
            feed.field_check.mark(events, rows)

    def _place(self, feed: Feed, messages: Messages, index: Ints) -> bool:
        """Find the mount of a sensor that waits for it, as soon as its frame and the transforms are known."""
        frame, base = feed.sensor.settings.frame, self._plan.config.output.child
        source = feed.held[0] if feed.held else messages
        mine = np.arange(1) if feed.held else index[carries(messages.stream[index], feed.taps)][:1]
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


def _first(
    stream: Stream, fields: Sequence[str], messages: Messages, number: int, usable: Callable[[Floats], Any]
) -> tuple[int, Floats]:
    """The first message of a stream whose fields are finite and usable, and their values; else (how many, none)."""
    index = np.flatnonzero(messages.stream == number)
    columns = stream.codec(fields).decode(messages.data, messages.start[index], messages.length[index])
    good = np.isfinite(columns.values).all(axis=1) & usable(columns.values) & (columns.fault == Fault.NONE)
    found = np.flatnonzero(good)[:1]
    return (int(index[found[0]]), columns.values[found[0]].copy()) if len(found) else (len(messages), np.empty(0))


def _configured_datum(plan: Plan) -> Floats:
    given = [s.settings.datum for s in plan.sensors if s.settings.datum != "first_fix"]
    return np.array(given[0] if given else (np.nan, np.nan, np.nan))


def _frame(stream: Stream, messages: Messages, index: Ints) -> str | None:
    """The frame that a message says it is in."""
    if "header.frame_id" not in stream.fields:
        return None
    columns = stream.codec(["header.frame_id"]).decode(messages.data, messages.start[index], messages.length[index])
    return columns.texts["header.frame_id"][0] or None
