"""The process for HTTP as the filters see it: begun, told the news, answered, and begun anew should it fail."""

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import cast

from fuselog.fusion import Plan
from fuselog.service.front.channel import (
    Channel,
    Heard,
    News,
    Question,
    Raised,
    Renew,
    Renewed,
    Reply,
    Serving,
    Setup,
    Stop,
)
from fuselog.service.live.member import Snapshot
from fuselog.service.live.runner import Unknown
from fuselog.service.rest.served import Served
from fuselog.service.threads import Worker

_START_S = 30.0  # within which it must answer
_RENEW_S = 2.0
_END_S = 6.0  # that it may take to end, with answers under way
_NEWS_EVERY_S = 0.1  # where nobody says that there are some
_LEAST_S = 0.005  # from news to news
_HEARTBEAT_S = 1.0  # between news, at most
_SHARE = 0.1  # of the time for news, at most
_AGAIN_S = 1.0  # from its end to the next beginning
_SHOWN_S = 0.3  # that a command may take to show in a snapshot
_THREADS = 16
_NO_PLAN = cast(Plan, None)

Snapshots = Mapping[str, Snapshot]


class FrontError(Exception):
    """The process for HTTP does not begin."""


class Front:
    """Serves ``served`` over HTTP on a socket that is bound, from construction to ``finish``."""

    def __init__(
        self,
        served: Served,
        listener: socket.socket,
        setup: Setup,
        *,
        alive: Callable[[], bool],
        ready: Callable[[], bool],
        say: Callable[[str], None],
        ended: Callable[[], None],
    ) -> None:
        """``say`` is told when it had to begin anew, ``ended`` when it cannot."""
        self._served, self._listener, self._setup = served, listener, setup
        self._alive, self._ready, self._say = alive, ready, say
        self._finishing, self._due, self._failed = threading.Event(), threading.Event(), ""  # why, if it has
        self._heard, self._renewed = threading.Event(), threading.Event()
        self._pool, self._lock = ThreadPoolExecutor(_THREADS, "question"), threading.Lock()
        self._begin()
        self._reading = Worker("HTTP server", self._read, ended)
        self._telling = Worker("news", self._tell, lambda: None)

    @property
    def worker(self) -> Worker:
        """What is over when HTTP cannot be served any more."""
        return self._reading

    def wait(self) -> bool:
        """Until it answers that all is ready, which it is -> whether it did; one that does not in time is ended."""
        self.soon()
        if not self._heard.wait(_START_S):
            self._failed = f"it did not answer within {_START_S:g} s"
            self._process.kill()
        return not self._failed

    def soon(self) -> None:
        """There are new snapshots to tell of."""
        self._due.set()

    def renew(self) -> None:
        """Have it read tokens and certificate again, and wait until they hold."""
        self._renewed.clear()
        with suppress(OSError):
            self._channel.send(Renew())
            self._renewed.wait(_RENEW_S)

    def finish(self) -> None:
        """Answer no more; a process that does not end by itself is killed."""
        with self._lock:  # it does not begin anew from here on
            self._finishing.set()
        self._due.set()
        Worker("last news", self._end, lambda: None)  # it may not read any more
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._telling.join(_END_S)
        self._reading.join(_END_S)
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _end(self) -> None:
        with suppress(OSError):
            self._channel.send(Stop())

    def _begin(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            command = [sys.executable, "-m", "fuselog.service.front.process"]
            descriptors = self._listener.fileno(), theirs.fileno()
            self._process = subprocess.Popen([*command, *map(str, descriptors)], pass_fds=descriptors)
        self._channel = Channel(Connection(ours.detach()))
        self._told = Told(self._channel)
        with suppress(OSError):  # it has ended already: the reader finds out
            self._channel.send(self._setup)

    def _read(self) -> None:
        """Take what it says; begin it anew when it ends, unless it never answered."""
        answered = False
        while True:
            answered = self._follow() or answered
            status = self._process.wait()
            if self._finishing.is_set():
                return
            if not answered or self._failed:
                self._failed = self._failed or f"it ended before it answered, with status {status}"
                self._heard.set()  # nobody need wait for it
                raise FrontError(self._failed)
            self._say(f"the HTTP server ended with status {status}, and begins anew; the filters go on")
            self._finishing.wait(_AGAIN_S)
            with self._lock:
                if self._finishing.is_set():
                    return
                self._channel.close()
                self._begin()

    def _follow(self) -> bool:
        """Answer its questions until it ends -> whether it had begun to serve."""
        channel, answered = self._channel, False
        with suppress(EOFError, OSError):
            while True:
                match channel.receive():
                    case Serving():
                        answered = True
                    case Heard():
                        self._heard.set()
                    case Renewed():
                        self._renewed.set()
                    case Question() as question:
                        self._pool.submit(self._answer, channel, question)
                    case message:
                        raise AssertionError(message)
        return answered

    def _answer(self, channel: Channel, question: Question) -> None:
        number, method, arguments = question
        before = self._served.snapshots().get(arguments[0]) if method == "command" else None
        try:
            reply = Reply(number, getattr(self._served, method)(*arguments))
            if before is not None:
                self._wait_for_another(before, arguments[0])
        except Exception as error:  # whoever asked gets it
            reply = Reply(number, error=Raised.of(error))
        with suppress(OSError):
            self._news(channel)
            channel.send(reply)

    def _wait_for_another(self, before: Snapshot, id: str) -> None:
        """What a command changed is to be seen by who asks next."""
        until = time.monotonic() + _SHOWN_S
        while time.monotonic() < until:
            now = self._served.snapshots().get(id)
            if now is None or now.health is not before.health:
                return
            time.sleep(0.002)

    def _tell(self) -> None:
        """Tell what is new, at times and for a share of them, until ``finish``."""
        pause = _LEAST_S
        while not self._finishing.wait(pause):
            self._due.wait(_NEWS_EVERY_S)
            self._due.clear()
            begun = time.monotonic()
            with suppress(OSError):
                self._news(self._channel)
            pause = max(_LEAST_S, (time.monotonic() - begun) / _SHARE)

    def _news(self, channel: Channel) -> None:
        told = self._told
        if told.channel is channel:
            told.tell(self._served, alive=self._alive(), ready=self._ready())


class Told:
    """What has been told over a channel."""

    def __init__(self, channel: Channel) -> None:
        self.channel = channel
        self._lock = threading.Lock()
        self._at = -_HEARTBEAT_S
        self._state: tuple[bool, bool] | None = None
        self._unknown: Unknown | None = None
        self._running: dict[str, Snapshot] = {}
        self._ended: dict[str, Snapshot] = {}
        self._plans: dict[str, Plan] = {}

    def tell(self, served: Served, *, alive: bool, ready: bool) -> None:
        """Send what is other than before; raises ``OSError``."""
        with self._lock:
            running, ended, unknown = dict(served.snapshots()), dict(served.ended()), served.unknown
            fresh, gone = _changed(self._running, running), _changed(self._ended, ended)
            plans = {id: each.plan for id, each in (fresh | gone).items() if self._plans.get(id) is not each.plan}
            ids = tuple(running), tuple(ended)
            same_ids = ids == (tuple(self._running), tuple(self._ended))
            same_unknown = self._unknown is not None and unknown.samples == self._unknown.samples
            quiet = not fresh and not gone and same_ids and same_unknown and self._state == (alive, ready)
            if quiet and time.monotonic() - self._at < _HEARTBEAT_S:
                return
            self.channel.send(
                News(
                    alive=alive,
                    ready=ready,
                    unknown=None if same_unknown else unknown,
                    plans=plans,
                    snapshots={id: _bare(each) for id, each in fresh.items()},
                    ended={id: _bare(each) for id, each in gone.items()},
                    running=None if same_ids else ids[0],
                    over=ids[1],
                )
            )
            self._at, self._state, self._unknown = time.monotonic(), (alive, ready), unknown
            self._running, self._ended = running, ended
            self._plans = {id: each.plan for id, each in (ended | running).items()}


def _changed(before: Snapshots, now: Snapshots) -> dict[str, Snapshot]:
    return {id: each for id, each in now.items() if id not in before or not _same(before[id], each)}


def _same(a: Snapshot, b: Snapshot) -> bool:
    """Whether two snapshots are of one moment, and files stand as they did."""
    return a is b or (a.health is b.health and a.unsaved == b.unsaved and a.recording == b.recording)


def _bare(snapshot: Snapshot) -> Snapshot:
    return replace(snapshot, plan=_NO_PLAN, recent=())
