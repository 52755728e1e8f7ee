"""MCAP logs: read, play, record, reprocess."""

from fuselog.replay.log import Log
from fuselog.replay.log.channels import Channel, Schema
from fuselog.replay.log.loss import Loss
from fuselog.replay.log.part import Attachment
from fuselog.replay.log.raw import RawMessage
from fuselog.replay.log.topic import Topic
from fuselog.replay.mcap_file.decompress import Limits
from fuselog.replay.mcap_file.follow import Follower
from fuselog.replay.mcap_file.writer import LogWriter
from fuselog.replay.opening import open_log
from fuselog.replay.opening import open_log as open
from fuselog.replay.reprocess import Summary, reprocess, reprocess_to, smooth_to
from fuselog.replay.tracks import TrackWriter, is_output

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
