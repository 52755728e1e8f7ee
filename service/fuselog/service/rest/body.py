"""The body of a request, read within limits of size, time, depth and type before anything looks at it."""

import asyncio
from typing import Any

import orjson
from starlette.datastructures import Headers
from starlette.types import Receive

from fuselog.service.rest.problems import Refused

MOST_BYTES = 1 << 20
MOST_DEPTH = 32
WITHIN_S = 10.0


class ClientGone(Exception):  # noqa: N818  not an error
    """Nobody waits for an answer any more."""


async def read_body(headers: Headers, receive: Receive) -> bytes:
    """The whole body of a request that has JSON or nothing; raises ``Refused`` (400, 408, 413, 415)."""
    if _length(headers) > MOST_BYTES:
        raise _too_large()
    try:
        async with asyncio.timeout(WITHIN_S):
            body = await _collect(receive)
    except TimeoutError:
        raise Refused(408, f"the body did not come within {WITHIN_S:g} s", headers={"Connection": "close"}) from None
    if body:
        _check(headers.get("content-type", ""), body)
    return body


def _length(headers: Headers) -> int:
    try:
        return int(headers.get("content-length", "0"))
    except ValueError:
        raise Refused(400, "content-length is no number") from None


async def _collect(receive: Receive) -> bytes:
    parts: list[bytes] = []
    size = 0
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            raise ClientGone
        parts.append(message.get("body", b""))
        size += len(parts[-1])
        if size > MOST_BYTES:
            raise _too_large()
        if not message.get("more_body", False):
            return b"".join(parts)


def _too_large() -> Refused:
    return Refused(413, f"the body is larger than {MOST_BYTES} bytes", headers={"Connection": "close"})


def _check(content_type: str, body: bytes) -> None:
    if content_type.partition(";")[0].strip().lower() != "application/json":
        raise Refused(415, "the body must be application/json", headers={"Accept": "application/json"})
    try:
        value = orjson.loads(body)
    except orjson.JSONDecodeError:
        raise Refused(400, "the body is not JSON") from None
    if _deeper(value, MOST_DEPTH):
        raise Refused(400, f"the body is nested deeper than {MOST_DEPTH}")


def _deeper(value: Any, most: int) -> bool:
    """Whether there are containers in containers more often than ``most`` times; level by level, without recursion."""
    level = [value]
    for _ in range(most):
        level = [each for node in level for each in _within(node)]
        if not level:
            return False
    return any(isinstance(each, dict | list) for each in level)


def _within(node: Any) -> Any:
    return node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()  # pyright: ignore[reportUnknownVariableType]  plain data
