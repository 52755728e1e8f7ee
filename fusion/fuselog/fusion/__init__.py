"""The estimator: events in, track out."""

from fuselog.fusion.config import Config, load_config, parse_config
from fuselog.fusion.engine import Engine, Estimate, Learned, Snapshot
from fuselog.fusion.events import Decision, Events
from fuselog.fusion.filter import Filter, Order
from fuselog.fusion.intake import Stream
from fuselog.fusion.ledger import Account, Ledger
from fuselog.fusion.outputs import Output, Outputs
from fuselog.fusion.plan import Plan, compile_plan, load_plan
from fuselog.fusion.smoothing import FixedInterval, FixedLag, with_optimal_gain
from fuselog.fusion.track import Track, join_tracks

__all__ = [
    "Account",
    "Config",
    "Decision",
    "Engine",
    "Estimate",
    "Events",
    "Filter",
    "FixedInterval",
    "FixedLag",
    "Learned",
    "Ledger",
    "Order",
    "Output",
    "Outputs",
    "Plan",
    "Snapshot",
    "Stream",
    "Track",
    "compile_plan",
    "join_tracks",
    "load_config",
    "load_plan",
    "parse_config",
    "with_optimal_gain",
]
