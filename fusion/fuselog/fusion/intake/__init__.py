"""Raw messages in, events out: decoded, bound, placed and ordered."""

from fuselog.fusion.intake.clock import ClockGuard
from fuselog.fusion.intake.intake import TF_STATIC, Intake, Taken
from fuselog.fusion.intake.order import StampOrder
from fuselog.fusion.intake.stream import Stream, same_topic

__all__ = ["TF_STATIC", "ClockGuard", "Intake", "StampOrder", "Stream", "Taken", "same_topic"]
