"""The live service: a filter on Zenoh and its health over HTTP, from start to an orderly end."""

import threading
from collections.abc import Callable
from socket import socket

from fuselog.fusion import Plan
from fuselog.service.live.live_filter import LiveFilter, check_topics
from fuselog.service.live.one_filter import OneFilter
from fuselog.service.rest.app import create_app
from fuselog.service.rest.http import HttpServer, allowed_hosts, bind, read_access, tls_context
from fuselog.service.threads import Worker, WorkerError
from fuselog.service.transport import open_session, service_endpoints

_CONNECT_S = 10.0
_HTTP_S = 5.0  # for answers under way at the end


def serve(
    plan: Plan,
    *,
    stop: threading.Event,
    started: Callable[[str], None],
    behind_proxy: bool = False,
    snapshot: threading.Event | None = None,
) -> None:
    """Run until ``stop`` is set, then fuse and publish what has come so far.

    ``started`` is called with the address for HTTP when all is compiled and connected. ``snapshot``, when set, asks
    for one of the recording. ``behind_proxy``: HTTP comes from a proxy that has TLS. Raises ``ConfigError``,
    ``TransportError`` or ``HttpError`` when it cannot start, ``WorkerError`` when a part of it fails.
    """
    http = plan.config.http
    check_topics(plan)
    access = read_access(http, plan.source, behind_proxy=behind_proxy)
    tls = tls_context(http.tls, plan.source)
    snapshot = snapshot or threading.Event()
    with bind(http.host, http.port) as listener:
        served = OneFilter(snapshot)
        filters = served.filters  # empty until ready
        app = create_app(
            served,
            alive=lambda: all(live.alive for live in filters.values()),
            ready=lambda: bool(filters) and not stop.is_set(),
            access=access,
            hosts=allowed_hosts(http),
            streams=http.streams,
        )
        server = HttpServer(app, listener, tls=tls)
        answering = Worker("HTTP server", server.run, stop.set)
        try:
            with open_session(service_endpoints(plan.config.zenoh), timeout_s=_CONNECT_S) as session:
                filters[plan.config.id] = live = LiveFilter(plan, session, ended=stop.set, snapshot=snapshot)
                started(_address(listener, "https" if tls else "http"))
                stop.wait()
                live.finish()
        finally:
            server.stop()
            answering.join(_HTTP_S)
        if answering.error is not None:
            raise WorkerError(answering) from answering.error


def _address(listener: socket, scheme: str) -> str:
    host, port = listener.getsockname()[:2]
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"
