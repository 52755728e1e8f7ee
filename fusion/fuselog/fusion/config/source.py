"""A YAML file that remembers where each key stands, so that every problem can be pointed at."""
# ruamel.yaml is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from fuselog.fusion.config.settings import Config, Settings
from fuselog.schemas.errors import ConfigError

Place = tuple[str | int, ...]
_PASSES = 4  # over a configuration, each without what the one before found wrong


@dataclass(frozen=True, slots=True)
class Problem:
    """Something wrong at a place of the configuration."""

    place: Place
    reason: str


@dataclass(frozen=True, slots=True)
class Source:
    """A configuration as it was written: its name and text, and the tree that knows lines and columns."""

    name: str
    text: str
    tree: Any

    def complain(self, problems: Iterable[Problem]) -> ConfigError:
        """One error of all problems, each as ``file:line:col: key: reason``, in the order of the file."""
        lines = sorted({(*self._position(p.place), f"{_dotted(p.place)}{p.reason}") for p in problems})
        return ConfigError([f"{self.name}:{line}:{column}: {text}" for line, column, text in lines])

    def _position(self, place: Place) -> tuple[int, int]:
        """Line and column, from 1, of the deepest key of ``place`` that is in the file."""
        node, line, column = self.tree, 1, 1
        for key in place:
            if isinstance(node, CommentedMap) and key in node:
                line, column = (int(n) + 1 for n in node.lc.key(key))
            elif isinstance(node, CommentedSeq) and isinstance(key, int) and key < len(node):
                line, column = (int(n) + 1 for n in node.lc.item(key))
            else:
                break
            node = node[key]
        return line, column


def load_config(path: str | Path) -> tuple[Config, Source]:
    """Read and validate a configuration file; raises ``ConfigError`` that lists every problem at its place."""
    return _strictly(read_source(path))


def parse_config(text: str, *, name: str = "configuration") -> tuple[Config, Source]:
    """The same for a text that is already here."""
    return _strictly(_parse(text, name))


def read_source(path: str | Path) -> Source:
    """A configuration file as it is written; raises ``ConfigError`` when it is not YAML."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "is not UTF-8 text"
        raise ConfigError([f"{path}: {reason}"]) from error
    return _parse(text, str(path))


def validate(source: Source) -> tuple[Config | None, list[Problem]]:
    """The configuration without the keys that are wrong, None when that leaves none; and everything wrong with it."""
    data, problems = _plain(source.tree), dict[Place, Problem]()
    for _ in range(_PASSES):
        try:
            return Config.model_validate(data), list(problems.values())
        except ValidationError as error:
            found = [_problem(details) for details in error.errors()]
            places = [problem.place for problem in found]
            for problem in found:
                # Of a union, the branch that was meant; and no complaint of what was taken out before.
                if not any(_under(place, problem.place) for place in (*places, *problems)):
                    problems.setdefault(problem.place, problem)
            for place in places:
                _drop(data, place)
    return None, list(problems.values())


def _strictly(source: Source) -> tuple[Config, Source]:
    config, problems = validate(source)
    if config is None or problems:
        raise source.complain(problems)
    return config, source


def _parse(text: str, name: str) -> Source:
    try:
        tree: Any = YAML().load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark
        line, column = (mark.line + 1, mark.column + 1) if mark is not None else (1, 1)
        raise ConfigError([f"{name}:{line}:{column}: {error.problem}"]) from error
    except (YAMLError, ValueError, RecursionError) as error:
        reason = "is nested too deeply" if isinstance(error, RecursionError) else str(error).partition("\n")[0]
        raise ConfigError([f"{name}:1:1: {reason}"]) from error
    source = Source(name, text, tree)
    if not isinstance(tree, CommentedMap):
        raise source.complain([Problem((), "expected keys such as fuselog, model and sensors")])
    return source


def _under(place: Place, other: Place) -> bool:
    return len(place) > len(other) and place[: len(other)] == other


def _drop(data: Any, place: Place) -> None:
    """Take out the deepest key on the way to ``place`` that is there, so that the rest can still be looked at."""
    node, found = data, (data, place[0])
    for key in place:
        if not isinstance(node, dict) or key not in node:
            break
        found, node = (node, key), node[key]
    found[0].pop(found[1], None)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """`` (did you mean ...?)``, or what there is when nothing is near."""
    known = list(dict.fromkeys(known))
    near = get_close_matches(word, known, n=1, cutoff=0.6)
    if near:
        return f" (did you mean {near[0]}?)"
    return f" (known: {', '.join(known)})" if known else ""


def _problem(details: ErrorDetails) -> Problem:
    place = tuple(key for key in details["loc"] if not _is_branch(key))
    if details["type"] == "extra_forbidden":
        return Problem(place, f"unknown key{did_you_mean(str(place[-1]), _keys(place[:-1]))}")
    if details["type"] == "missing":
        return Problem(place, "is required")
    reason = details["msg"].removeprefix("Value error, ")
    return Problem(place, f"{reason[0].lower()}{reason[1:]}, got {details['input']!r}")


def _is_branch(key: str | int) -> bool:
    """Whether a part of a place only says which type of several was tried."""
    return isinstance(key, str) and (key in ("MountSettings", "constrained-float") or key.startswith("literal["))


def _keys(place: Place) -> Sequence[str]:
    """The keys that the settings at ``place`` have."""
    settings: Any = Config
    for key in place:
        if isinstance(settings, type) and issubclass(settings, Settings):
            field = next((f for n, f in settings.model_fields.items() if key in (n, f.alias)), None)
            settings = field.annotation if field is not None else None
        else:
            settings = next((a for a in getattr(settings, "__args__", ()) if _is_settings(a)), None)
    found = next((a for a in (settings, *getattr(settings, "__args__", ())) if _is_settings(a)), None)
    return [f.alias or n for n, f in found.model_fields.items()] if found is not None else []


def _is_settings(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Settings)


def _plain(node: Any) -> Any:
    """The tree without ruamel's types, which pydantic takes for objects."""
    if isinstance(node, CommentedMap):
        return {str(key): _plain(value) for key, value in node.items()}
    if isinstance(node, CommentedSeq):
        return [_plain(value) for value in node]
    if isinstance(node, bool):
        return bool(node)
    for kind in (int, float, str):
        if isinstance(node, kind):
            return kind(node)
    return node


def _dotted(place: Place) -> str:
    return ".".join(str(key) for key in place) + ": " if place else ""
