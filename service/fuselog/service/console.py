"""What people see: progress on stderr when it is a terminal, results on stdout."""

import sys
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any, Protocol, cast

import orjson
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

stderr = Console(stderr=True, highlight=False, soft_wrap=True)


class Advance(Protocol):
    """Says how far the work is."""

    def __call__(self, done: float, total: float) -> None:
        """``done`` of ``total``, in any unit."""
        ...


@contextmanager
def progress(title: str) -> Generator[Advance]:
    """A bar called ``title`` while the block runs; nothing at all when stderr is not a terminal."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=stderr, disable=not stderr.is_terminal, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def print_json(result: dict[str, Any]) -> None:
    """One object on stdout. NaN and infinity become null, for JSON has neither; names that are no text are escaped."""
    try:
        text = orjson.dumps(result, option=orjson.OPT_SERIALIZE_NUMPY)
    except orjson.JSONEncodeError:
        text = orjson.dumps(_encodable(result), option=orjson.OPT_SERIALIZE_NUMPY)
    sys.stdout.buffer.write(text + b"\n")
    sys.stdout.buffer.flush()


def printable(text: str) -> str:
    """The text with what would move a terminal, or is no character, escaped: what a log or a file is called."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _encodable(value: Any) -> Any:
    match value:
        case str():
            return value.encode("utf-8", "backslashreplace").decode()
        case dict():
            return {_encodable(key): _encodable(item) for key, item in cast(dict[Any, Any], value).items()}
        case list() | tuple():
            return [_encodable(item) for item in cast(list[Any], value)]
        case _:
            return value
