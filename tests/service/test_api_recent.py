"""Answers that are kept for a moment: which, for how long, and what ends that."""

import asyncio

import pytest
from starlette.types import Message, Receive, Scope, Send

from fuselog.service.rest.recent import Recent
from fuselog.service.rest.shown import FRESH_S

HEALTH = "/api/v1/filters/r0/health"


class Counting:
    """An application that answers how often it was asked, and the time that it is given."""

    def __init__(self, status: int = 200, pieces: int = 1) -> None:
        self.now, self.asked, self._status, self._pieces = 100.0, 0, status, pieces
        self._recent = Recent(self._answer, clock=lambda: self.now)

    async def _answer(self, _scope: Scope, _receive: Receive, send: Send) -> None:
        self.asked += 1
        await send({"type": "http.response.start", "status": self._status, "headers": [(b"etag", b"one")]})
        for piece in range(self._pieces):
            more = piece + 1 < self._pieces
            await send({"type": "http.response.body", "body": str(self.asked).encode(), "more_body": more})

    def ask(self, path: str = HEALTH, *, method: str = "GET", query: bytes = b"", etag: bytes | None = None) -> str:
        """The body of the answer; what is done to its headers on the way out is not done to what is kept."""
        sent: list[Message] = []

        async def send(message: Message) -> None:
            sent.append(message)
            if "headers" in message:
                assert message["headers"] == [(b"etag", b"one")]
                message["headers"].append((b"x-frame-options", b"DENY"))

        async def receive() -> Message:
            raise AssertionError

        headers = [] if etag is None else [(b"if-none-match", etag)]
        scope = {"type": "http", "method": method, "path": path, "raw_path": path.encode(), "query_string": query}
        asyncio.run(self._recent({**scope, "headers": headers}, receive, send))
        return b"".join(message.get("body", b"") for message in sent).decode()


def test_who_asks_the_same_within_a_moment_is_told_the_same() -> None:
    app = Counting()
    assert [app.ask(), app.ask(), app.ask()] == ["1", "1", "1"]
    app.now += 0.9 * FRESH_S
    assert app.ask() == "1"
    app.now += 0.2 * FRESH_S
    assert [app.ask(), app.ask()] == ["2", "2"]


def test_another_question_has_its_own_answer() -> None:
    app = Counting()
    assert app.ask() == "1"
    assert app.ask("/api/v1/filters/r1/health") == "2"
    assert app.ask(query=b"t=1") == "3"
    assert app.ask(etag=b'W/"one"') == "4"
    assert [app.ask(), app.ask(query=b"t=1"), app.ask(etag=b'W/"one"')] == ["1", "3", "4"]


@pytest.mark.parametrize("method", ["PUT", "POST", "DELETE"])
def test_nothing_is_kept_over_a_change(method: str) -> None:
    app = Counting()
    assert app.ask() == "1"
    app.ask(method=method)
    assert app.ask() == "3"


def test_a_look_at_the_headers_changes_nothing() -> None:
    app = Counting()
    assert app.ask() == "1"
    assert app.ask(method="HEAD") == "2"
    assert app.ask() == "1"


@pytest.mark.parametrize("status", [404, 409, 503])
def test_what_went_wrong_is_looked_at_anew(status: int) -> None:
    app = Counting(status)
    assert [app.ask(), app.ask()] == ["1", "2"]


def test_no_states_and_only_answers_about_filters_that_come_in_one_piece() -> None:
    app = Counting(pieces=2)
    assert [app.ask(), app.ask()] == ["11", "22"]
    app = Counting()
    assert [app.ask("/api/v1/filters/r0/state"), app.ask("/api/v1/filters/r0/state")] == ["1", "2"]
    app = Counting()
    assert [app.ask("/metrics"), app.ask("/metrics"), app.ask("/health/ready")] == ["1", "2", "3"]
