"""The door to Zenoh: sessions as the configuration wants them, keys from topics, and errors in one line."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import zenoh

from fuselog.fusion.config.settings import ZenohSettings
from fuselog.fusion.intake import same_topic
from fuselog.schemas import FuselogError
from fuselog.service.zenoh_door import configuration

_SOURCE_PLACE = re.compile(r"\s*at /\S+\.rs:\d+\.?")


class TransportError(FuselogError):
    """Zenoh cannot do what was asked: no connection, an address in use, a peer that went away."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoints:
    """Where a session listens and connects, and in which role."""

    mode: str = "peer"
    listen: Sequence[str] = field(default_factory=list[str])
    connect: Sequence[str] = field(default_factory=list[str])
    multicast: bool = False


def service_endpoints(settings: ZenohSettings) -> Endpoints:
    """Where the service meets others."""
    listen = settings.listen if settings.mode == "peer" else []
    return Endpoints(mode=settings.mode, listen=listen, connect=settings.connect, multicast=settings.multicast)


def visitor_endpoints(settings: ZenohSettings) -> Endpoints:
    """Where a program meets the service that has these settings: where it listens, or at the same router."""
    if settings.mode == "peer":
        return Endpoints(mode="peer", connect=settings.listen, multicast=settings.multicast)
    return Endpoints(mode="client", connect=settings.connect, multicast=settings.multicast)


def open_session(at: Endpoints, *, timeout_s: float) -> zenoh.Session:
    """Open a session, connected when it is to connect; raises ``TransportError`` after ``timeout_s``."""
    values = {
        "mode": at.mode,
        "listen/endpoints": list(at.listen),
        "connect/endpoints": list(at.connect),
        "connect/timeout_ms": round(timeout_s * 1000),
        "connect/exit_on_failure": True,  # a peer would open silently unconnected
        "scouting/multicast/enabled": at.multicast,
        "scouting/gossip/enabled": False,
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
    text = _SOURCE_PLACE.sub("", str(error)).strip()
    if "Unable to connect" in text:
        return f"nobody answers at {', '.join(at.connect)}: is `fuselog serve` or a Zenoh router running there?"
    if "Address already in use" in text:
        return f"{', '.join(at.listen)}: address already in use; is another service running? (zenoh: listen)"
    return f"Zenoh: {text}"
