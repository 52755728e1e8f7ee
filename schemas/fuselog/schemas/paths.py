"""Field paths such as ``pose.covariance[0]``: taken apart, looked up in a tree, expanded to leaves."""

import re
from collections.abc import Iterator
from difflib import get_close_matches
from itertools import islice
from typing import Final, TypeAlias

from fuselog.schemas.errors import SchemaError
from fuselog.schemas.tree import Array, Node, Number, Open, Record, Text, is_time, kind_of, time_parts

Path: TypeAlias = tuple[str | int, ...]
Leaf: TypeAlias = tuple[Path, Number | Text | Open]

COUNT: Final = -1  # the token of `[]`, the number of elements
_TOKEN: Final = re.compile(r"\.?([^\W\d][\w-]*)|\[(\d{0,9})\]")
_PATH: Final = re.compile(r"[^\W\d][\w-]*(\.[^\W\d][\w-]*|\[\d{0,9}\])*")
_STAMPS: Final = ("stamp_ns", "timestamp_ns", "time_ns", "t_ns", "stamp", "timestamp")
_WIDEST: Final = 100_000  # columns of one path
_MOST_LISTED: Final = 10_000


def split_path(schema: str, text: str) -> Path:
    """The tokens of a path: ``a.b[2]`` is ``("a", "b", 2)``, ``a[]`` is ``("a", COUNT)``."""
    if _PATH.fullmatch(text) is None:
        raise SchemaError(schema, f"not a field path: {text!r} (like header.stamp, covariance[0], transforms[])")
    return tuple(name or (int(index) if index else COUNT) for name, index in _TOKEN.findall(text))


def join_path(path: Path) -> str:
    """The text of a path."""
    parts = (f".{token}" if isinstance(token, str) else f"[{'' if token < 0 else token}]" for token in path)
    return "".join(parts).removeprefix(".")


def find_node(schema: str, root: Node, path: Path) -> Node:
    """The node at ``path``; SchemaError names the closest paths there are when it does not exist."""
    node = root
    for depth, token in enumerate(path):
        match node, token:
            case Open(), _:
                return Number("uint32") if path[-1] == COUNT else node
            case Record(_, fields), str() if token in fields:
                node = fields[token]
            case Array(_, None), int() if token == COUNT and depth == len(path) - 1:
                return Number("uint32")
            case Array(element, length), int() if token >= 0 and (length is None or token < length):
                node = element
            case _:
                raise SchemaError(schema, _unknown(root, path, depth, node))
    return node


def expand(schema: str, root: Node, path: Path) -> list[Leaf]:
    """The leaf at ``path``, or all leaves of a numeric submessage or fixed array, in order."""
    node = find_node(schema, root, path)
    if isinstance(node, Number | Text | Open):
        return [(path, node)]
    leaves: list[Leaf] = []
    for leaf, below in _leaves(path, node):
        if not isinstance(below, Number | Open) or len(leaves) >= _WIDEST:
            raise SchemaError(schema, _not_numeric(path, leaf, below))
        leaves.append((leaf, below))
    return leaves


def stamp_leaves(schema: str, root: Node, path: Path) -> list[tuple[Path, int]]:
    """Leaves that add up to the stamp in ns, each with its factor: seconds 10^9, nanoseconds 1."""
    node = find_node(schema, root, path)
    parts = time_parts(node.fields) if isinstance(node, Record) and is_time(node) else None
    if parts is not None:
        return [((*path, parts[0]), 1_000_000_000), ((*path, parts[1]), 1)]
    if _is_stamp(node) and isinstance(path[-1], str):
        return [(path, 1)]
    reason = f"{join_path(path)} is {kind_of(node)}, not a stamp (a builtin_interfaces/Time or 64-bit ns)"
    raise SchemaError(schema, reason)


def guess_stamp(root: Node) -> str | None:
    """``header.stamp`` if there, else a top-level field named like a stamp, else None."""
    fields = root.fields if isinstance(root, Record) else {}
    header = fields.get("header")
    if isinstance(header, Record) and _is_stamp(header.fields.get("stamp", Open())):
        return "header.stamp"
    return next((name for name in _STAMPS if name in fields and _is_stamp(fields[name])), None)


def list_paths(root: Node) -> dict[str, str]:
    """Every path that can be asked for, with its kind.

    Fixed numeric arrays stand as a whole (``covariance: float64[36]``); of other arrays the count and the
    paths of element 0 stand for all.
    """
    return {join_path(path): kind for path, kind in islice(_listed((), root), _MOST_LISTED)}


def _listed(path: Path, node: Node) -> Iterator[tuple[Path, str]]:
    match node:
        case Record(_, fields):
            for name, child in fields.items():
                yield from _listed((*path, name), child)
        case Array(element, length) if length is None or not isinstance(element, Number):
            if length is None:
                yield (*path, COUNT), "uint32"
            yield from _listed((*path, 0), element)
        case _:
            if path:
                yield path, kind_of(node)


def _leaves(path: Path, node: Node) -> Iterator[tuple[Path, Node]]:
    match node:
        case Record(_, fields):
            for name, child in fields.items():
                yield from _leaves((*path, name), child)
        case Array(element, int(length)):
            for index in range(length):
                yield from _leaves((*path, index), element)
        case _:
            yield path, node


def _is_stamp(node: Node) -> bool:
    return is_time(node) or node in (Number("int64"), Number("uint64"))


def _not_numeric(path: Path, leaf: Path, node: Node) -> str:
    if isinstance(node, Number | Open):
        return f"{join_path(path)} has more than {_WIDEST} numbers"
    if path == leaf:
        ask = f"ask for elements ({join_path((*path, 0))}) or the count ({join_path((*path, COUNT))})"
        return f"{join_path(path)} is {kind_of(node)}: its length is known only from the data; {ask}"
    return f"{join_path(path)} is not all numbers: {join_path(leaf)} is {kind_of(node)}"


def _unknown(root: Node, path: Path, depth: int, node: Node) -> str:
    wanted = join_path(path)
    leaves = [leaf for leaf, _ in islice(_listed((), root), _MOST_LISTED)]
    known = dict.fromkeys(join_path(leaf[:end]) for leaf in leaves for end in range(1, len(leaf) + 1))
    matches = get_close_matches(wanted, known, n=3, cutoff=0.7)
    hint = f"; did you mean {', '.join(matches)}?" if matches else ""
    where = join_path(path[:depth]) or kind_of(root)
    if isinstance(node, Record):
        return f"no field {wanted}: {where} has {', '.join(node.fields)}{hint}"
    return f"no field {wanted}: {where} is {kind_of(node)}{hint}"
