"""The text of a configuration, as it is shown and as it is changed while the service runs."""
# ruamel.yaml is partly typed.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

import io
import re
from collections.abc import Callable, Iterator
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.error import YAMLError

from fuselog.fusion import Config
from fuselog.fusion.config import GainSettings, Source
from fuselog.replay.tune.copy import text_with_gain

MASK = "***"
_SECRET = re.compile(r"password|passwd|secret|credential|private", re.IGNORECASE)
_PATHS = re.compile(r"_(file|env)$")  # keys that name where a secret is
_IN_URL = re.compile(r"(/[^/\s:@\"']+:)[^/\s@\"']+@")  # tcp/NAME:SECRET@HOST too
_KEPT_UNLESS_GIVEN = ("mode", "covariance", "reacquire")  # by text_with_gain


def with_gain(source: Source, gain: GainSettings) -> str:
    """The text with this section ``gain`` in place of its own; comments stay."""
    given: dict[str, Any] = gain.model_dump(mode="json", by_alias=True, exclude_unset=True)
    before = source.tree.get("gain")
    for key in _KEPT_UNLESS_GIVEN:
        if isinstance(before, CommentedMap) and key in before:
            given.setdefault(key, GainSettings.model_fields[key].default)
    try:
        return text_with_gain(source, given)
    except YAMLError:  # a section that refers to anchors elsewhere cannot be written by itself
        return _edited(source.text, lambda tree: tree.__setitem__("gain", given))


def with_enabled(source: Source, sensor: str, *, enabled: bool) -> str:
    """The text with a sensor switched on or off."""
    return _edited(source.text, lambda tree: tree["sensors"][sensor].__setitem__("enabled", enabled))


def shown_text(source: Source) -> str:
    """The text as it is, but for secrets."""
    secrets = {str(value) for value in _secrets(source.tree) if value is not None and str(value)}
    text = _edited(source.text, _mask) if secrets else source.text
    for secret in sorted(secrets, key=len, reverse=True):
        text = text.replace(secret, MASK)  # in a comment, or behind an anchor
    return _IN_URL.sub(rf"\1{MASK}@", text)


def shown_config(config: Config) -> dict[str, Any]:
    """The configuration with all defaults, but for secrets."""
    tree: dict[str, Any] = config.model_dump(mode="json", by_alias=True)
    _mask(tree)
    return _without_urls(tree)


def _edited(text: str, change: Callable[[Any], object]) -> str:
    yaml = YAML()
    yaml.preserve_quotes, yaml.width = True, 4096
    tree = yaml.load(text)
    change(tree)
    written = io.StringIO()
    yaml.dump(tree, written)
    return written.getvalue()


def _is_secret(key: Any) -> bool:
    return bool(_SECRET.search(str(key))) and not _PATHS.search(str(key))


def _secrets(node: Any) -> Iterator[Any]:
    """The values of secret keys, at any depth."""
    if isinstance(node, dict):
        for key, value in node.items():
            if _is_secret(key) and not isinstance(value, dict | list):
                yield value
            else:
                yield from _secrets(value)
    elif isinstance(node, list):
        for value in node:
            yield from _secrets(value)


def _mask(node: Any) -> None:
    if isinstance(node, dict):
        for key, value in node.items():
            if _is_secret(key) and not isinstance(value, dict | list):
                node[key] = None if value is None else MASK
            else:
                _mask(value)
    elif isinstance(node, list):
        for value in node:
            _mask(value)


def _without_urls(node: Any) -> Any:
    if isinstance(node, dict):
        return {key: _without_urls(value) for key, value in node.items()}
    if isinstance(node, list):
        return [_without_urls(value) for value in node]
    return _IN_URL.sub(rf"\1{MASK}@", node) if isinstance(node, str) else node
