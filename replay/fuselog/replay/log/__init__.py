"""A log of one file or several, of whatever format: channels, messages in order, topics as tables."""

from fuselog.replay.log.log import Log

__all__ = ["Log"]
