"""The live service: a filter on Zenoh and its health over HTTP, from start to an orderly end."""

import threading
from collections.abc import Callable
from socket import socket

from fuselog.fusion import Plan
from fuselog.service.live.live_filter import LiveFilter, check_topics
from fuselog.service.rest.api import LOOPBACK, Look, create_app
from fuselog.service.rest.http import HttpServer, bind, is_loopback, refuse_exposure
from fuselog.service.threads import Worker, WorkerError
from fuselog.service.transport import open_session, service_endpoints

_CONNECT_S = 10.0
_HTTP_S = 5.0  # for answers under way at the end


def serve(
    plan: Plan,
    *,
    stop: threading.Event,
    started: Callable[[str], None],
    expose_http: bool = False,
    snapshot: threading.Event | None = None,
) -> None:
    """Run until ``stop`` is set, then fuse and publish what has come so far.

    ``started`` is called with the address for HTTP when all is compiled and connected. ``snapshot``, when set, asks
    for one of the recording. Raises ``ConfigError``,
    ``TransportError`` or ``HttpError`` when it cannot start, ``WorkerError`` when a part of it fails.
    """
    http = plan.config.http
    check_topics(plan)
    if not expose_http:
        refuse_exposure(http.host, plan.source)
    with bind(http.host, http.port) as listener:
        filters: dict[str, LiveFilter] = {}  # empty until ready
        looks: dict[str, Look] = {}
        app = create_app(
            looks,
            alive=lambda: all(live.alive for live in filters.values()),
            ready=lambda: bool(filters) and not stop.is_set(),
            hosts=LOOPBACK if is_loopback(http.host) else None,
        )
        server = HttpServer(app, listener)
        answering = Worker("HTTP server", server.run, stop.set)
        try:
            with open_session(service_endpoints(plan.config.zenoh, plan.source), timeout_s=_CONNECT_S) as session:
                live = LiveFilter(plan, session, ended=stop.set, snapshot=snapshot)
                looks[plan.config.id], filters[plan.config.id] = live.snapshot, live
                started(_address(listener))
                stop.wait()
                live.finish()
        finally:
            server.stop()
            answering.join(_HTTP_S)
        if answering.error is not None:
            raise WorkerError(answering) from answering.error


def _address(listener: socket) -> str:
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
