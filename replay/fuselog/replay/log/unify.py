"""One numbering of channels for several files."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from fuselog.replay.log.channels import Channel, Schema

Numbers = Mapping[int, int]  # number in the file: number in the log


def unify(files: Sequence[Mapping[int, Channel]]) -> tuple[dict[int, Channel], list[Numbers]]:
    """(the channels of all files by number, for each file its numbers).

    The k-th channel of one topic, type and encoding is one channel in all files, with the metadata of the first; what
    differs in any of these stays apart. A single file keeps its numbers.
    """
    if len(files) == 1:
        return dict(files[0]), [{id: id for id in files[0]}]
    known: dict[tuple[str, str, Schema, int], int] = {}
    channels: dict[int, Channel] = {}
    numbers: list[Numbers] = []
    for file in files:
        mine: dict[int, int] = {}
        met: dict[tuple[str, str, Schema], int] = {}
        for channel in file.values():
            kind = (channel.topic, channel.encoding, channel.schema)
            met[kind] = met.get(kind, 0) + 1
            number = known.setdefault((*kind, met[kind]), len(known) + 1)
            mine[channel.id] = number
            before = channels.get(number)
            channels[number] = replace(channel, id=number) if before is None else _counted(before, channel)
        numbers.append(mine)
    return channels, numbers


def _counted(channel: Channel, more: Channel) -> Channel:
    """The channel with the messages of both, when both are known."""
    if channel.count is None or more.count is None:
        return replace(channel, count=None)
    return replace(channel, count=channel.count + more.count)
