"""What was answered about filters a moment ago, for who asks the same: many who watch cost little more than one."""

import time
from collections.abc import Callable

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fuselog.service.rest.guard import READING
from fuselog.service.rest.shown import FRESH_S

_ABOUT, _NOW = "/api/v1/filters", "/state"  # a state is as new as it can be
_GOOD = (200, 304)
_MOST_BYTES = 1 << 24  # of all that is kept


class Recent:
    """Keeps what the application answers to a GET for ``FRESH_S``, and not over a request that may change something."""

    def __init__(self, app: ASGIApp, clock: Callable[[], float] = time.monotonic) -> None:
        self._app, self._clock = app, clock
        self._forget()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        if scope["type"] != "http" or not scope["path"].startswith(_ABOUT):
            await self._app(scope, receive, send)
        elif scope["method"] == "GET" and not scope["path"].endswith(_NOW):
            await self._answer(scope, receive, send)
        else:
            try:
                await self._app(scope, receive, send)
            finally:
                if scope["method"] not in READING:
                    self._forget()

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        if self._clock() - self._since >= FRESH_S:
            self._forget()
        kept, made = self._kept, list[Message]()
        asked = scope["raw_path"], scope["query_string"], Headers(scope=scope).get("if-none-match")

        async def send_and_keep(message: Message) -> None:
            made.append(_copy(message))
            await send(message)

        if asked in kept:
            for message in kept[asked]:
                await send(_copy(message))
            return
        await self._app(scope, receive, send_and_keep)
        if len(made) == 2 and made[0].get("status") in _GOOD:  # in one piece
            self._bytes += len(made[1].get("body", b""))
            if self._bytes <= _MOST_BYTES:
                kept[asked] = made

    def _forget(self) -> None:
        self._kept: dict[tuple[bytes, bytes, str | None], list[Message]] = {}
        self._bytes, self._since = 0, self._clock()


def _copy(message: Message) -> Message:
    """With headers of its own, as others are added to them."""
    return {**message, "headers": [*message["headers"]]} if "headers" in message else {**message}
