"""MCAP logs: read, play, record, reprocess."""

from fuselog.replay.channels import Channel, Schema
from fuselog.replay.decompress import Limits
from fuselog.replay.log import Log, RawMessage, open_log
from fuselog.replay.loss import Loss
from fuselog.replay.writer import LogWriter

__all__ = ["Channel", "Limits", "Log", "LogWriter", "Loss", "RawMessage", "Schema", "open_log"]
