"""Health as a message, for those who listen rather than ask."""

import math
from functools import cache
from typing import Any

from fuselog.fusion.health.assess import Health
from fuselog.fusion.health.sensor import SensorHealth
from fuselog.schemas import PlainEncoder, definition

HEALTH = "fuselog_msgs/msg/Health"

_COUNTS = ("received", "fused", "gated", "late", "duplicate", "skipped", "disabled", "pending")


def health_message(health: Health, *, filter_id: str, frame: str) -> bytes:
    """The payload (CDR of ``HEALTH``), stamped with the newest time of the filter, 0 before the first."""
    return _encoder().encode(
        {
            "header": {"stamp": max(health.t_ns or 0, 0), "frame_id": frame},
            "filter": filter_id,
            "status": health.status,
            "reasons": health.reasons,
            "notes": health.notes,
            "finite": health.finite,
            "positive": health.positive,
            "balanced": health.account.balanced,
            "condition": _number(health.condition),
            "optimality_ratio": _number(health.optimality_ratio),
            "position_sd": _number(health.position_sd_m),
            "heading_sd": _number(health.heading_sd_rad),
            "fix_age": _number(health.fix_age_s),
            "idle": _number(health.idle_s),
            "sensors": [_sensor(name, sensor) for name, sensor in health.sensors.items()],
        }
    )


@cache
def _encoder() -> PlainEncoder:
    return PlainEncoder(HEALTH, definition(HEALTH))


def _sensor(name: str, sensor: SensorHealth) -> dict[str, Any]:
    nis, rate, timing, account = sensor.nis, sensor.rate, sensor.timing, sensor.account
    return {
        "name": name,
        "topic": sensor.topic,
        "status": sensor.status,
        "reasons": sensor.reasons,
        "notes": sensor.notes,
        "rate": math.nan if rate is None else rate.hz,
        "expected_rate": math.nan if rate is None else _number(rate.expected_hz),
        "age": _number(sensor.age_s),
        "idle": _number(sensor.idle_s),
        "latency": math.nan if timing is None else timing.median_s,
        "latency_95": math.nan if timing is None else timing.p95_s,
        "nis": math.nan if nis is None else nis.mean,
        "nis_low": math.nan if nis is None else nis.band[0],
        "nis_high": math.nan if nis is None else nis.band[1],
        "dof": math.nan if nis is None else nis.dof,
        "inside_95": math.nan if nis is None else nis.inside_95,
        **{count: getattr(account, count) for count in _COUNTS},
        "invalid": sum(account.invalid.values()),
        "shed": sensor.losses.shed,
        "missed": sensor.losses.missed,
        "unusable": sensor.losses.unknown,
    }


def _number(value: float | None) -> float:
    return math.nan if value is None else value
