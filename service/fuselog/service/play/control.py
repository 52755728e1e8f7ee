"""A player's commands over Zenoh: ``@fuselog/player/<name>/<command>?<argument>=<value>``, answered in JSON."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import orjson
import zenoh

from fuselog.replay.play import CommandError, Drive, Playback, parse_moment
from fuselog.service.zenoh_door import RefusedError, obey

Arguments = Mapping[str, str]

PREFIX = "@fuselog/player"  # `**` does not match what begins with @: no query for everything stops a player


def player_name(text: str) -> str:
    """A name as one part of a key of Zenoh."""
    return re.sub(r"[^\w.-]+", "_", text) or "player"


def control(session: zenoh.Session, name: str, drive: Drive) -> Callable[[], None]:
    """Follow the commands that come to the player called ``name``; returns what ends it.

    Each answer holds the status afterwards. What cannot be followed is an error reply that says why, in JSON too.
    """

    def follow(query: zenoh.Query) -> tuple[str, bytes]:
        command = str(query.key_expr).rpartition("/")[2]
        about = {"schema": 1, "player": name, "command": command}
        try:
            status = drive.command(lambda playback: execute(playback, command, _arguments(str(query.parameters))))
        except CommandError as error:
            raise RefusedError(orjson.dumps({**about, "error": str(error)})) from error
        return f"{PREFIX}/{name}/{command}", orjson.dumps({**about, **status})

    return obey(session, f"{PREFIX}/{name}/*", follow)


def execute(playback: Playback, command: str, arguments: Arguments) -> dict[str, Any]:
    """Follow one command -> the status afterwards; raises ``CommandError`` for one that cannot be followed."""
    if command not in _COMMANDS:
        raise CommandError(f"no command {command!r}; there are {', '.join(_COMMANDS)}")
    known, do = _COMMANDS[command]
    for name in arguments:
        if name not in known:
            raise CommandError(f"{command} has no argument {name!r}; it has {', '.join(known) or 'none'}")
    do(playback, arguments)
    return asdict(playback.status())


def _rate(playback: Playback, arguments: Arguments) -> None:
    playback.timeline.set_rate(_number(arguments, "value"))


def _burst(playback: Playback, arguments: Arguments) -> None:
    count = _number(arguments, "count")
    if not count.is_integer():
        raise CommandError(f"count {count:g} is not a whole number")
    playback.timeline.step(int(count))


def _seek(playback: Playback, arguments: Arguments) -> None:
    if len(arguments) != 1:
        raise CommandError("seek needs to (a time) or by (seconds)")
    line = playback.timeline
    if "by" in arguments:
        playback.seek(line.position + _ns(_number(arguments, "by")))
        return
    try:
        playback.seek(parse_moment(arguments["to"], line.range.first))
    except ValueError as error:
        raise CommandError(f"to: {error}") from error


def _ns(seconds: float) -> int:
    return round(max(-1e9, min(seconds, 1e9)) * 1e9)


def _number(arguments: Arguments, name: str) -> float:
    try:
        number = float(arguments[name])
    except (KeyError, ValueError) as error:
        raise CommandError(f"{name}: a number is needed, not {arguments.get(name)!r}") from error
    if not math.isfinite(number):
        raise CommandError(f"{name}: a finite number is needed")
    return number


_COMMANDS: dict[str, tuple[tuple[str, ...], Callable[[Playback, Arguments], object]]] = {
    "status": ((), lambda playback, _: playback.status()),
    "pause": ((), lambda playback, _: playback.timeline.pause()),
    "resume": ((), lambda playback, _: playback.timeline.resume()),
    "toggle": ((), lambda playback, _: playback.timeline.toggle()),
    "rate": (("value",), _rate),
    "seek": (("to", "by"), _seek),
    "step": ((), lambda playback, _: playback.timeline.step()),
    "burst": (("count",), _burst),
    "stop": ((), lambda playback, _: playback.stop()),
}


def _arguments(text: str) -> dict[str, str]:
    """Arguments as a selector has them: ``a=1;b=2``."""
    return {name: value for name, _, value in (part.partition("=") for part in text.split(";") if part)}
