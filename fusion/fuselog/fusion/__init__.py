"""The estimator: events in, track out."""

from fuselog.fusion.abreast import advance_each
from fuselog.fusion.commands import Answer, Command, CommandError, Configure, Reset, SetState
from fuselog.fusion.config import Config, load_config, parse_config
from fuselog.fusion.engine import Engine, Estimate, Learned, Snapshot
from fuselog.fusion.events import Decision, Events
from fuselog.fusion.filter import Beside, Filter, Order
from fuselog.fusion.intake import Stream
from fuselog.fusion.ledger import Account, Ledger
from fuselog.fusion.outputs import Output, Outputs
from fuselog.fusion.plan import Plan, compile_plan, load_plan
from fuselog.fusion.sealed import CheckpointError
from fuselog.fusion.smoothing import FixedInterval, FixedLag, with_optimal_gain
from fuselog.fusion.ticks import Ticked
from fuselog.fusion.track import Track, join_tracks

__all__ = [
    "Account",
    "Answer",
    "Beside",
    "CheckpointError",
    "Command",
    "CommandError",
    "Config",
    "Configure",
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
    "Reset",
    "SetState",
    "Snapshot",
    "Stream",
    "Ticked",
    "Track",
    "advance_each",
    "compile_plan",
    "join_tracks",
    "load_config",
    "load_plan",
    "parse_config",
    "with_optimal_gain",
]
