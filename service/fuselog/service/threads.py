"""Threads whose failure is noticed: whoever starts one is told when it ends, and why."""

import threading
from collections.abc import Callable

from fuselog.schemas import FuselogError


class Worker:
    """Runs ``work`` on a thread of its own and calls ``ended`` when it is over; ``error`` is what stopped it."""

    def __init__(self, name: str, work: Callable[[], None], ended: Callable[[], None]) -> None:
        self.name = name
        self.error: Exception | None = None
        self._work, self._ended = work, ended
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return self._thread.is_alive()

    def join(self, timeout_s: float) -> bool:
        """Whether it is over within ``timeout_s``."""
        self._thread.join(timeout_s)
        return not self.alive

    def _run(self) -> None:
        try:
            self._work()
        except Exception as error:  # whatever it is, the service reports it and ends
            self.error = error
        finally:
            self._ended()


class WorkerError(FuselogError):
    """A thread of the service failed; what it was, in one line."""

    def __init__(self, worker: Worker) -> None:
        reason = f"{type(worker.error).__name__}: {worker.error}".splitlines()[0]
        super().__init__(f"the {worker.name} stopped: {reason}")
