"""Health and state of all filters, told again and again: server-sent events for pages and tools that watch."""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Annotated, Any

from fastapi import FastAPI, Query
from sse_starlette import EventSourceResponse
from starlette.types import Receive, Scope, Send

from fuselog.service.rest.problems import Refused, documented
from fuselog.service.rest.shown import Shown
from fuselog.service.rest.traffic import Traffic

_HEARTBEAT_S = 10  # of comments, where events are rarer
_LOOK_S = 0.25  # how soon a stream notices that the server ends
_EVENTS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "Events `health`, for ever. Their data is JSON: `t` (ns), and `filters`, by id: `model`, "
        "`states`, `health` and `state` as their resources say, and `changes` of the health.",
        "content": {"text/event-stream": {"schema": {"type": "string"}}},
    }
}


class Streams:
    """All clients of the stream. The next event is made when the last was taken: for a slow client nothing is kept.

    A client that does not read at all is dropped by the connection's own rule, see ``protocol``.
    """

    def __init__(self, shown: Shown, traffic: Traffic, *, current: Callable[[], bool], most: int) -> None:
        self.closing = False
        self._shown, self._traffic, self._current, self._most = shown, traffic, current, most

    def open(self, rate: float) -> EventSourceResponse:
        """A stream for one more client; raises ``Refused`` (503) when there are enough."""
        if self._traffic.streams >= self._most or self.closing:
            raise Refused(503, f"{self._traffic.streams} clients watch already", headers={"Retry-After": "10"})
        self._traffic.streams += 1
        return _Stream(self._events(1 / rate), self._release)

    def _release(self) -> None:
        self._traffic.streams -= 1

    async def _events(self, period_s: float) -> AsyncIterator[bytes]:
        clock = asyncio.get_running_loop().time
        due = clock()
        while not self.closing:
            if self._current():
                yield b"event: health\r\ndata: " + self._shown.told() + b"\r\n\r\n"
            due = max(due + period_s, clock())
            while not self.closing and (left := due - clock()) > 0:
                await asyncio.sleep(min(left, _LOOK_S))


class _Stream(EventSourceResponse):
    """A response that says when it is over."""

    def __init__(self, events: AsyncIterator[bytes], release: Callable[[], None]) -> None:
        super().__init__(events, ping=_HEARTBEAT_S)  # pyright: ignore[reportUnknownMemberType]  a dict of anything
        self._release = release

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._release()


def add_stream(app: FastAPI, streams: Streams) -> None:
    """The stream of all filters."""

    @app.get(
        "/api/v1/stream",
        tags=["filters"],
        operation_id="stream",
        response_class=EventSourceResponse,
        responses={**_EVENTS, **documented(503)},
    )
    async def stream(  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        rate: Annotated[float, Query(ge=0.1, le=10, description="Hz: events in a second")] = 1.0,
    ) -> EventSourceResponse:
        """Health and state of all filters, at a rate."""
        return streams.open(rate)
