"""What signals ask of a process that runs until it is told to stop."""

import signal
import threading
from types import FrameType


def stop_and_snapshot() -> tuple[threading.Event, threading.Event]:
    """Events that SIGINT and SIGTERM, and SIGUSR1, set; a second SIGINT or SIGTERM raises KeyboardInterrupt."""
    stop, snapshot = threading.Event(), threading.Event()

    def end(_number: int, _frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    def ask(_number: int, _frame: FrameType | None) -> None:
        snapshot.set()

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    signal.signal(signal.SIGUSR1, ask)
    return stop, snapshot


def reload_asked() -> threading.Event:
    """An event that SIGHUP sets."""
    asked = threading.Event()

    def ask(_number: int, _frame: FrameType | None) -> None:
        asked.set()

    signal.signal(signal.SIGHUP, ask)
    return asked
