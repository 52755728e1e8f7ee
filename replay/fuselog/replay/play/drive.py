"""Runs a playback by the clock of the machine: waits precisely, and takes commands from other threads meanwhile."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import TypeVar

from fuselog.replay.play.playback import Playback
from fuselog.replay.play.played import Played

_NEAR_NS = 1_000_000  # from here on a command has to wait, and the sleep is a precise one
_SPIN_NS = 60_000  # no sleep is as short as this

_T = TypeVar("_T")


class Drive:
    """Yields the messages of a playback, each when it is due; whoever takes them publishes them.

    ``command`` may be called from any thread, also while a message is being published. The clock is that of the
    playback's timeline, which must be ``time.monotonic_ns``.
    """

    def __init__(self, playback: Playback) -> None:
        self._playback = playback
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)

    def command(self, do: Callable[[Playback], _T]) -> _T:
        """Do something with the playback between two messages, and give back what it gives."""
        with self._lock:
            done = do(self._playback)
            self._changed.notify()
        return done

    def __iter__(self) -> Iterator[Played]:
        """The messages until the playback is over."""
        try:
            while True:
                with self._lock:
                    due = self._playback.due()
                    if due is None:
                        if self._playback.over:
                            return
                        self._changed.wait()
                        continue
                    ahead = due - time.monotonic_ns()
                    if ahead > _NEAR_NS:
                        self._changed.wait((ahead - _NEAR_NS) / 1e9)
                        continue
                    played = self._playback.take() if ahead <= 0 else None
                if played is not None:
                    yield played
                elif ahead > 0:
                    _sleep_until(due)
        finally:
            with self._lock:
                self._playback.close()


def _sleep_until(due_ns: int) -> None:
    while (ahead := due_ns - time.monotonic_ns()) > 0:
        if ahead > _SPIN_NS:
            time.sleep((ahead - _SPIN_NS) / 1e9)
