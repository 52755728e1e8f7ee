"""What the HTTP server has done so far, in figures."""

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True)
class Traffic:
    """Counters of one server; only the thread of its event loop writes them."""

    answered: Counter[int] = field(default_factory=Counter[int])  # by status
    refused: Counter[str] = field(default_factory=Counter[str])  # before the request was looked at, by reason
    slow: int = 0  # connections closed because the request did not come in time
    unread: int = 0  # connections closed because the client did not read
    crowded: int = 0  # connections closed because there were too many
    active: int = 0  # requests under way, without streams
    streams: int = 0  # clients of the stream
