"""What the process of the filters and the one for HTTP tell each other."""

import pickle
import threading
from collections.abc import Mapping
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from fuselog.fusion import Plan
from fuselog.fusion.config import Source
from fuselog.fusion.config.settings import HttpSettings
from fuselog.service.live.member import Snapshot
from fuselog.service.live.runner import Unknown


class Setup(NamedTuple):
    """The first message to the process for HTTP: what it serves with."""

    http: HttpSettings
    source: Source
    behind_proxy: bool
    audited: bool  # whether lines of the audit go to stderr


class Serving(NamedTuple):
    """Its first one: it answers now."""


class Heard(NamedTuple):
    """It knows that all is ready."""


class News(NamedTuple):
    """What has changed since the last news."""

    alive: bool
    ready: bool
    unknown: Unknown | None  # None: as before
    plans: Mapping[str, Plan]  # of the filters whose plan is another one
    snapshots: Mapping[str, Snapshot]  # without plan and samples, of filters that run
    ended: Mapping[str, Snapshot]  # the same of filters that have ended
    running: tuple[str, ...] | None  # the ids of all that run, and
    over: tuple[str, ...]  # of all that have ended; None: all as before


class Question(NamedTuple):
    """A call of a method of ``Served`` that only the filters can answer."""

    number: int
    method: str
    arguments: tuple[Any, ...]


class Reply(NamedTuple):
    """What it returned, or raised."""

    number: int
    value: Any = None
    error: "Raised | None" = None


class Raised(NamedTuple):
    """An exception as it can be sent: not every kind can be made anew from its arguments."""

    kind: type[Exception]
    arguments: tuple[Any, ...]
    fields: dict[str, Any]

    @classmethod
    def of(cls, error: Exception) -> "Raised":
        """What makes it again."""
        return cls(type(error), error.args, error.__dict__)

    def again(self) -> Exception:
        """The same exception."""
        error = self.kind.__new__(self.kind, *self.arguments)
        error.args = self.arguments
        error.__dict__.update(self.fields)
        return error


class Renew(NamedTuple):
    """The files of tokens and certificate are to be read again."""


class Renewed(NamedTuple):
    """They have been, and hold from now on."""


class Stop(NamedTuple):
    """No more is to be answered."""


Message = Setup | Serving | Heard | News | Question | Reply | Renew | Renewed | Stop


class Channel:
    """One end of a pipe between two processes of one service. Any thread may send, one receives."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._lock = connection, threading.Lock()

    def send(self, message: Message) -> None:
        """Raises ``OSError`` when the other process has ended."""
        data = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        with self._lock:
            self._connection.send_bytes(data)

    def receive(self) -> Message:
        """The next message; raises ``EOFError`` or ``OSError`` when the other process has ended."""
        return pickle.loads(self._connection.recv_bytes())

    def close(self) -> None:
        """Send and receive no more."""
        self._connection.close()
