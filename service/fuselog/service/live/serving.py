"""The live service: filters on Zenoh and their health over HTTP, from start to an orderly end."""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from socket import socket

from fuselog.fusion import Plan
from fuselog.fusion.config import Problem
from fuselog.service.live.fleet import Fleet
from fuselog.service.live.group import make_group
from fuselog.service.live.member import Snapshot
from fuselog.service.rest.api import LOOPBACK, Look, create_app
from fuselog.service.rest.http import HttpServer, bind, is_loopback, refuse_exposure
from fuselog.service.threads import Worker, WorkerError
from fuselog.service.transport import open_session, service_endpoints

_CONNECT_S = 10.0
_HTTP_S = 5.0  # for answers under way at the end
_TEND_S = 1.0
_SHARED = ("zenoh", "http")  # what a service has once: said in the first configuration


def serve(
    plans: Sequence[Plan],
    *,
    stop: threading.Event,
    started: Callable[[str], None],
    expose_http: bool = False,
    snapshot: threading.Event | None = None,
) -> None:
    """Run the filters of ``plans`` until ``stop`` is set, then fuse and publish what has come so far.

    ``started`` is called with the address for HTTP when all is compiled and connected. ``snapshot``, when set, asks
    for one of the recordings. Raises ``ConfigError``, ``TransportError`` or ``HttpError`` when it cannot start,
    ``WorkerError`` when a part of it fails.
    """
    first = plans[0]
    http = first.config.http
    _check_shared(plans)
    groups = [make_group(plan) for plan in plans]
    if not expose_http:
        refuse_exposure(http.host, first.source)
    with bind(http.host, http.port) as listener:
        fleets: list[Fleet] = []  # empty until ready
        app = create_app(
            _Looks(fleets),
            alive=lambda: all(fleet.alive for fleet in fleets),
            ready=lambda: bool(fleets) and not stop.is_set(),
            hosts=LOOPBACK if is_loopback(http.host) else None,
        )
        server = HttpServer(app, listener)
        answering = Worker("HTTP server", server.run, stop.set)
        try:
            with open_session(service_endpoints(first.config.zenoh, first.source), timeout_s=_CONNECT_S) as session:
                fleet = Fleet(groups, session, ended=stop.set, snapshot=snapshot)
                fleets.append(fleet)
                started(_address(listener))
                while not stop.wait(_TEND_S):
                    fleet.tend()
                fleet.finish()
        finally:
            server.stop()
            answering.join(_HTTP_S)
        if answering.error is not None:
            raise WorkerError(answering) from answering.error


class _Looks(Mapping[str, Look]):
    """The filters as they come and go."""

    def __init__(self, fleets: Sequence[Fleet]) -> None:
        self._fleets = fleets

    def _all(self) -> Mapping[str, Snapshot]:
        return {id: snapshot for fleet in self._fleets for id, snapshot in fleet.snapshots().items()}

    def __getitem__(self, id: str) -> Look:
        return partial(self._all().__getitem__, id)

    def __contains__(self, id: object) -> bool:
        return id in self._all()

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())


def _check_shared(plans: Sequence[Plan]) -> None:
    """Raise ``ConfigError`` where configurations of one service contradict each other."""
    seen: set[str] = set()
    for plan in plans:
        first, mine = plans[0].config, plan.config
        other = [
            name for name in _SHARED if name in mine.model_fields_set and getattr(mine, name) != getattr(first, name)
        ]
        problems = [Problem((name,), f"a service has one; {plans[0].source.name} says another") for name in other]
        if plan.config.id in seen:
            problems.append(Problem(("id",), f"another configuration of the service is called {plan.config.id!r}"))
        seen.add(plan.config.id)
        if problems:
            raise plan.source.complain(problems)


def _address(listener: socket) -> str:
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
