"""The one typed door to Zenoh's objects: its stubs leave out what methods return, and call a status a bool."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

import ctypes
import json
import re
import threading
from collections.abc import Callable
from typing import Any, Final, Protocol, TypeVar, cast

import zenoh
from zenoh import ext

from fuselog.service.backlog import Backlog

_HEARTBEAT_S: Final = 0.5  # in which a subscriber learns that it missed the last samples
_SOURCE_PLACE: Final = re.compile(r"\s*at /\S+\.rs:\d+\.?")
_JSON_ERROR: Final = re.compile(r"msg: \"(?P<reason>.*)\", location: Some\(Location (?P<place>\{.*?\})")

_T = TypeVar("_T")


class _Matching(Protocol):
    matching: bool


class Publisher:
    """Publishes on one key, reliably; waits while a subscriber is slow, for 5 s at most by Zenoh's own rule.

    With a ``cache`` the last samples are kept, so many: subscribers that ask for it (``subscribe_reliably``) are told
    twice a second what the last one was, and get what they missed, or what was published before they came.
    """

    def __init__(self, session: zenoh.Session, key: str, media: str, *, cache: int = 0) -> None:
        self.key = key
        quality: dict[str, Any] = {
            "encoding": media,
            "congestion_control": zenoh.CongestionControl.BLOCK,
            "reliability": zenoh.Reliability.RELIABLE,
        }
        self.wanted = True  # whether anybody subscribes, or may ask later
        self._listener: zenoh.MatchingListener[None] | None = None
        if cache:
            self._publisher = ext.declare_advanced_publisher(
                session,
                key,
                cache=ext.CacheConfig(cache),
                sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S),
                publisher_detection=True,
                **quality,
            )
        else:
            publisher = self._publisher = session.declare_publisher(key, **quality)
            self._listener = publisher.declare_matching_listener(_on_network_thread(self._match))
            self._match(publisher.matching_status)

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Publish a sample."""
        self._publisher.put(payload, attachment=attachment)

    def close(self) -> None:
        """Publish no more."""
        if self._listener is not None:
            self._listener.undeclare()
        self._publisher.undeclare()

    def _match(self, status: object) -> None:
        self.wanted = cast(_Matching, status).matching  # an object that is true in any case


def subscribe(session: zenoh.Session, key: str, put: Callable[[zenoh.Sample], None]) -> Callable[[], None]:
    """Have ``put`` called on the network thread for each sample of others; returns what ends it."""
    return session.declare_subscriber(key, _on_network_thread(put), allowed_origin=zenoh.Locality.REMOTE).undeclare


def subscribe_reliably(
    session: zenoh.Session,
    key: str,
    put: Callable[[zenoh.Sample], None],
    *,
    missed: Callable[[str, int], None],
) -> Callable[[], None]:
    """The same, and what publishers with a cache published before, or what got lost on the way, is asked for.

    The samples of a publisher come in its order: those after a gap wait for the answer. ``missed`` is told a publisher
    and how many of its samples nobody has any more. Other publishers are heard as by ``subscribe``. Neither function
    may call Zenoh. Returns when the past of all who are there has been put: 5 s at most. What is returned must be
    called before the session is closed, and not from either function.
    """
    backlog = Backlog(session, key, put)
    subscriber = ext.declare_advanced_subscriber(
        session,
        key,
        _on_network_thread(backlog.take),
        allowed_origin=zenoh.Locality.REMOTE,
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )
    publishers = subscriber.detect_publishers(_on_network_thread(backlog.appear))

    def tell(miss: ext.Miss) -> None:
        missed(f"{miss.source.zid}/{miss.source.eid}", miss.nb)

    misses = subscriber.sample_miss_listener(_on_network_thread(tell))
    backlog.start()

    def end() -> None:
        misses.undeclare()
        publishers.undeclare()
        subscriber.undeclare()

    return end


def _on_network_thread(put: Callable[[_T], None]) -> "zenoh.handlers.Callback[_T]":
    """A handler that calls ``put`` at once, on the thread that read the sample.

    Such a thread is none of Python's, so each call would make a state of the interpreter for it and throw it away,
    which costs several times what ``put`` does. Held once more than it is released, the state stays with the thread.
    """
    here = threading.local()

    def call(item: _T) -> None:
        try:
            here.held  # noqa: B018  whether it is there
        except AttributeError:
            ctypes.pythonapi.PyGILState_Ensure()
            here.held = True
        put(item)

    return zenoh.handlers.Callback(call, indirect=False)


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


def tell(session: zenoh.Session, selector: str, *, timeout_s: float) -> bytes | None:
    """The text with which the one who follows ``selector`` answers; None where nobody does.

    Raises ``RefusedError`` with the text of an answer that is an error.
    """
    for reply in session.get(selector, timeout=timeout_s):
        if reply.err is not None:
            raise RefusedError(reply.err.payload.to_bytes())
        if reply.ok is not None:
            return reply.ok.payload.to_bytes()
    return None


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


def read_value(path: str, text: str) -> Any:
    """What a JSON5 text says at a path of a configuration, with defaults; raises ``zenoh.ZError``."""
    return json.loads(configuration({path: text}).get_json(path))


def reason_of(error: zenoh.ZError) -> str:
    """What Zenoh says in an error, without the places of its source code."""
    text = _SOURCE_PLACE.sub("", str(error)).strip()
    found = _JSON_ERROR.search(text)
    if found is not None:
        line, column = re.findall(r"\d+", found["place"])
        reason = found["reason"].replace('\\"', '"').rpartition("\\n")[2].lstrip(" =")
        return f"{reason} (line {line}, column {column})"
    return text.removeprefix('Str("').removesuffix('")')
