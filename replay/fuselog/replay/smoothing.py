"""Fixed-interval smoothing of a log in bounded memory: forth, back, and out again, by stacks on disk.

The forward pass puts every segment aside with the engine's snapshot before it. The backward pass takes the segments
last to first, runs each again, goes back over it, and puts the smoothed rows aside; these then come out in order.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from fuselog.fusion import Events, Filter, FixedInterval, Plan, Snapshot, Track, with_optimal_gain
from fuselog.fusion.events import join
from fuselog.fusion.kernel.tables import History
from fuselog.fusion.preparation import Prepared
from fuselog.replay.stack import Array, Stack

SEGMENT = 1024  # events; what the backward pass has in memory

_ESTIMATE = ("x", "P")  # kept of the rows that have one
_COLUMNS = [field.name for field in fields(Track) if field.name not in ("states", "sensors", *_ESTIMATE)]

Report = Callable[[float], None]  # takes the share that is done


def smoothing_plan(plan: Plan) -> Plan:
    """The plan of the forward pass: the optimal gain, and nothing beside it."""
    output = plan.config.output.model_copy(update={"ticks": None, "settled": False})
    config = plan.config.model_copy(update={"smooth": None, "output": output})
    return with_optimal_gain(replace(plan, config=config))


def smoothed(
    batches: Iterable[Prepared],
    filter: Filter,
    *,
    rate: float | None = None,
    spill: Path | None = None,
    report: Report | None = None,
    segment: int = SEGMENT,
) -> Iterator[Track]:
    """The smoothed track in its order, a segment at a time; P is NaN in a row of which no state is known.

    ``batches`` are prepared by the filter, which is ``by_stamp`` with a ``smoothing_plan``, and not applied. With
    ``rate`` (Hz) only the estimates that ``Outputs`` publishes are made, the others are NaN. Raises ``SpillError``.
    """
    with Stack(spill) as segments, Stack(spill) as rows:
        for taken in _segments(_to_the_end(batches, filter), segment):
            if taken.events.size:
                segments.push(_arrays(filter.snapshot(), taken.events))
            filter.apply(taken)
        count, passes = len(segments), FixedInterval(filter.plan, rate=rate)
        while len(segments):
            rows.push(_columns(passes.back(*_segment(segments.pop()))))
            if report is not None:
                report(1.0 - len(segments) / count)
        while len(rows):
            yield _track(rows.pop(), filter.plan)


def _to_the_end(batches: Iterable[Prepared], filter: Filter) -> Iterator[Prepared]:
    yield from batches
    yield filter.rest()


def _segments(batches: Iterable[Prepared], size: int) -> Iterator[Prepared]:
    """The same events in pieces of ``size``; a sensor is placed between two of them, by a piece without events."""
    held: list[Events] = []
    for taken in batches:
        if taken.levers:
            yield from (Prepared(events, {}) for events in held)
            held = []
            yield taken._replace(events=taken.events.take(slice(0, 0)))
        held.append(taken.events)
        if sum(events.size for events in held) >= size:
            events, whole = join(held), sum(events.size for events in held) // size * size
            yield from (Prepared(events.take(slice(first, first + size)), {}) for first in range(0, whole, size))
            held = [events.take(slice(whole, None))]
    if held:
        yield Prepared(join(held), {})


def _arrays(snapshot: Snapshot, events: Events) -> list[Array]:
    return [*snapshot.history[1:], snapshot.sensor, *events]


def _segment(arrays: list[Array]) -> tuple[Snapshot, Events]:
    columns = len(History._fields) - 1
    history = History(len(arrays[History._fields.index("t") - 1]), *arrays[:columns])
    return Snapshot(history, arrays[columns]), Events._make(arrays[columns + 1 :])


def _columns(track: Track) -> list[Array]:
    """A track as arrays, without the estimates of which nothing is known."""
    kept = np.flatnonzero(~np.isnan(track.x).all(axis=1))
    return [kept, *(getattr(track, name)[kept] for name in _ESTIMATE), *(getattr(track, name) for name in _COLUMNS)]


def _track(arrays: list[Array], plan: Plan) -> Track:
    kept, *estimates = arrays[: 1 + len(_ESTIMATE)]
    columns = dict(zip(_COLUMNS, arrays[1 + len(_ESTIMATE) :], strict=True))
    for name, values in zip(_ESTIMATE, estimates, strict=True):
        columns[name] = np.full((len(columns["t_ns"]), values.shape[1]), np.nan)
        columns[name][kept] = values
    return Track(states=plan.states, sensors=tuple(sensor.name for sensor in plan.sensors), **columns)
