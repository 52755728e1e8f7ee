"""What publishers kept from before a subscription, put in front of what they send now.

Zenoh's own history (zenoh-ext 1.10) lets a live sample pass the older ones that are still on their way, and then takes
those for seen: in 5 of 30 subscriptions at 1 kHz nothing of the past came. So samples of a publisher wait here until
its past is there. What is lost later, Zenoh's recovery fills in.
"""
# Zenoh's stubs leave out what some methods return.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

import threading
from collections.abc import Callable
from functools import partial
from typing import Final

import zenoh

_MOST_PUBLISHERS: Final = 4096
_PATIENCE_S: Final = 5.0  # for the past of a publisher that does not answer

Put = Callable[[zenoh.Sample], None]


class Backlog:
    """Samples of one key expression on their way to ``put``: a publisher's in its order, none twice.

    ``take`` is given all that come live, in the order of each publisher, on any thread.
    """

    def __init__(self, session: zenoh.Session, key: str, put: Put) -> None:
        self._session, self._key, self._put = session, key, put
        self._lock = threading.Lock()
        self._waiting: dict[str, dict[int, zenoh.Sample]] = {}  # by publisher and number: until its past is there
        self._last: dict[str, int] = {}  # by publisher: the last number that came out of _waiting, until a later one
        self._known: dict[str, None] = {}  # publishers whose past needs not be asked for any more
        self._asked: set[str] = set()  # those of whom alone it has been asked, and who have not answered
        self._starting = True  # all publishers wait
        self._all_through = False

    def start(self) -> None:
        """Ask for the past of all who are there; returns when it has been put."""
        tokens = self._session.liveliness().get(f"{self._key}/@adv/pub/**", timeout=_PATIENCE_S)
        there = [_publisher(reply.ok) for reply in tokens if reply.ok is not None]
        with self._lock:
            for publisher in there:
                self._learn(publisher)
        replies = self._session.get(
            f"{self._key}/@adv/**?_anyke", consolidation=zenoh.ConsolidationMode.NONE, timeout=_PATIENCE_S
        )
        for reply in replies:
            self._keep(reply)
        with self._lock:
            self._starting = False
            self._release(*(publisher for publisher in self._waiting if publisher not in self._asked))

    def appear(self, token: zenoh.Sample) -> None:
        """A publisher has come, which says so by a token; its past is asked for, once."""
        publisher = _publisher(token)
        with self._lock:
            if token.kind != zenoh.SampleKind.PUT or publisher in self._known:
                return
            self._learn(publisher)
            self._asked.add(publisher)
            self._waiting[publisher] = {}
            self._all_through = False
        self._session.get(
            f"{token.key_expr}?_anyke",
            zenoh.handlers.Callback(self._keep, partial(self._done, publisher), indirect=False),
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_PATIENCE_S,
        )

    def take(self, sample: zenoh.Sample) -> None:
        """A live sample; those of publishers without numbers go through at once."""
        if self._all_through:
            self._put(sample)
            return
        with self._lock:
            self._place(sample)

    def _keep(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            with self._lock:
                self._place(reply.ok)

    def _place(self, sample: zenoh.Sample) -> None:
        info = sample.source_info
        if info is None:
            self._put(sample)
            return
        publisher, number = f"{info.source_id.zid}/{info.source_id.eid}", info.source_sn
        if self._starting and publisher not in self._waiting:
            self._learn(publisher)
            self._waiting[publisher] = {}
        waiting = self._waiting.get(publisher)
        if waiting is not None:
            waiting[number] = sample
        elif number > self._last.get(publisher, -1):
            self._put(sample)
            if self._last.pop(publisher, None) is not None:  # from here on its live samples go up by themselves
                self._all_through = not (self._waiting or self._last)

    def _done(self, publisher: str) -> None:
        with self._lock:
            self._asked.discard(publisher)
            self._release(publisher)

    def _release(self, *publishers: str) -> None:
        for publisher in publishers:
            samples = self._waiting.pop(publisher)
            for number in sorted(samples):
                self._put(samples[number])
                self._last[publisher] = number
        self._all_through = not (self._waiting or self._last)

    def _learn(self, publisher: str) -> None:
        if len(self._known) >= _MOST_PUBLISHERS:
            del self._known[next(iter(self._known))]
        self._known[publisher] = None


def _publisher(token: zenoh.Sample) -> str:
    """Who says by a token that it is there: KEY/@adv/pub/SESSION/NUMBER/..."""
    return "/".join(str(token.key_expr).partition("/@adv/pub/")[2].split("/")[:2])
