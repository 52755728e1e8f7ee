"""The door to Zenoh: sessions as the configuration wants them, keys from topics, and errors in one line."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import zenoh

from fuselog.fusion.config import Source
from fuselog.fusion.config.settings import ZenohSettings
from fuselog.fusion.intake import same_topic
from fuselog.schemas import FuselogError
from fuselog.service.refusals import why_refused
from fuselog.service.security import security
from fuselog.service.zenoh_door import configuration, reason_of

_RETRY = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}  # of a connection that broke


class TransportError(FuselogError):
    """Zenoh cannot do what was asked: no connection, an address in use, a peer that went away."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoints:
    """Where a session listens and connects, in which role, and how it is secured.

    ``options`` are other values of Zenoh's configuration by path; secrets among them, so they are never shown.
    """

    mode: str = "peer"
    listen: Sequence[str] = field(default_factory=list[str])
    connect: Sequence[str] = field(default_factory=list[str])
    multicast: bool = False
    options: Mapping[str, Any] = field(default_factory=dict[str, Any], repr=False)


def service_endpoints(settings: ZenohSettings, source: Source) -> Endpoints:
    """Where the service meets others; raises ``ConfigError`` for files that ``settings`` names and that will not do."""
    listen = settings.listen if settings.mode == "peer" else []
    options = security(settings, source, serves=True)
    return Endpoints(
        mode=settings.mode, listen=listen, connect=settings.connect, multicast=settings.multicast, options=options
    )


def visitor_endpoints(settings: ZenohSettings, source: Source) -> Endpoints:
    """Where a program meets the service that has these settings: where it listens, or at the same router.

    It shows the same certificate and user as the service would. Raises ``ConfigError`` as ``service_endpoints`` does.
    """
    options = security(settings, source, serves=False)
    if settings.mode == "peer":
        return Endpoints(mode="peer", connect=settings.listen, multicast=settings.multicast, options=options)
    return Endpoints(mode="client", connect=settings.connect, multicast=settings.multicast, options=options)


def open_session(at: Endpoints, *, timeout_s: float) -> zenoh.Session:
    """Open a session, connected when it is to connect; raises ``TransportError`` after ``timeout_s``."""
    values = {
        "mode": at.mode,
        "listen/endpoints": list(at.listen),
        "connect/endpoints": list(at.connect),
        "connect/timeout_ms": round(timeout_s * 1000),
        "connect/exit_on_failure": True,  # a peer would open silently unconnected
        "connect/retry": _RETRY,
        "scouting/multicast/enabled": at.multicast,
        "scouting/gossip/enabled": False,
        **at.options,
    }
    try:
        return zenoh.open(configuration({path: json.dumps(value) for path, value in values.items()}))
    except zenoh.ZError as error:
        raise TransportError(_in_one_line(error, at)) from error


def key_of(topic: str) -> str:
    """The Zenoh key of a topic; raises ``TransportError`` where there can be none."""
    key = same_topic(topic)
    try:
        plain = str(zenoh.KeyExpr(key))
    except zenoh.ZError as error:
        raise TransportError(f"topic {topic!r} cannot be a Zenoh key") from error
    if "*" in plain:
        raise TransportError(f"topic {topic!r} names many keys; a topic is one")
    return plain


def _in_one_line(error: zenoh.ZError, at: Endpoints) -> str:
    text = reason_of(error)
    if "Unable to connect" in text:
        return "; ".join(why_refused(endpoint, at.options) for endpoint in at.connect)
    if "Address already in use" in text:
        return f"{', '.join(at.listen)}: address already in use; is another service running? (zenoh: listen)"
    return f"Zenoh: {text}"
