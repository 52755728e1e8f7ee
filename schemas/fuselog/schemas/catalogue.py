"""The message definitions that come with fuselog, as the texts that logs embed."""

from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable

from fuselog.schemas.errors import SchemaError
from fuselog.schemas.ros2msg import short_name, types_used

_SEPARATOR = "=" * 80


@cache
def definition(name: str) -> str:
    """The text of ``pkg/msg/Type`` with all definitions it needs, in MCAP's ``ros2msg`` convention.

    Raises SchemaError for a type that is not among ``known_definitions()``.
    """
    root = short_name(name)
    if root not in map(short_name, known_definitions()):
        raise SchemaError(name, _unknown(name))
    texts: dict[str, str] = {}
    _collect(root, texts)
    first, *others = texts.items()
    return first[1] + "".join(f"{_SEPARATOR}\nMSG: {other}\n{text}" for other, text in others)


@cache
def known_definitions() -> tuple[str, ...]:
    """The types that ``definition`` knows, ``pkg/msg/Type``, sorted."""
    packages = (package for package in _folder().iterdir() if package.is_dir())
    return tuple(
        sorted(
            f"{package.name}/msg/{file.name.removesuffix('.msg')}"
            for package in packages
            for file in (package / "msg").iterdir()
            if file.name.endswith(".msg")
        )
    )


def _folder() -> Traversable:
    return files("fuselog.schemas") / "definitions"


def _collect(name: str, texts: dict[str, str]) -> None:
    """Put ``name`` and what it needs into ``texts``, each once, a type before what it needs."""
    package, _, kind = name.partition("/")
    texts[name] = (_folder() / package / "msg" / f"{kind}.msg").read_text(encoding="utf-8")
    for used in types_used(name, texts[name]):
        if used not in texts:
            _collect(used, texts)


def _unknown(name: str) -> str:
    known = known_definitions()
    matches = get_close_matches(name, known, n=3)
    hint = f"did you mean {', '.join(matches)}?" if matches else f"there are {', '.join(known)}"
    return f"not a definition that comes with fuselog; {hint}"
