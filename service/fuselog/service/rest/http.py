"""The HTTP server: an application on a socket that is bound before anything else starts."""

import asyncio
import ipaddress
import os
import socket
import ssl
from collections.abc import Mapping
from pathlib import Path

import uvicorn
from fastapi import FastAPI

from fuselog.fusion.config import Problem, Source
from fuselog.fusion.config.settings import HttpSettings, HttpTlsSettings
from fuselog.schemas import FuselogError
from fuselog.service.rest.auth import Access, Token, check_private, read_tokens
from fuselog.service.rest.guard import LOOPBACK
from fuselog.service.rest.protocol import LimitedProtocol

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


def read_access(
    http: HttpSettings, source: Source, *, behind_proxy: bool, environment: Mapping[str, str] = os.environ
) -> Access:
    """Who may do what. Reading is open to this machine, unless there is a token of role read, or a proxy.

    Raises ``ConfigError`` for an address that others can reach without tokens, or without TLS and no proxy that has
    it; and for a file of tokens that is not right.
    """
    tokens = read_tokens(source, http.tokens, environment)
    local = is_loopback(http.host)
    reason = _exposure(http, tokens, local=local, behind_proxy=behind_proxy)
    if reason:
        raise source.complain([Problem(("http", "host"), reason)])
    reading = any(token.role == "read" for token in tokens)
    return Access(tokens, open=local and not behind_proxy and not reading)


def _exposure(http: HttpSettings, tokens: tuple[Token, ...], *, local: bool, behind_proxy: bool) -> str | None:
    """Why the address must not be listened on, None when it may be."""
    tokenless = "needs tokens: http.tokens, or FUSELOG_TOKEN_READ and FUSELOG_TOKEN_CONTROL; `fuselog token` makes them"
    if not local and not tokens:
        return f"{http.host} can be reached by others, which {tokenless}"
    if behind_proxy and not tokens:
        return f"what a proxy passes on can come from anyone, which {tokenless}"
    if not local and http.tls is None and not behind_proxy:
        reason = "can be reached by others, which needs http.tls, or --behind-proxy where a proxy in front has TLS"
        return f"{http.host} {reason}"
    return None


def allowed_hosts(http: HttpSettings) -> frozenset[str] | None:
    """The names that requests may be for; None for any, which tokens protect."""
    if not http.hosts and not is_loopback(http.host):
        return None
    return frozenset((*LOOPBACK, *(host.lower() for host in http.hosts)))


def tls_context(tls: HttpTlsSettings | None, source: Source) -> ssl.SSLContext | None:
    """What HTTPS needs; raises ``ConfigError`` for files that cannot be used."""
    if tls is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    _load_certificate(context, tls, source)
    return context


def _load_certificate(context: ssl.SSLContext, tls: HttpTlsSettings, source: Source) -> None:
    folder = Path(source.name).parent
    certificate, key = folder / tls.certificate, folder / tls.key
    reason = check_private(key)
    if reason:
        raise source.complain([Problem(("http", "tls", "key"), reason)])
    try:
        context.load_cert_chain(certificate, key, password="")  # never asks at the terminal
    except (OSError, ValueError) as error:
        reason = f"{certificate} and {key} are no certificate and its key: {error}"
        raise source.complain([Problem(("http", "tls", "certificate"), reason)]) from error


class Entrance:
    """Who gets in at an address, and by which certificate: both from files, which can be read again in use."""

    def __init__(self, http: HttpSettings, source: Source, *, behind_proxy: bool) -> None:
        """Raises ``ConfigError`` as ``read_access`` and ``tls_context`` do."""
        self._http, self._source, self._behind_proxy = http, source, behind_proxy
        self.access = read_access(http, source, behind_proxy=behind_proxy)
        self.tls = tls_context(http.tls, source)
        self._certificate = b"" if http.tls is None else (Path(source.name).parent / http.tls.certificate).read_bytes()

    def read_again(self) -> "Entrance":
        """The same from the files as they are now; raises ``ConfigError``."""
        return Entrance(self._http, self._source, behind_proxy=self._behind_proxy)

    def become(self, fresh: "Entrance") -> list[str]:
        """Take what was read again, for requests and connections to come; what is other, in words."""
        done: list[str] = []
        if fresh.access != self.access:
            self.access.become(fresh.access)
            done.append("the tokens are those of now")
        if self.tls is not None and self._http.tls is not None and fresh._certificate != self._certificate:
            _load_certificate(self.tls, self._http.tls, self._source)
            self._certificate = fresh._certificate
            done.append("the certificate is that of now")
        return done


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
    """Serves an application of ``create_app`` on a bound socket until ``stop``."""

    def __init__(self, app: FastAPI, listener: socket.socket, *, tls: ssl.SSLContext | None = None) -> None:
        self._app, self._listener = app, listener
        config = uvicorn.Config(
            app,
            log_config=None,
            log_level="error",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            lifespan="off",
            timeout_graceful_shutdown=1,
            h11_max_incomplete_event_size=_MOST_HEADER_BYTES,
            http=LimitedProtocol,
            ws="none",
        )
        config.load()
        config.ssl = tls
        self._server = uvicorn.Server(config)

    def run(self) -> None:
        """Serve; returns after ``stop``."""
        asyncio.run(self._run())

    async def _run(self) -> None:
        beating = asyncio.create_task(self._app.state.pulse.beat())
        await self._server.serve(sockets=[self._listener])
        beating.cancel()

    def stop(self) -> None:
        """Let ``run`` end."""
        self._app.state.streams.closing = True
        self._server.should_exit = True
