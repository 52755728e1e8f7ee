"""The order in which logs are played, chosen once."""

from collections.abc import Sequence
from typing import Literal

from fuselog.replay.channels import Channel
from fuselog.replay.log import Log
from fuselog.replay.play.source import LogSource, MergedSource, Source
from fuselog.replay.play.stamped import StampedSource, header_stamps, publish_times

Order = Literal["log", "publish", "header"]


def source_of(logs: Sequence[Log], channels: Sequence[Sequence[Channel]], order: Order = "log") -> Source:
    """The chosen channels of the logs as one source, by log time, publish time or header stamp.

    Logs without messages are left out, for they begin nowhere.
    """
    make = {"log": LogSource, "publish": _by_publish_time, "header": _by_header}[order]
    parts = [make(log, mine) for log, mine in zip(logs, channels, strict=True) if log.time_range is not None]
    if not parts:
        return LogSource(logs[0], channels[0])
    return parts[0] if len(parts) == 1 else MergedSource(parts)


def _by_publish_time(log: Log, channels: Sequence[Channel]) -> Source:
    return StampedSource(log, channels, publish_times)


def _by_header(log: Log, channels: Sequence[Channel]) -> Source:
    return StampedSource(log, channels, header_stamps(channels))
