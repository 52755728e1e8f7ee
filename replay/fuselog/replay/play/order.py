"""The order in which a log is played, chosen once."""

from collections.abc import Sequence
from typing import Literal

from fuselog.replay.log import Log
from fuselog.replay.log.channels import Channel
from fuselog.replay.play.source import LogSource, Source
from fuselog.replay.play.stamped import StampedSource, header_stamps, publish_times

Order = Literal["log", "publish", "header"]


def source_of(log: Log, channels: Sequence[Channel], order: Order = "log") -> Source:
    """The chosen channels of the log as a source, by log time, publish time or header stamp."""
    if order == "log":
        return LogSource(log, channels)
    return StampedSource(log, channels, publish_times if order == "publish" else header_stamps(channels))
