"""MCAP logs: read, play, record, reprocess."""

from fuselog.replay.channels import Channel, Schema
from fuselog.replay.decompress import Limits
from fuselog.replay.follow import Follower
from fuselog.replay.log import Log
from fuselog.replay.loss import Loss
from fuselog.replay.opening import open_log
from fuselog.replay.opening import open_log as open
from fuselog.replay.part import Attachment
from fuselog.replay.raw import RawMessage
from fuselog.replay.reprocess import Summary, reprocess, reprocess_to, smooth_to
from fuselog.replay.topic import Topic
from fuselog.replay.tracks import TrackWriter, is_output
from fuselog.replay.writer import LogWriter

__all__ = [
    "Attachment",
    "Channel",
    "Follower",
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
