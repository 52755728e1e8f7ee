"""The live service: filters on Zenoh and their health over HTTP, from start to an orderly end."""

import gc
import sys
import threading
from collections.abc import Callable, Sequence
from socket import socket

from fuselog.fusion import Plan
from fuselog.fusion.config import Problem
from fuselog.schemas import FuselogError
from fuselog.service.front.channel import Setup
from fuselog.service.front.front import Front
from fuselog.service.live.fleet import Fleet
from fuselog.service.live.group import make_group
from fuselog.service.live.standby import Standby
from fuselog.service.rest.audit import audited
from fuselog.service.rest.http import Entrance, bind
from fuselog.service.threads import WorkerError
from fuselog.service.transport import open_session, service_endpoints

_CONNECT_S = 10.0
_TEND_S = 1.0  # at most between two looks at what may wait for a disk
_SWITCH_S = 0.0005  # a thread of the network waits for the interpreter as long as this where another computes
_SHARED = ("zenoh", "http")  # what a service has once: said in the first configuration


def serve(
    plans: Sequence[Plan],
    *,
    stop: threading.Event,
    started: Callable[[str], None],
    behind_proxy: bool = False,
    snapshot: threading.Event | None = None,
    reload: threading.Event | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> None:
    """Run the filters of ``plans`` until ``stop`` is set, then fuse and publish what has come so far.

    ``started`` is called with the address for HTTP when all is compiled and connected. ``snapshot``, when set, asks
    for one of the recordings, ``reload`` to read the configurations again; ``say`` tells what came of it.
    ``behind_proxy``: HTTP comes from a proxy that has TLS. Raises ``ConfigError``,
    ``TransportError`` or ``HttpError`` when it cannot start, ``WorkerError`` when a part of it fails.
    """
    sys.setswitchinterval(_SWITCH_S)
    first = plans[0]
    http = first.config.http
    _check_shared(plans)
    groups = [make_group(plan) for plan in plans]
    entrance = Entrance(http, first.source, behind_proxy=behind_proxy)
    with bind(http.host, http.port) as listener:
        served = Standby(entrance)
        front = Front(
            served,
            listener,
            Setup(http, first.source, behind_proxy=behind_proxy, audited=audited()),
            alive=lambda: served.alive,
            ready=lambda: served.ready and not stop.is_set(),
            say=say,
            ended=stop.set,
        )
        served.renew = front.renew
        try:
            with open_session(service_endpoints(first.config.zenoh, first.source), timeout_s=_CONNECT_S) as session:
                fleet = Fleet(groups, session, ended=stop.set, snapshot=snapshot, shown=front.soon)
                served.fleet = fleet
                gc.freeze()  # walking all that is loaded would hold up samples for a tenth of a second
                if front.wait():
                    started(_address(listener, "http" if entrance.tls is None else "https"))
                every_s = _tend_every_s(plans)
                while not stop.wait(every_s):
                    fleet.tend()
                    if reload is not None and reload.is_set():
                        reload.clear()
                        say("; ".join(_reloaded(served)))
                fleet.finish()
        finally:
            front.finish()
        if front.worker.error is not None:
            raise WorkerError(front.worker) from front.worker.error


def _reloaded(served: Standby) -> list[str]:
    """What reading the configurations again did, or why it did nothing."""
    try:
        return served.reload()
    except FuselogError as error:
        return [f"not reloaded: {error}"]


def _tend_every_s(plans: Sequence[Plan]) -> float:
    """A checkpoint is to be made as often as its filter wants it."""
    wanted = [plan.config.checkpoint.every for plan in plans if plan.config.checkpoint is not None]
    return min([_TEND_S, *wanted])


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


def _address(listener: socket, scheme: str) -> str:
    host, port = listener.getsockname()[:2]
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"
