"""The process for HTTP: ``python -m fuselog.service.front.process LISTENER CHANNEL``, two file descriptors."""

import os
import signal
import socket
import sys
import threading
from contextlib import suppress
from multiprocessing.connection import Connection

from fuselog.schemas import FuselogError
from fuselog.service.front.channel import Channel, Serving, Setup
from fuselog.service.front.mirror import Mirror
from fuselog.service.page.page import add_page
from fuselog.service.rest.app import create_app
from fuselog.service.rest.audit import audit_to_stderr
from fuselog.service.rest.http import Entrance, HttpServer, allowed_hosts

_NICE = 10  # below the filters, where both want a processor
_END_S = 5.0  # for answers under way at the end
_NOT_OURS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1)  # the other process says what is to be done


def main() -> None:
    """Serve until told to stop, or until the other process is gone."""
    for number in _NOT_OURS:
        signal.signal(number, signal.SIG_IGN)
    with suppress(OSError):
        os.nice(_NICE)
    listener, channel = socket.socket(fileno=int(sys.argv[1])), Channel(Connection(int(sys.argv[2])))
    with suppress(EOFError, OSError):
        setup = channel.receive()
        assert isinstance(setup, Setup)
        serve(listener, channel, setup)
    os._exit(0)  # whatever still waits for an answer that will not come


def serve(listener: socket.socket, channel: Channel, setup: Setup) -> None:
    """Raises ``EOFError`` or ``OSError`` when the other process has ended."""
    if setup.audited:
        audit_to_stderr()
    entrance = Entrance(setup.http, setup.source, behind_proxy=setup.behind_proxy)
    mirror = Mirror(channel)
    app = create_app(
        mirror,
        alive=lambda: mirror.alive,
        ready=lambda: mirror.ready,
        access=entrance.access,
        hosts=allowed_hosts(setup.http),
        streams=setup.http.streams,
        page=add_page,
        current=lambda: mirror.current,
        process=os.getppid(),
    )
    server, ending = HttpServer(app, listener, tls=entrance.tls), threading.Event()

    def run() -> None:
        try:
            server.run()
        except Exception as error:
            print(f"the HTTP server failed: {error!r}", file=sys.stderr, flush=True)
        if not ending.is_set():
            os._exit(1)

    def renew() -> None:
        with suppress(FuselogError):  # files that were right a moment ago, and are not now
            entrance.become(entrance.read_again())

    answering = threading.Thread(target=run, name="HTTP server", daemon=True)

    def begin() -> None:
        answering.start()
        channel.send(Serving())

    mirror.follow(begin=begin, renew=renew)
    ending.set()
    server.stop()
    if answering.is_alive():
        answering.join(_END_S)


if __name__ == "__main__":
    main()
