"""MCAP logs: read, play, record, reprocess."""

from fuselog.replay.channels import Channel, Schema
from fuselog.replay.decompress import Limits
from fuselog.replay.log import Log, RawMessage, open_log
from fuselog.replay.log import open_log as open
from fuselog.replay.loss import Loss
from fuselog.replay.reprocess import Summary, reprocess, reprocess_to, smooth_to
from fuselog.replay.topic import Topic
from fuselog.replay.tracks import TrackWriter, is_output
from fuselog.replay.writer import LogWriter

__all__ = [
    "Channel",
    "Limits",
    "Log",
    "LogWriter",
    "Loss",
    "RawMessage",
    "Schema",
    "Summary",
    "Topic",
    "TrackWriter",
    "is_output",
    "open",
    "open_log",
    "reprocess",
    "reprocess_to",
    "smooth_to",
]
