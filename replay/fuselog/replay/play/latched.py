"""Latched topics: what is said once and holds from then on, and what of it holds at a moment of the log."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from fuselog.fusion.intake import TF_STATIC, same_topic
from fuselog.replay.log import Log
from fuselog.replay.log.channels import Channel
from fuselog.replay.play.played import Played, each
from fuselog.schemas import Columns, Fault, SchemaError, compile_codec, pack

_TRANSIENT_LOCAL = ("transient_local", 1, "1")
_FIRST_LOOK_NS = 10_000_000_000
_MOST_FRAMES = 256  # of one message; from there on it counts as one of its own


def is_latched(channel: Channel) -> bool:
    """Whether a publisher of the channel offered transient-local durability, or it holds static transforms."""
    return is_static(channel) or any(
        profile.get("durability") in _TRANSIENT_LOCAL
        for profile in _profiles(channel.metadata.get("offered_qos_profiles", ""))
    )


def is_static(channel: Channel) -> bool:
    """Whether it holds static transforms."""
    return same_topic(channel.topic).rpartition("/")[2] == same_topic(TF_STATIC)


def _profiles(text: str) -> list[dict[str, Any]]:
    """The QoS profiles as rosbag2 writes them; none when they cannot be read."""
    try:
        found: Any = YAML(typ="safe").load(text)  # pyright: ignore[reportUnknownMemberType]  its stubs have no types
    except YAMLError:
        return []
    return [cast(dict[str, Any], profile) for profile in _list(found) if isinstance(profile, dict)]


def _list(found: Any) -> list[Any]:
    return cast(list[Any], found) if isinstance(found, list) else []


def latched_before(log: Log, channels: Sequence[Channel], t_ns: int) -> list[Played]:
    """What holds at log time ``t_ns``: the newest earlier message of each of these latched channels, in log order.

    Of static transforms, the newest message for each set of child frames, for several nodes publish on the one topic.
    It looks back in growing spans, no further than it must.
    """
    wanted = {channel.id: channel for channel in channels}
    first = (log.time_range or (t_ns, t_ns))[0]
    spans: list[list[Played]] = []
    end, span = t_ns, _FIRST_LOOK_NS
    while wanted and end > first:
        start = max(end - span, first)
        spans.append(list(_last_of_batches(log, wanted, start, end)))
        for played in spans[-1]:
            if not is_static(played.channel):
                wanted.pop(played.channel.id, None)
        end, span = start, span * 4
    return newest([played for part in reversed(spans) for played in part])


def _last_of_batches(log: Log, wanted: Mapping[int, Channel], start: int, end: int) -> Iterator[Played]:
    """Of each batch, the last message of each channel, and all static transforms."""
    for batch in log.batches({channel.topic for channel in wanted.values()}, start_ns=start, end_ns=end):
        rows: list[int] = []
        for id, channel in wanted.items():
            mine = np.flatnonzero(batch.stream == id).tolist()
            rows += mine if is_static(channel) else mine[-1:]
        yield from each(batch.take(np.array(sorted(rows), np.int64)), wanted)


def newest(messages: Sequence[Played]) -> list[Played]:
    """Of messages in order, the last about each subject: a channel, or the child frames of static transforms."""
    last: dict[object, Played] = {}
    for played, subject in zip(messages, _subjects(messages), strict=True):
        last.pop(subject, None)
        last[subject] = played
    return list(last.values())


def _subjects(messages: Sequence[Played]) -> list[object]:
    subjects: list[object] = [played.channel.id for played in messages]
    rows: dict[int, list[int]] = {}
    for row, played in enumerate(messages):
        if is_static(played.channel):
            rows.setdefault(played.channel.id, []).append(row)
    for id, mine in rows.items():
        frames = _child_frames([messages[row] for row in mine])
        for row, names in zip(mine, frames, strict=True):
            subjects[row] = (id, names if names is not None else f"message {row}")
    return subjects


def _child_frames(messages: Sequence[Played]) -> list[tuple[str, ...] | None]:
    """The child frames of each message of one channel; None where they cannot be read, or are too many."""
    channel = messages[0].channel
    data, start, length = pack([played.payload for played in messages])

    def decode(fields: Sequence[str]) -> Columns:
        return compile_codec(**channel.message_type, fields=fields, stamp=None).decode(data, start, length)

    try:
        counted = decode(["transforms[]"])
        count = np.where(counted.fault == Fault.NONE, counted["transforms[]"], np.inf)
        known = count <= _MOST_FRAMES
        most = int(np.max(count, where=known, initial=0))
        names = [f"transforms[{i}].child_frame_id" for i in range(most)]
        texts = decode(names).texts if names else {}
    except SchemaError:
        return [None] * len(messages)
    return [
        tuple(texts[name][row] for name in names[: int(count[row])]) if known[row] else None
        for row in range(len(messages))
    ]
