"""What may be asked of a filter while it runs. A command takes effect at its place in the order of arrival."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from fuselog.schemas import FuselogError


class CommandError(FuselogError):
    """A command that a filter cannot follow, and why; the filter is as it was."""


@dataclass(frozen=True, slots=True)
class Reset:
    """Begin anew, as the configuration says; what was received stays counted."""


@dataclass(frozen=True, slots=True)
class SetState:
    """Put states, in their units, where they are said to be, with these standard deviations (1 when not given)."""

    state: Mapping[str, float]
    sd: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Configure:
    """Go on with another configuration (the whole text), with the state that there is where it has the same states."""

    text: str


Command = Reset | SetState | Configure


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What became of a command; published as a fuselog_msgs/msg/Command."""

    command: Command
    t_ns: int | None  # the filter's newest time when it took effect
    after_ns: int  # when the last message before it was received: its place in a log
    asked_ns: int  # when it was given
    reason: str = ""  # why it was refused; empty where it was not

    @property
    def accepted(self) -> bool:
        """Whether it took effect."""
        return not self.reason


def command_text(command: Command) -> tuple[str, str]:
    """Kind and arguments, these as JSON, that ``read_command`` takes."""
    match command:
        case Reset():
            return "reset", "{}"
        case SetState(state, sd):
            return "set_state", json.dumps({"state": dict(state), "sd": dict(sd)})
        case Configure(text):
            return "configure", json.dumps({"text": text})


def read_command(kind: str, arguments: str) -> Command:
    """The command of a kind and its arguments as JSON; raises ``CommandError`` where that is none."""
    try:
        found: Any = json.loads(arguments)
    except (ValueError, RecursionError) as error:
        raise CommandError(f"{kind}: the arguments are not JSON") from error
    given = cast(dict[str, Any], found) if isinstance(found, dict) else {"": found}
    if kind == "reset" and not given:
        return Reset()
    if kind == "set_state" and {"state"} <= {*given} <= {"state", "sd"}:
        return SetState(_numbers(given["state"]), _numbers(given.get("sd", {})))
    if kind == "configure" and {*given} == {"text"} and isinstance(given["text"], str):
        return Configure(given["text"])
    raise CommandError(f"no such command: {kind!r} with {', '.join(map(repr, given)) or 'no arguments'}")


def _numbers(value: Any) -> dict[str, float]:
    numbers = cast(dict[str, Any], value) if isinstance(value, dict) else {"": value}
    for name, number in numbers.items():
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise CommandError(f"set_state: expected numbers by the name of a state, got {name!r}: {number!r}")
    return {name: float(number) for name, number in numbers.items()}
