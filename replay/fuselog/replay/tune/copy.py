"""A configuration's text with another gain section; all else, comments too, is as it was."""
# ruamel.yaml is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

import io
import re
from collections.abc import Mapping
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from fuselog.fusion.config import Source

# All that says what a gain is.
_REPLACED = ("form", "sum", "reference", "scales", "weights", "rates", "nominal", "open_loop", "cycle", "schedule")
_WIDE = 4096  # so that no line is broken that was not


def text_with_gain(source: Source, gain: Mapping[str, Any]) -> str:
    """The text with these settings under ``gain``; keys of it that say nothing of the gain's value stay.

    The lines of the section are replaced, or added before the sensors; a text in one pair of braces is written anew.
    """
    if source.tree.fa.flow_style():
        tree = _yaml().load(source.text)
        _set(tree.setdefault("gain", CommentedMap()), gain)
        return _dumped(tree)
    lines = source.text.splitlines(keepends=True)
    first, last = _lines_of_gain(source.tree, lines)
    head, old, rest = "".join(lines[:first]), "".join(lines[first:last]), "".join(lines[last:])
    return head + _section(old, gain, _indent(lines)) + rest


def _lines_of_gain(tree: CommentedMap, lines: list[str]) -> tuple[int, int]:
    """The first line of the section and the one after it; what stands before the next key belongs to that."""
    keys: dict[str, int] = {str(key): int(tree.lc.key(key)[0]) for key in tree}
    if "gain" in keys:
        first = keys["gain"]
        last = min((line for line in keys.values() if line > first), default=len(lines))
    else:
        first = last = keys["sensors"]
    while last > first + ("gain" in keys) and _is_between(lines[last - 1]):
        last -= 1
    if "gain" in keys:
        return first, last
    while first and _is_between(lines[first - 1]):
        first -= 1
    return first, first


def _is_between(line: str) -> bool:
    """Whether a line is empty, or a comment or marker of the outermost level."""
    return not line.strip() or line.startswith(("#", "---", "..."))


def _indent(lines: list[str]) -> int:
    """The width of the first indentation there is."""
    return next((len(found[1]) for line in lines if (found := re.match(r"( +)[^\s#-]", line))), 2)


def _section(old: str, gain: Mapping[str, Any], indent: int) -> str:
    tree = _yaml(indent).load(old) or CommentedMap()
    if not isinstance(tree.get("gain"), CommentedMap):
        tree["gain"] = CommentedMap()
    settings = tree["gain"]
    settings.fa.set_block_style()
    _set(settings, gain)
    text = _dumped(tree, indent)
    head, *rest = text.splitlines(keepends=True)
    there = _comments(text)
    kept = [f"{' ' * indent}{comment}\n" for comment in _comments(old) if comment not in there]
    return "".join([head, *kept, *rest])


def _set(settings: CommentedMap, gain: Mapping[str, Any]) -> None:
    for key in _REPLACED:
        if key not in gain:
            settings.pop(key, None)
    for key, value in gain.items():
        before = settings.get(key)
        settings[key] = _node(value, braced=isinstance(before, CommentedMap) and bool(before.fa.flow_style()))


def _node(value: Any, *, braced: bool = False) -> Any:
    """Maps in braces, but for those of maps, unless they were; whole numbers without a point."""
    if isinstance(value, list):
        listed = CommentedSeq(value)
        listed.fa.set_flow_style()
        return listed
    if not isinstance(value, Mapping):
        return int(value) if isinstance(value, float) and value.is_integer() else value
    node = CommentedMap({str(key): _node(inner) for key, inner in value.items()})
    if braced or not any(isinstance(inner, Mapping) for inner in value.values()):
        node.fa.set_flow_style()
    return node


def _comments(text: str) -> list[str]:
    return [found[1].rstrip() for line in text.splitlines() if (found := re.search(r"(?:^|\s)(#.*)", line))]


def _yaml(indent: int = 2) -> YAML:
    yaml = YAML()
    yaml.preserve_quotes, yaml.width = True, _WIDE
    yaml.indent(mapping=indent)
    return yaml


def _dumped(tree: CommentedMap, indent: int = 2) -> str:
    text = io.StringIO()
    _yaml(indent).dump(tree, text)
    return text.getvalue()
