"""The account of a recording: every message that was received is somewhere."""

from collections.abc import Mapping
from typing import Literal, NamedTuple

Reason = Literal["queue", "disk", "limit"]


class Account(NamedTuple):
    """Messages of one topic: received = written + waiting + expired + queue + disk + limit."""

    received: int = 0
    written: int = 0  # handed to the system, or to the disk, as the durability says
    waiting: int = 0  # in memory, on their way or in a snapshot to come
    expired: int = 0  # grew too old for a snapshot, and none was asked for
    queue: int = 0  # dropped: came faster than they could be written
    disk: int = 0  # dropped: the disk took no more
    limit: int = 0  # dropped: too large a message, too many channels, too little memory for a snapshot
    gaps: int = 0  # numbers that publishers gave and nothing came with; what the queue dropped is among them

    @property
    def dropped(self) -> int:
        """Received and gone."""
        return self.queue + self.disk + self.limit

    @property
    def missed(self) -> int:
        """Sent and never received."""
        return max(self.gaps - self.queue, 0)

    @property
    def lossy(self) -> bool:
        """Whether anything is not in the files that should be."""
        return self.dropped + self.missed > 0


OTHERS = "(other topics)"
_MOST_TOPICS = 8192


class Ledger:
    """Counts by topic; when there are too many, of those that come later together."""

    def __init__(self) -> None:
        self._accounts: dict[str, Account] = {}

    def add(self, topic: str, **counts: int) -> None:
        """Add to the fields of a topic's account."""
        if topic not in self._accounts and len(self._accounts) >= _MOST_TOPICS:
            topic = OTHERS
        account = self._accounts.get(topic, Account())
        self._accounts[topic] = account._replace(**{name: getattr(account, name) + n for name, n in counts.items()})

    def accounts(self) -> Mapping[str, Account]:
        """The accounts by topic, as they are now."""
        return dict(self._accounts)


def total(accounts: Mapping[str, Account]) -> Account:
    """The sum over all topics."""
    return Account(*map(sum, zip(*accounts.values(), strict=True))) if accounts else Account()
