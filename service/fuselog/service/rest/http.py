"""The HTTP server: an application on a socket that is bound before anything else starts."""

import asyncio
import ipaddress
import socket

import uvicorn
from fastapi import FastAPI

from fuselog.fusion.config import Problem, Source
from fuselog.schemas import FuselogError

_MOST_CONNECTIONS = 64
_MOST_HEADER_BYTES = 16_384


class HttpError(FuselogError):
    """The address for HTTP cannot be used."""

    def __init__(self, host: str, port: int, reason: str) -> None:
        super().__init__(f"http://{host}:{port}: {reason}")


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach the host."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def refuse_exposure(host: str, source: Source) -> None:
    """Raise ``ConfigError`` for a host that others can reach: nothing here asks who they are."""
    if not is_loopback(host):
        reason = f"{host} can be reached by others, and there is no authentication; use 127.0.0.1, or say --expose-http"
        raise source.complain([Problem(("http", "host"), reason)])


def bind(host: str, port: int) -> socket.socket:
    """A listening socket; raises ``HttpError`` when the address is taken or not ours."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen(128)
        except OSError:
            listener.close()
            raise
    except OSError as error:
        raise HttpError(host, port, (error.strerror or str(error)).lower()) from error
    return listener


class HttpServer:
    """Serves an application on a bound socket until ``stop``."""

    def __init__(self, app: FastAPI, listener: socket.socket) -> None:
        self._listener = listener
        self._server = uvicorn.Server(
            uvicorn.Config(
                app,
                log_config=None,
                access_log=False,
                server_header=False,
                lifespan="off",
                limit_concurrency=_MOST_CONNECTIONS,
                timeout_graceful_shutdown=1,
                h11_max_incomplete_event_size=_MOST_HEADER_BYTES,
                http="h11",
                ws="none",
            )
        )

    def run(self) -> None:
        """Serve; returns after ``stop``."""
        asyncio.run(self._server.serve(sockets=[self._listener]))

    def stop(self) -> None:
        """Let ``run`` end."""
        self._server.should_exit = True
