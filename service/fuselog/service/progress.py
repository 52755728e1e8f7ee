"""How far a service has come with what a player sent: asked and answered over Zenoh."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import orjson
import zenoh

from fuselog.service.live.sources import Progress
from fuselog.service.zenoh_door import answer, ask

_PATIENCE_S = 2.0


@dataclass(frozen=True, slots=True)
class Received:
    """What one service answers: its keys, and how far it is with each from one publisher."""

    filter: str
    keys: frozenset[str]
    progress: Mapping[str, Progress]


Tell = Callable[[str], tuple[list[str], Mapping[str, Progress]]]


def tell_progress(session: zenoh.Session, name: str, tell: Tell) -> Callable[[], None]:
    """Answer ``@fuselog/<name>/received?source=<hex>``; returns what ends it.

    ``tell`` gives the keys that the source (hex) feeds, and the counts of each.
    """
    key = f"@fuselog/{name}/received"

    def received(query: zenoh.Query) -> dict[str, bytes]:
        keys, progress = tell(query.parameters.get("source") or "")
        counts = {key: list(counted) for key, counted in progress.items()}
        return {key: orjson.dumps({"schema": 1, "filter": name, "keys": keys, "progress": counts})}

    return answer(session, key, received)


def ask_progress(session: zenoh.Session, source: bytes) -> list[Received]:
    """The answers of all services there are."""
    texts = ask(session, f"@fuselog/*/received?source={source.hex()}", timeout_s=_PATIENCE_S)
    return [_parsed(text) for text in texts]


def _parsed(text: bytes) -> Received:
    told = orjson.loads(text)
    progress = {key: Progress(*counts) for key, counts in told["progress"].items()}
    return Received(told["filter"], frozenset(told["keys"]), progress)
