"""Logs played in time: which messages, in which order, and when each is due. Knows no middleware."""

from fuselog.replay.play.clock import CLOCK_TOPIC, TICKS, clock_channel, ticker
from fuselog.replay.play.drive import Drive
from fuselog.replay.play.moment import parse_moment
from fuselog.replay.play.order import Order, source_of
from fuselog.replay.play.playback import Playback, Status
from fuselog.replay.play.played import Played
from fuselog.replay.play.select import playable, remap
from fuselog.replay.play.source import LogSource, Source
from fuselog.replay.play.stamped import StampedSource, header_stamps, publish_times
from fuselog.replay.play.timeline import CommandError, Range, Timeline, checked_rate

__all__ = [
    "CLOCK_TOPIC",
    "TICKS",
    "CommandError",
    "Drive",
    "LogSource",
    "Order",
    "Playback",
    "Played",
    "Range",
    "Source",
    "StampedSource",
    "Status",
    "Timeline",
    "checked_rate",
    "clock_channel",
    "header_stamps",
    "parse_moment",
    "playable",
    "publish_times",
    "remap",
    "source_of",
    "ticker",
]
