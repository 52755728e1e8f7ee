"""The door of the REST interface: host, token, body and number of requests, before any of them is looked at."""

from collections.abc import Collection, MutableMapping
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fuselog.service.rest.audit import Audit
from fuselog.service.rest.auth import Access, Token
from fuselog.service.rest.body import ClientGone, read_body
from fuselog.service.rest.problems import Refused, problem
from fuselog.service.rest.traffic import Traffic

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
PROBES = ("/health/live", "/health/ready", "/health/startup", "/healthz")
OPEN = ("/", "/openapi.json", *PROBES)  # nothing of a filter is in their answers
_OPEN_UNDER = "/page/"
READING = ("GET", "HEAD", "OPTIONS")
_MOST_ACTIVE = 64
_MOST_HEADER_BYTES = 16_384
_STREAM = "/api/v1/stream"
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


class Guard:
    """Lets a request through to the application when it is for this host, by somebody who may, and of sane size.

    ``hosts``: the names that it may be for, None for any. Probes are answered under any name: who watches a container
    asks for its address.
    """

    def __init__(self, app: ASGIApp, *, access: Access, hosts: Collection[str] | None, traffic: Traffic) -> None:
        self._app, self._access, self._hosts, self._traffic = app, access, hosts, traffic
        self._audit = Audit()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        visit = _Visit(scope, send, self._traffic)
        try:
            _check_headers(visit)
            self._check_host(visit)
            self._check_token(visit)
            if visit.method not in READING:
                visit.body = await read_body(visit.headers, receive)
                receive = _replay(visit.body, receive)
            await self._pass(visit, receive)
        except Refused as error:
            self._traffic.refused[str(error.status_code)] += 1
            answer = problem(error.status_code, error.detail, error.errors, error.headers)
            await answer(scope, receive, visit.send)
        except ClientGone:
            return None
        finally:
            self._write(visit)
        return None

    async def _pass(self, visit: "_Visit", receive: Receive) -> None:
        if visit.path == _STREAM:  # has a limit of its own
            return await self._app(visit.scope, receive, visit.send)
        if self._traffic.active >= _MOST_ACTIVE and visit.path not in PROBES:
            raise Refused(503, "too many requests at once", headers={"Retry-After": "1"})
        self._traffic.active += 1
        try:
            await self._app(visit.scope, receive, visit.send)
        finally:
            self._traffic.active -= 1

    def _check_host(self, visit: "_Visit") -> None:
        hosts = visit.headers.getlist("host")
        if self._hosts is None or visit.path in PROBES:
            return
        if len(hosts) != 1 or _without_port(hosts[0]) not in self._hosts:
            raise Refused(400, f"this service does not answer for host {', '.join(hosts)[:256]!r}")

    def _check_token(self, visit: "_Visit") -> None:
        if visit.path in OPEN or visit.path.startswith(_OPEN_UNDER):
            return
        given = visit.headers.getlist("authorization")
        if len(given) > 1:
            raise Refused(400, "more than one Authorization")
        visit.who = self._access.identify(given[0] if given else None)
        self._access.check(visit.who, change=visit.method not in READING)

    def _write(self, visit: "_Visit") -> None:
        if visit.method in READING or not visit.status:
            return
        self._audit.write(
            who=None if visit.who is None else visit.who.name,
            client=visit.client,
            method=visit.method,
            path=visit.path,
            status=visit.status,
            body=visit.body,
        )


def _check_headers(visit: "_Visit") -> None:
    """The server sees to headers that do not end; those that came in one piece are counted here."""
    size = sum(len(name) + len(value) + 4 for name, value in visit.headers.raw)
    if size + len(visit.scope.get("raw_path", b"")) + len(visit.scope.get("query_string", b"")) > _MOST_HEADER_BYTES:
        raise Refused(431, f"the headers are larger than {_MOST_HEADER_BYTES} bytes", headers={"Connection": "close"})


class _Visit:
    """A request on its way in, and the status on its way out."""

    def __init__(self, scope: Scope, send: Send, traffic: Traffic) -> None:
        self.scope, self.status, self.body = scope, 0, b""
        self.who: Token | None = None
        self.method: str = scope["method"]
        self.path: str = scope["path"]
        self.headers = Headers(scope=scope)
        self.client = scope["client"][0] if scope.get("client") else ""
        self._send, self._traffic = send, traffic

    async def send(self, message: Message) -> None:
        """The answer, with the headers that every one has."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            self._traffic.answered[self.status] += 1
            _complete(message)
        await self._send(message)


def _complete(message: MutableMapping[str, Any]) -> None:
    headers = MutableHeaders(scope=message)
    for name, value in _HEADERS.items():
        headers.setdefault(name, value)


def _replay(body: bytes, receive: Receive) -> Receive:
    """A ``receive`` that gives the body that was read, then what comes."""
    given = False

    async def again() -> Message:
        nonlocal given
        if given:
            return await receive()
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again


def _without_port(host: str) -> str:
    """``[::1]:8080`` is ``[::1]``, ``localhost:8080`` is ``localhost``."""
    if host.startswith("["):
        return host.partition("]")[0] + "]"
    return host.partition(":")[0].lower()
