"""Which topics of logs are played, and under which names."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence

from fuselog.replay.log import Log
from fuselog.replay.log.channels import Channel
from fuselog.replay.play.timeline import CommandError
from fuselog.replay.tracks import is_output
from fuselog.schemas.errors import LogError


def playable(
    log: Log,
    *,
    topics: Collection[str] = (),
    regex: str | None = None,
    exclude: Collection[str] = (),
    exclude_regex: str | None = None,
) -> list[Channel]:
    """The channels that a player publishes: inputs that ``topics`` or ``regex`` choose, all when there is neither,
    without what ``exclude`` or ``exclude_regex`` name. A pattern matches whole names.

    Results of an earlier run are never among them. Raises ``LogError`` for a topic that the log does not have, and for
    a pattern that chooses none, ``CommandError`` for one that is none.
    """
    known = log.topics
    for topic in (*topics, *exclude):
        if topic not in known:
            raise _unknown(log, f"no topic {topic!r}", known)
    wanted = {*topics, *_matching(log, regex, known)} if topics or regex is not None else set(known)
    wanted -= {*exclude, *_matching(log, exclude_regex, known)}
    return [c for c in log.channels.values() if c.topic in wanted and not is_output(c)]


def _matching(log: Log, regex: str | None, known: Collection[str]) -> set[str]:
    if regex is None:
        return set()
    try:
        pattern = re.compile(regex)
    except re.error as error:
        raise CommandError(f"{regex!r} is no regular expression: {error}") from error
    found = {topic for topic in known if pattern.fullmatch(topic)}
    if not found:
        raise _unknown(log, f"no topic matches {regex!r}", known)
    return found


def _unknown(log: Log, what: str, known: Collection[str]) -> LogError:
    return LogError(log.path, 0, f"{what}; it has {', '.join(known) or 'none'}")


def remap(channels: Iterable[Channel], rules: Sequence[str]) -> Mapping[str, str]:
    """By topic: the name under which it is played, after rules ``/old:=/new``.

    Raises ``CommandError`` for a rule of another form or for a topic that is not played, and when two topics would
    get one name.
    """
    names = {channel.topic: channel.topic for channel in channels}
    for rule in rules:
        old, separator, new = rule.partition(":=")
        if not (separator and old and new):
            raise CommandError(f"{rule!r} is no rule like /old:=/new")
        if old not in names:
            raise CommandError(f"{rule}: {old} is not played; played are {', '.join(names) or 'none'}")
        names[old] = new
    for old, new in names.items():
        other = next((topic for topic, name in names.items() if name == new and topic != old), None)
        if other is not None:
            raise CommandError(f"{old} and {other} would both be played as {new}")
    return names
