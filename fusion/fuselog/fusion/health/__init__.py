"""Health: what is wrong with a filter and why, as a pure function of its counters and the last rows of its track."""

from fuselog.fusion.health.assess import Health, assess
from fuselog.fusion.health.figures import GateHealth, InnovationHealth, NisHealth, RateHealth, TimingHealth
from fuselog.fusion.health.findings import Ages, Finding, Level, Losses, SensorStatus, Status
from fuselog.fusion.health.judge import HOLD_NS, HealthChange, HealthMemory, judge, no_judgement, watch
from fuselog.fusion.health.message import HEALTH, health_message
from fuselog.fusion.health.sensor import SensorHealth
from fuselog.fusion.health.window import Recent, Seen, Window, no_samples, remember, seen

__all__ = [
    "HEALTH",
    "HOLD_NS",
    "Ages",
    "Finding",
    "GateHealth",
    "Health",
    "HealthChange",
    "HealthMemory",
    "InnovationHealth",
    "Level",
    "Losses",
    "NisHealth",
    "RateHealth",
    "Recent",
    "Seen",
    "SensorHealth",
    "SensorStatus",
    "Status",
    "TimingHealth",
    "Window",
    "assess",
    "health_message",
    "judge",
    "no_judgement",
    "no_samples",
    "remember",
    "seen",
    "watch",
]
