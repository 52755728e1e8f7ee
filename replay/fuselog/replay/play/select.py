"""Which topics of logs are played, and under which names."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence

from fuselog.replay.channels import Channel
from fuselog.replay.log import Log
from fuselog.replay.play.timeline import CommandError
from fuselog.replay.tracks import is_output
from fuselog.schemas.errors import LogError


def playable(
    logs: Sequence[Log],
    *,
    topics: Collection[str] = (),
    regex: str | None = None,
    exclude: Collection[str] = (),
    exclude_regex: str | None = None,
) -> list[list[Channel]]:
    """Of each log the channels that a player publishes: inputs that ``topics`` or ``regex`` choose, all when there is
    neither, without what ``exclude`` or ``exclude_regex`` name. A pattern matches whole names.

    Results of an earlier run are never among them. Raises ``LogError`` for a topic that no log has, and for a pattern
    that chooses none, ``CommandError`` for one that is none.
    """
    known = dict.fromkeys(topic for log in logs for topic in log.topics)
    for topic in (*topics, *exclude):
        if topic not in known:
            raise _unknown(logs, f"no topic {topic!r}", known)
    wanted = {*topics, *_matching(logs, regex, known)} if topics or regex is not None else set(known)
    wanted -= {*exclude, *_matching(logs, exclude_regex, known)}
    return [[c for c in log.channels.values() if c.topic in wanted and not is_output(c)] for log in logs]


def _matching(logs: Sequence[Log], regex: str | None, known: Collection[str]) -> set[str]:
    if regex is None:
        return set()
    try:
        pattern = re.compile(regex)
    except re.error as error:
        raise CommandError(f"{regex!r} is no regular expression: {error}") from error
    found = {topic for topic in known if pattern.fullmatch(topic)}
    if not found:
        raise _unknown(logs, f"no topic matches {regex!r}", known)
    return found


def _unknown(logs: Sequence[Log], what: str, known: Collection[str]) -> LogError:
    return LogError(logs[0].path, 0, f"{what}; it has {', '.join(known) or 'none'}")


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
