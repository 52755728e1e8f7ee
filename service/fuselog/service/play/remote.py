"""Players elsewhere, as whoever is in the same network commands them."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from typing import Any, cast

import orjson
import zenoh

from fuselog.fusion.commands import CommandError
from fuselog.replay.play import Status
from fuselog.service.play.control import PREFIX
from fuselog.service.zenoh_door import RefusedError, ask, tell

_ANSWER_S = 2.0
_TOLD = ("player", *(field.name for field in fields(Status)))


def players(session: zenoh.Session) -> list[dict[str, Any]]:
    """The name and status of each player that can be reached; what answers in another form is none."""
    found: list[dict[str, Any]] = []
    for text in ask(session, f"{PREFIX}/*/status", timeout_s=_ANSWER_S):
        with suppress(CommandError):
            found.append(_status(text))
    return sorted(found, key=lambda status: str(status["player"]))


def command_player(session: zenoh.Session, name: str, command: str, arguments: Mapping[str, str]) -> dict[str, Any]:
    """Give a player a command -> its name and its status afterwards.

    Raises ``KeyError`` where there is none of this name, ``CommandError`` where it cannot follow.
    """
    given = ";".join(f"{argument}={value}" for argument, value in arguments.items())
    try:
        text = tell(session, f"{PREFIX}/{name}/{command}?{given}", timeout_s=_ANSWER_S)
    except RefusedError as refusal:
        raise CommandError(str(_read(refusal.text, ("error",))["error"])) from None
    if text is None:
        raise KeyError(name)
    return _status(text)


def _status(text: bytes) -> dict[str, Any]:
    return {key: value for key, value in _read(text, _TOLD).items() if key in _TOLD}


def _read(text: bytes, keys: tuple[str, ...]) -> dict[str, Any]:
    """An answer that has these keys; raises ``CommandError`` for anything else."""
    with suppress(orjson.JSONDecodeError):
        told: object = orjson.loads(text)
        if isinstance(told, dict) and all(key in told for key in keys):
            return cast(dict[str, Any], told)
    raise CommandError("the player answers in a form that is not known")
