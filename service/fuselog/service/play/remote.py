"""Players elsewhere, as whoever is in the same network commands them."""

from collections.abc import Mapping
from typing import Any

import orjson
import zenoh

from fuselog.fusion.commands import CommandError
from fuselog.service.play.control import PREFIX
from fuselog.service.zenoh_door import RefusedError, ask, tell

_ANSWER_S = 2.0


def players(session: zenoh.Session) -> list[dict[str, Any]]:
    """The status of each player that can be reached, by name."""
    answers = [orjson.loads(text) for text in ask(session, f"{PREFIX}/*/status", timeout_s=_ANSWER_S)]
    return sorted(answers, key=lambda status: status["player"])


def command_player(session: zenoh.Session, name: str, command: str, arguments: Mapping[str, str]) -> dict[str, Any]:
    """Give a player a command -> its status afterwards.

    Raises ``KeyError`` where there is none of this name, ``CommandError`` where it cannot follow.
    """
    given = ";".join(f"{argument}={value}" for argument, value in arguments.items())
    try:
        text = tell(session, f"{PREFIX}/{name}/{command}?{given}", timeout_s=_ANSWER_S)
    except RefusedError as refusal:
        raise CommandError(orjson.loads(refusal.text)["error"]) from None
    if text is None:
        raise KeyError(name)
    return orjson.loads(text)
