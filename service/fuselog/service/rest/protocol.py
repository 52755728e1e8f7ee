"""HTTP/1.1 on one connection, with limits in time and memory that the server itself does not have."""

import asyncio
import json
import math
import socket
import time
from typing import cast

import h11
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from fuselog.service.rest.problems import PROBLEM_TYPE
from fuselog.service.rest.traffic import Traffic

REQUEST_S = 12.0  # for all of a request, from its first byte or from the beginning of the connection
UNREAD_S = 5.0  # without a client taking anything of what waits for it
MOST_WAITING_BYTES = 65_536  # that wait for a client before the next answer does
MOST_CONNECTIONS = 512
_WAITS_FOR_CLIENT = (h11.IDLE, h11.SEND_BODY)


class LimitedProtocol(H11Protocol):
    """A client that sends its request slowly, or does not read its answer, loses its connection; both are counted.

    When there are too many connections, the oldest that still sends its request makes room, else the new one goes.
    """

    _since = 0.0
    _sending: asyncio.TimerHandle | None = None
    _reading: asyncio.TimerHandle | None = None

    @property
    def _traffic(self) -> Traffic:
        app = self.config.app
        assert isinstance(app, FastAPI)
        return app.state.traffic

    @property
    def sending_since(self) -> float:
        """When the connection began, if its request is incomplete; else never."""
        return math.inf if self._sending is None else self._since

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]  as its base
        """Set the limits."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=MOST_WAITING_BYTES)
        wire: socket.socket | None = transport.get_extra_info("socket")
        if wire is not None:
            wire.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, MOST_WAITING_BYTES)
        self._since = time.monotonic()
        self._sending = self.loop.call_later(REQUEST_S, self._too_slow)
        if len(self.connections) > MOST_CONNECTIONS:
            self._make_room()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the timers."""
        self._sending, self._reading = _cancel(self._sending), _cancel(self._reading)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Time runs while a request is incomplete."""
        super().data_received(data)
        if self.conn.their_state not in _WAITS_FOR_CLIENT:
            self._sending = _cancel(self._sending)
        elif self._sending is None and not self.transport.is_closing():
            self._sending = self.loop.call_later(REQUEST_S, self._too_slow)

    def pause_writing(self) -> None:
        """More waits for the client than may."""
        super().pause_writing()
        self._reading = self._reading or self.loop.call_later(UNREAD_S, self._unread)

    def resume_writing(self) -> None:
        """The client reads again."""
        self._reading = _cancel(self._reading)
        super().resume_writing()

    def send_400_response(self, msg: str) -> None:
        """What is no HTTP, or has headers of more than the limit."""
        self._end(400, "Bad Request", "not HTTP/1.1, or headers that are too large")
        del msg

    def _too_slow(self) -> None:
        self._traffic.slow += 1
        if not self.cycle or self.cycle.response_complete:  # it is None before the first request
            self._end(408, "Request Timeout", f"the request did not come within {REQUEST_S:g} s")
        else:
            self.transport.abort()

    def _unread(self) -> None:
        self._traffic.unread += 1
        self.transport.abort()

    def _make_room(self) -> None:
        self._traffic.crowded += 1
        oldest = self
        for each in self.connections:
            other = cast(LimitedProtocol, each)  # there are no others on this server
            oldest = other if other.sending_since < oldest.sending_since else oldest
        oldest.transport.abort()

    def _end(self, status: int, title: str, detail: str) -> None:
        """The last answer of a connection, which is a problem too."""
        body = json.dumps({"type": "about:blank", "title": title, "status": status, "detail": detail}).encode()
        head = f"HTTP/1.1 {status} {title}\r\nContent-Type: {PROBLEM_TYPE}\r\nContent-Length: {len(body)}\r\n"
        self._traffic.answered[status] += 1
        self.transport.write(head.encode() + b"Connection: close\r\n\r\n" + body)
        self.transport.close()


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
