"""Dataclasses of figures as JSON, and as the models that describe it: a new figure shows without a line here."""

import math
import types
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Any, Literal, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import BaseModel, create_model

Number = float | None  # JSON has neither NaN nor infinity

_AS_THEY_ARE = (str, int, bool, type(None))


def plain(value: Any) -> Any:
    """A value as dictionaries, lists, text and numbers; None for numbers that are not finite."""
    kind = cast(type[Any], type(value))  # pyright: ignore[reportUnnecessaryCast]  of anything
    if kind in _AS_THEY_ARE:
        return value
    if kind is float:
        return value if math.isfinite(value) else None
    names = _names(kind)
    if names:
        return {name: plain(getattr(value, name)) for name in names}
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]  data of any shape
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, Sequence | set | frozenset) and not isinstance(value, str):
        return [plain(each) for each in value]  # pyright: ignore[reportUnknownVariableType]  the same
    return str(value)


@cache
def model_of(kind: type) -> type[BaseModel]:
    """The model of what ``plain`` makes of a dataclass or named tuple: its fields and its properties."""
    hints = get_type_hints(kind)
    for name in _properties(kind):
        hints[name] = get_type_hints(getattr(kind, name).fget)["return"]
    members: dict[str, Any] = {name: (_type(hints[name]), ...) for name in _names(kind)}
    return create_model(kind.__name__, __doc__=kind.__doc__, __module__=kind.__module__, **members)


def by_name(model: type[BaseModel]) -> Any:
    """The type of a mapping to these."""
    return dict[str, _as_type(model)]


def many(model: type[BaseModel]) -> Any:
    """The type of a list of these."""
    return list[_as_type(model)]


def _as_type(model: type[BaseModel]) -> Any:
    """A model that is made at run time, for an annotation."""
    return model


@cache
def _names(kind: type[Any]) -> tuple[str, ...]:
    """What is in a dataclass or named tuple, and what it says of itself; none of another type."""
    all_fields: tuple[str, ...] = getattr(kind, "_fields", ())
    own = tuple(field.name for field in fields(kind)) if is_dataclass(kind) else all_fields
    return (*own, *_properties(kind)) if own else ()


def _properties(kind: type[Any]) -> tuple[str, ...]:
    return tuple(name for name, each in vars(kind).items() if isinstance(each, property) and not name.startswith("_"))


def _type(hint: Any) -> Any:
    """What ``plain`` makes of a value of this type."""
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is float:
        return Number
    if isinstance(hint, type) and _names(hint):
        return model_of(hint)
    if hint in (int, bool, str, type(None)) or origin is Literal:
        return hint
    if origin in (Union, types.UnionType):
        return Union[tuple(_type(each) for each in arguments)]  # noqa: UP007  of a number of types known only here
    if isinstance(hint, type) and issubclass(hint, Enum):
        return str
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return dict[str, _type(arguments[1])]
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return list[_type(arguments[0])] if len(set(arguments) - {...}) == 1 else list[Any]
    return Any
