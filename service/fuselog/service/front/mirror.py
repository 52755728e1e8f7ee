"""The filters as the process for HTTP sees them: what it was told last, and questions to the other process."""

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import replace
from itertools import count
from typing import Any, Literal

from fuselog.fusion import Estimate, Plan
from fuselog.fusion.commands import Command
from fuselog.fusion.health import Recent
from fuselog.replay.recording import RecordingStatus
from fuselog.service.front.channel import Channel, Heard, News, Question, Renew, Renewed, Reply, Stop
from fuselog.service.live.member import Snapshot
from fuselog.service.live.runner import Unknown

_OLD_S = 2.0  # without news, which there are every second, these are old
_STUCK_S = 10.0  # and the other process does not turn


class Mirror:
    """``Served`` over a channel. What waits may be called on any thread but the one that follows the news."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._numbers, self._lock = count(), threading.Lock()
        self._asked: dict[int, Future[Any]] = {}
        self._plans: dict[str, Plan] = {}
        self._running: Mapping[str, Snapshot] = {}
        self._ended: Mapping[str, Snapshot] = {}
        self._unknown = Unknown(0, {})
        self._alive, self._ready, self._heard = True, False, time.monotonic()

    def follow(self, *, begin: Callable[[], None], renew: Callable[[], None]) -> None:
        """Take the news until ``Stop``; raises ``EOFError`` or ``OSError`` when the other process has ended.

        ``begin`` is called after the first news, before which there is nothing to show, ``renew`` at each `Renew`.
        """
        begun = False
        while True:
            match self._channel.receive():
                case News() as news:
                    first = news.ready and not self._ready
                    self._take(news)
                    if not begun:
                        begin()
                        begun = True
                    if first:
                        self._channel.send(Heard())
                case Reply(number, value, error):
                    future = self._asked.pop(number)
                    future.set_result(value) if error is None else future.set_exception(error.again())
                case Renew():
                    renew()
                    self._channel.send(Renewed())
                case Stop():
                    return
                case message:
                    raise AssertionError(message)

    @property
    def alive(self) -> bool:
        """Whether the filters turn, and tell of it."""
        return self._alive and time.monotonic() - self._heard < _STUCK_S

    @property
    def current(self) -> bool:
        """Whether what it shows is of now."""
        return time.monotonic() - self._heard < _OLD_S

    @property
    def ready(self) -> bool:
        """Whether all is compiled and connected, and nothing is ending."""
        return self._ready

    def snapshots(self) -> Mapping[str, Snapshot]:
        """As ``Served``; samples are asked for apart."""
        return self._running

    def ended(self) -> Mapping[str, Snapshot]:
        """As ``Served``."""
        return self._ended

    @property
    def unknown(self) -> Unknown:
        """As ``Served``."""
        return self._unknown

    def remembered(self, id: str) -> Recent:
        """As ``Served``."""
        return self._ask("remembered", id)

    def estimate_at(self, id: str, t_ns: int) -> Estimate:
        """As ``Served``."""
        return self._ask("estimate_at", id, t_ns)

    def command(self, id: str, command: Command) -> None:
        """As ``Served``."""
        self._ask("command", id, command)

    def reload(self) -> list[str]:
        """As ``Served``."""
        return self._ask("reload")

    def record(self, id: str, what: Literal["start", "stop", "snapshot"]) -> RecordingStatus:
        """As ``Served``."""
        return self._ask("record", id, what)

    def players(self) -> list[dict[str, Any]]:
        """As ``Served``."""
        return self._ask("players")

    def play(self, name: str, command: str, arguments: Mapping[str, str]) -> dict[str, Any]:
        """As ``Served``."""
        return self._ask("play", name, command, arguments)

    def _ask(self, method: str, *arguments: Any) -> Any:
        future: Future[Any] = Future()
        with self._lock:
            number = next(self._numbers)
        self._asked[number] = future
        self._channel.send(Question(number, method, arguments))
        return future.result()

    def _take(self, news: News) -> None:
        self._plans.update(news.plans)
        running = {**self._running, **self._whole(news.snapshots)}
        ended = {**self._ended, **self._whole(news.ended)}
        if news.running is not None:
            running = {id: running[id] for id in news.running}
            ended = {id: ended[id] for id in news.over}
            self._plans = {id: self._plans[id] for id in {*running, *ended}}
        if news.unknown is not None:
            self._unknown = news.unknown
        self._running, self._ended = running, ended
        self._alive, self._ready, self._heard = news.alive, news.ready, time.monotonic()

    def _whole(self, snapshots: Mapping[str, Snapshot]) -> dict[str, Snapshot]:
        return {id: replace(snapshot, plan=self._plans[id]) for id, snapshot in snapshots.items()}
