"""The options of commands that read logs of anyone: how much a log may ask of the memory."""

import inspect
import re
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any

import typer

_UNITS = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30}
_SIZE = re.compile(r"(\d{1,15})\s*([kmg]?)(i?b)?", re.IGNORECASE)


def read_size(text: str) -> int:
    """Bytes of a text such as ``64MiB``, ``256k`` or ``1000``; units are powers of 1024."""
    match = _SIZE.fullmatch(text.strip())
    if match is None or not int(match[1]):
        raise typer.BadParameter(f"not a size: {text!r} (like 64MiB)")
    return int(match[1]) * _UNITS[match[2].lower()]


_OPTIONS = {
    "chunk_bytes": Annotated[
        int | None,
        typer.Option("--max-chunk", parser=read_size, metavar="SIZE", help="Of a chunk, unpacked. Default 64MiB."),
    ],
    "ratio": Annotated[
        int | None, typer.Option("--max-ratio", min=1, help="Of unpacked to packed chunks. Default 200.")
    ],
    "record_bytes": Annotated[
        int | None,
        typer.Option("--max-record", parser=read_size, metavar="SIZE", help="Of one record. Default 256MiB."),
    ],
    "channels": Annotated[int | None, typer.Option("--max-channels", min=1, help="Of the log. Default 4096.")],
}


def with_limits(command: Callable[..., None]) -> Callable[..., None]:
    """The command with these options in place of its argument ``limits``, a `fuselog.replay.Limits`."""

    @wraps(command)
    def run(**options: Any) -> None:
        from fuselog.replay.mcap_file.decompress import Limits  # noqa: PLC0415  slow to import

        given = {name: options.pop(name) for name in _OPTIONS}
        command(**options, limits=Limits(**{name: value for name, value in given.items() if value is not None}))

    own = [p for p in inspect.signature(command).parameters.values() if p.name != "limits"]
    kind = inspect.Parameter.KEYWORD_ONLY
    more = [inspect.Parameter(name, kind, default=None, annotation=hint) for name, hint in _OPTIONS.items()]
    run.__annotations__ = {p.name: p.annotation for p in (*own, *more)}
    run.__signature__ = inspect.Signature([*own, *more])  # pyright: ignore[reportAttributeAccessIssue]  typer reads it
    return run
