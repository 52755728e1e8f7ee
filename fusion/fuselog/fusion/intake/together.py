"""Batches of many filters decoded and bound as one: a step for all of them in place of a step for each."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fuselog.fusion.events import Events, blank_events
from fuselog.fusion.intake.feeds import Route
from fuselog.fusion.intake.intake import Intake
from fuselog.schemas import Messages


class _Alike(NamedTuple):
    """Messages of which the same is made: where they are, and the rows of the events for them."""

    route: Route
    at: list[int]
    rows: list[int]


def can_take(intake: Intake, streams: Sequence[int]) -> bool:
    """Whether messages of these streams can be taken with those of other filters."""
    routes = intake.routes
    return all(number in routes for number in streams)


def take_together(
    intakes: Sequence[Intake], messages: Messages, streams: Sequence[int], spans: Sequence[slice], width: int
) -> tuple[Events, list[slice]]:
    """``Intake.take`` of the messages in ``spans[i]`` by intake i, which can take all of them.

    Returns the events of all, and which are those of each. ``streams``: of all messages; ``width``: M of the filters.
    """
    alike: dict[bytes, _Alike] = {}
    source: list[int] = []
    numbers: list[tuple[int, int]] = []
    mine: list[slice] = []
    for intake, span in zip(intakes, spans, strict=True):
        routes, first = intake.routes, len(source)
        for at in range(span.start, span.stop):
            for route in routes[streams[at]]:
                group = alike.get(route.kind)
                if group is None:
                    group = alike[route.kind] = _Alike(route, [], [])
                group.at.append(at)
                group.rows.append(len(source))
                source.append(at)
                numbers.append(route.number())
        mine.append(slice(first, len(source)))
    events = blank_events(len(source), width)
    if source:
        events.sensor[:], events.seq[:] = np.array(numbers, np.int64).T
        events.arrival_ns[:] = messages.log_time[source]
    for route, chosen, rows in alike.values():
        route.fill(events, np.array(rows), messages, np.array(chosen))
    return events, mine
