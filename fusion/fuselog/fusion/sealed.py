"""A tree of plain values and arrays as bytes that say what they are of, and whether they are whole.

    magic 8 | format uint32 | length of the JSON uint64 | JSON | arrays, one after the other | SHA-256 of all before

All little endian. The JSON has what the tree is about, the tree with ``{"#": n}`` in the place of array n, and the type
and shape of each array.
"""

import hashlib
import json
import struct
from collections.abc import Mapping
from math import prod
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas import FuselogError

Tree = dict[str, Any]  # of str, int, float, bool, None, arrays, and lists and trees of these

_MAGIC, _FORMAT = b"fuselog\x1a", 1
_HEAD = struct.Struct("<8sIQ")
_DIGEST = 32  # bytes
_TYPES = ("<f8", "<i8", "<i4", "|u1")


class CheckpointError(FuselogError):
    """A checkpoint that cannot be used, and why."""

    def __init__(self, reason: str) -> None:
        super().__init__(f"the checkpoint {reason}")


def seal(about: Mapping[str, str], tree: Tree) -> bytes:
    """The bytes of a tree; whoever unseals them must say the same of them."""
    arrays: list[NDArray[np.generic]] = []
    plain = _without_arrays(tree, arrays)
    kinds = [[array.dtype.str, list(array.shape)] for array in arrays]
    text = json.dumps({"about": dict(about), "tree": plain, "arrays": kinds}, separators=(",", ":")).encode()
    parts = [_HEAD.pack(_MAGIC, _FORMAT, len(text)), text, *(array.tobytes() for array in arrays)]
    body = b"".join(parts)
    return body + hashlib.sha256(body).digest()


def unseal(data: bytes, about: Mapping[str, str]) -> Tree:
    """The tree of ``seal``; raises ``CheckpointError`` for bytes that are not whole, or about something else."""
    if data[: len(_MAGIC)] != _MAGIC:
        raise CheckpointError("is none: it does not begin as one")
    if len(data) < _HEAD.size + _DIGEST:
        raise CheckpointError("is cut short")
    _, form, length = _HEAD.unpack_from(data)
    if form != _FORMAT:
        raise CheckpointError(f"is of format {form}, and this is {_FORMAT}")
    body = memoryview(data)[:-_DIGEST]
    if hashlib.sha256(body).digest() != data[-_DIGEST:]:
        raise CheckpointError("is damaged or cut short: its checksum does not hold")
    try:
        told = json.loads(bytes(body[_HEAD.size : _HEAD.size + length]))
        found, tree, kinds = told["about"], told["tree"], told["arrays"]
        arrays = _arrays(kinds, body[_HEAD.size + length :])
        whole = _with_arrays(tree, arrays)
    except (ValueError, TypeError, LookupError, RecursionError) as error:
        raise CheckpointError("is not written as this version writes them") from error
    for key, expected in about.items():
        if found.get(key) != expected:
            raise CheckpointError(f"is of another {key}: {found.get(key)}, and this is {expected}")
    return cast(Tree, whole)


def _arrays(kinds: list[tuple[str, list[int]]], body: memoryview) -> list[NDArray[Any]]:
    """The arrays that lie one after the other in ``body``, as copies."""
    arrays, at = list[NDArray[Any]](), 0
    for kind, shape in kinds:
        if kind not in _TYPES or min(shape, default=0) < 0:
            raise ValueError(f"array of {kind} {shape}")
        size = prod(shape) * np.dtype(kind).itemsize
        if size > len(body) - at:
            raise ValueError("array beyond the end")
        arrays.append(np.frombuffer(body[at : at + size], kind).reshape(shape).copy())
        at += size
    return arrays


def _without_arrays(value: Any, arrays: list[NDArray[np.generic]]) -> Any:
    if isinstance(value, np.ndarray):
        arrays.append(cast(NDArray[np.generic], value))
        return {"#": len(arrays) - 1}
    if isinstance(value, dict):
        return {key: _without_arrays(each, arrays) for key, each in cast(Tree, value).items()}
    if isinstance(value, list | tuple):
        return [_without_arrays(each, arrays) for each in cast(list[Any], value)]
    return value


def _with_arrays(value: Any, arrays: list[NDArray[Any]]) -> Any:
    if isinstance(value, dict):
        tree = cast(Tree, value)
        if "#" in tree:
            return arrays[int(tree["#"])]
        return {key: _with_arrays(each, arrays) for key, each in tree.items()}
    if isinstance(value, list):
        return [_with_arrays(each, arrays) for each in cast(list[Any], value)]
    return value
