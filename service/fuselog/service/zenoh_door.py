"""The one typed door to Zenoh's objects: its stubs leave out what methods return, and call a status a bool."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from collections.abc import Callable
from typing import Protocol, cast

import zenoh


class _Matching(Protocol):
    matching: bool


class Publisher:
    """Publishes on one key, reliably; waits while a subscriber is slow, for 5 s at most by Zenoh's own rule."""

    def __init__(self, session: zenoh.Session, key: str, media: str) -> None:
        self.key = key
        self._publisher = session.declare_publisher(
            key,
            encoding=media,
            congestion_control=zenoh.CongestionControl.BLOCK,
            reliability=zenoh.Reliability.RELIABLE,
        )

    @property
    def wanted(self) -> bool:
        """Whether anybody subscribes."""
        return cast(_Matching, self._publisher.matching_status).matching  # an object that is true in any case

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Publish a sample."""
        self._publisher.put(payload, attachment=attachment)

    def close(self) -> None:
        """Publish no more."""
        self._publisher.undeclare()


def subscribe(session: zenoh.Session, key: str, put: Callable[[zenoh.Sample], None]) -> Callable[[], None]:
    """Have ``put`` called on the network thread for each sample of others; returns what ends it."""
    callback = zenoh.handlers.Callback(put, indirect=False)
    return session.declare_subscriber(key, callback, allowed_origin=zenoh.Locality.REMOTE).undeclare


def answer(session: zenoh.Session, key: str, reply: Callable[[zenoh.Query], dict[str, bytes]]) -> Callable[[], None]:
    """Answer queries of ``key`` with JSON texts by key; returns what ends it."""

    def handle(query: zenoh.Query) -> None:
        with query:
            for of, text in reply(query).items():
                query.reply(of, text, encoding="application/json")

    return session.declare_queryable(key, handle).undeclare


class RefusedError(Exception):
    """A query that is answered by an error, with its text."""

    def __init__(self, text: bytes) -> None:
        super().__init__(text.decode(errors="replace"))
        self.text = text


def obey(session: zenoh.Session, key: str, follow: Callable[[zenoh.Query], tuple[str, bytes]]) -> Callable[[], None]:
    """Answer queries of ``key`` with one key and its JSON text, or with the text of a ``RefusedError`` as an error."""

    def handle(query: zenoh.Query) -> None:
        with query:
            try:
                of, text = follow(query)
            except RefusedError as refusal:
                query.reply_err(refusal.text, encoding="application/json")
            else:
                query.reply(of, text, encoding="application/json")

    return session.declare_queryable(key, handle).undeclare


def ask(session: zenoh.Session, selector: str, *, timeout_s: float) -> list[bytes]:
    """The texts that all who answer ``selector`` give."""
    replies = session.get(selector, target=zenoh.QueryTarget.ALL, timeout=timeout_s)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def alive(session: zenoh.Session, selector: str, *, timeout_s: float) -> list[str]:
    """The liveliness tokens that match ``selector``."""
    replies = session.liveliness().get(selector, timeout=timeout_s)
    return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]


def sent_ns(sample: zenoh.Sample) -> int | None:
    """The time (ns) that Zenoh gave a sample, where a session on its way stamps them."""
    return None if sample.timestamp is None else sample.timestamp.get_time_as_ntp64().as_nanos()


def configuration(values: dict[str, str]) -> zenoh.Config:
    """A configuration from JSON texts by path."""
    config = zenoh.Config()
    for path, text in values.items():
        config.insert_json5(path, text)
    return config
