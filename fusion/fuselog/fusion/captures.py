"""Topics that stand for many keys: ``fleet/{robot}/imu`` is one key for each robot."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from fuselog.fusion.config import Problem, parse_config
from fuselog.fusion.intake import Intake, same_topic
from fuselog.fusion.plan import Plan, compile_plan
from fuselog.schemas import ConfigError

_CAPTURE = re.compile(r"\{([a-z_][a-z0-9_]*)\}")
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
DEFAULT_ID = "filter"

Captures = tuple[tuple[str, str], ...]  # (name, what stands for it), in the order of the names


@dataclass(frozen=True)
class KeyPattern:
    """A topic of the configuration as keys of Zenoh. A capture stands for a part of one chunk of a key."""

    topic: str

    @cached_property
    def expression(self) -> str:
        """All its keys, in Zenoh's own form."""
        chunks = same_topic(self.topic).split("/")
        return "/".join("*" if _CAPTURE.fullmatch(chunk) else _CAPTURE.sub("$*", chunk) for chunk in chunks)

    @property
    def key(self) -> str:
        """The one key; empty where there are captures."""
        return "" if self.names else self.expression

    @property
    def names(self) -> tuple[str, ...]:
        """The captures, in the order of the names."""
        return tuple(sorted(set(_CAPTURE.findall(self.topic))))

    def match(self, key: str) -> Captures | None:
        """What stands for the captures in a key; None for a key that is no such one, or has an unusable name."""
        match = self._regex.fullmatch(key)
        if match is None or any(_NAME.fullmatch(name) is None for name in match.groups()):
            return None
        return tuple(sorted(match.groupdict().items()))

    @cached_property
    def _regex(self) -> re.Pattern[str]:
        text, seen = "", set[str]()
        for number, part in enumerate(_CAPTURE.split(same_topic(self.topic))):  # plain, name, plain, name, ...
            if number % 2 == 0:
                text += re.escape(part)
            else:
                text += f"(?P={part})" if part in seen else f"(?P<{part}>[^/]+)"
                seen.add(part)
        return re.compile(text)


def captured(texts: Iterable[str]) -> tuple[str, ...]:
    """The names of all captures in these texts."""
    return tuple(sorted({name for text in texts for name in _CAPTURE.findall(text)}))


def fill(text: str, captures: Captures) -> str:
    """A text with what stands for its captures."""
    values: Mapping[str, str] = dict(captures)
    return _CAPTURE.sub(lambda match: values.get(match[1], match[0]), text)


def patterns_of(plan: Plan) -> tuple[KeyPattern, ...]:
    """The topics that its filters read."""
    return tuple(KeyPattern(topic) for topic in Intake(plan).topics)


def plan_of(plan: Plan, captures: Captures) -> Plan:
    """The plan of one filter of those that ``plan`` makes; itself where nothing is captured."""
    if not captures:
        return plan
    one = compile_plan(*parse_config(fill(plan.source.text, captures), name=plan.source.name))
    return replace(one, config=one.config.model_copy(update={"id": id_of(plan, captures)}))


def id_of(plan: Plan, captures: Captures) -> str:
    """What such a filter is called: as its configuration says, by its names where that says nothing."""
    given = plan.config.id
    if captures and given == DEFAULT_ID:
        return "-".join(name for _, name in captures)
    return fill(given, captures)


def captures_of(plan: Plan) -> tuple[str, ...]:
    """The names that its topics capture; none where it is one filter."""
    return captured(pattern.topic for pattern in patterns_of(plan))


def require_none(plan: Plan) -> None:
    """Raise ``ConfigError`` where topics capture names: it is no single filter."""
    places = ((("sensors", sensor.name, "topic"), captured([sensor.settings.topic])) for sensor in plan.sensors)
    reason = "stands for many names, each with a filter of its own; write one name in its place"
    problems = [Problem(place, f"{{{names[0]}}} {reason}") for place, names in places if names]
    if problems:
        raise plan.source.complain(problems)


def chosen(plan: Plan, topics: Iterable[str], only: Sequence[str]) -> list[Captures]:
    """The filters that ``plan`` makes of the topics of a log; ``only``: the one with these ``NAME=VALUE``.

    Raises ``ConfigError`` for names that no topic captures, for some of them without the others, and where the topics
    have none.
    """
    names = captures_of(plan)
    if only:
        given = tuple(sorted((name, value) for name, _, value in (each.partition("=") for each in only)))
        if tuple(name for name, _ in given) != names or any(_NAME.fullmatch(value) is None for _, value in given):
            wanted = " ".join(f"--only {name}=VALUE" for name in names) or "no topic captures a name: leave --only out"
            raise ConfigError([f"{plan.source.name}: {wanted}"])
        return [given]
    if not names:
        return [()]
    patterns = [pattern for pattern in patterns_of(plan) if pattern.names]
    found = {match for topic in topics for p in patterns if (match := p.match(same_topic(topic))) is not None}
    if not found:
        raise ConfigError([f"{plan.source.name}: no topic of the log is as {patterns[0].topic}"])
    return sorted(found)


class ByPattern(Mapping[str, str]):
    """What the configuration says of a topic, for every key of it."""

    def __init__(self, of: Mapping[str, str]) -> None:
        self._of = [(KeyPattern(topic), said) for topic, said in of.items()]

    def __getitem__(self, key: str) -> str:
        for pattern, said in self._of:
            if pattern.match(key) is not None:
                return said
        raise KeyError(key)

    def __iter__(self) -> Iterator[str]:
        return (pattern.expression for pattern, _ in self._of)

    def __len__(self) -> int:
        return len(self._of)
