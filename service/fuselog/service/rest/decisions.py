"""What became of single samples: a list to page through, and one explained in words."""

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, Field

from fuselog.fusion import Decision
from fuselog.fusion.gate import chi_square_quantile
from fuselog.fusion.health import Window
from fuselog.fusion.plan import SensorPlan
from fuselog.service.live.member import Snapshot
from fuselog.service.rest.plain import Number, plain
from fuselog.service.rest.problems import Refused

_MEANS = {
    Decision.FUSED: "it was fused",
    Decision.GATED: "the gate refused it",
    Decision.LATE: "it came too late: it was older than the lag window, and is not fused as if it were current",
    Decision.DUPLICATE: "a sample of this sensor with the same stamp and numbers had been fused before",
    Decision.SKIPPED: "it had no vote in its cycle of fixed weights",
    Decision.INVALID_NAN: "a number of it is not finite",
    Decision.INVALID_SCHEMA: "its message is not of the sensor's type",
    Decision.INVALID_SIZE: "its message is too short or too long for its type",
    Decision.INVALID_CLOCK: "its stamp is further from the others than lag.max_step: a wrong clock",
    Decision.INVALID_COVARIANCE: "its covariance is none: not symmetric, or with a variance that is not positive",
    Decision.INVALID_UNINITIALISED: "it depends on a state that nothing had measured yet",
    Decision.INVALID_SINGULAR: "it would have brought the state to where the model has no estimate",
}


class DecisionAnswer(BaseModel):
    """What became of one sample."""

    sensor: str
    seq: int = Field(description="how many samples of the sensor came before")
    stamp_ns: int
    arrival_ns: int
    decision: str
    nis: Number = Field(description="null where the sample was not tried")
    dof: int
    threshold: Number = Field(description="of the NIS; null where the sensor has no gate")
    innovation: dict[str, Number]
    sigmas: dict[str, Number] = Field(description="the innovation in its standard deviations")


class DecisionsAnswer(BaseModel):
    """Samples, the newest first."""

    decisions: list[DecisionAnswer]
    next: str | None = Field(description="before= for the samples before these; null at the end of what is remembered")


class ExplainedAnswer(DecisionAnswer):
    """One sample, in words."""

    window_s: Number = Field(description="lag.window")
    behind_s: Number = Field(description="of the newest stamp that had come; null where that is not remembered")
    words: list[str]


class Cursor(NamedTuple):
    """A place in the list: samples in the order of their arrival, then of the configuration, then of the sensor."""

    arrival_ns: int
    rank: int
    seq: int

    def __str__(self) -> str:
        return "-".join(map(str, self))


def read_cursor(text: str) -> Cursor:
    """What ``str`` made of a cursor."""
    arrival_ns, rank, seq = map(int, text.split("-"))
    return Cursor(arrival_ns, rank, seq)


def list_decisions(
    snapshot: Snapshot, *, sensor: str | None, decision: Decision | None, limit: int, before: Cursor | None
) -> dict[str, Any]:
    """A page of at most ``limit`` samples before ``before``."""
    found = sorted(_rows(snapshot, sensor, decision, before), reverse=True)
    page = found[:limit]
    rows = [_decision(snapshot.plan.sensors[at.rank], snapshot.recent[at.rank], row) for at, row in page]
    return {"decisions": rows, "next": str(page[-1][0]) if len(found) > limit else None}


def explain(snapshot: Snapshot, name: str, seq: int) -> dict[str, Any]:
    """One sample in words; raises ``Refused`` (404) when it is not remembered."""
    sensor = sensor_of(snapshot, name)
    window = snapshot.recent[sensor.rank]
    rows = np.flatnonzero(window.seq == seq)
    if not len(rows):
        there = f"{window.seq.min()} to {window.seq.max()}" if len(window.seq) else "none"
        raise Refused(404, f"sample {seq} of {name} is not among the last that are remembered: {there}")
    row = int(rows[-1])
    told = _decision(sensor, window, row)
    behind = _behind(snapshot, told)
    window_s = snapshot.plan.config.lag.window
    return {**told, "window_s": window_s, "behind_s": behind, "words": _words(told, sensor, behind, window_s)}


def sensor_of(snapshot: Snapshot, name: str) -> SensorPlan:
    """A sensor of a filter; raises ``Refused`` (404)."""
    for sensor in snapshot.plan.sensors:
        if sensor.name == name:
            return sensor
    raise Refused(404, f"there is no sensor {name!r}; there are {', '.join(s.name for s in snapshot.plan.sensors)}")


def _rows(
    snapshot: Snapshot, name: str | None, decision: Decision | None, before: Cursor | None
) -> Iterator[tuple[Cursor, int]]:
    for sensor in snapshot.plan.sensors:
        if name is not None and sensor.name != name:
            continue
        window = snapshot.recent[sensor.rank]
        kept = range(len(window.seq)) if decision is None else np.flatnonzero(window.decision == decision).tolist()
        arrivals, seqs = window.arrival_ns.tolist(), window.seq.tolist()
        for row in kept:
            at = Cursor(arrivals[row], sensor.rank, seqs[row])
            if before is None or at < before:
                yield at, row


def _decision(sensor: SensorPlan, window: Window, row: int) -> dict[str, Any]:
    dof = int(window.dof[row])
    innovation = dict(zip(sensor.names, window.innovation[row].tolist(), strict=False))
    with np.errstate(invalid="ignore", divide="ignore"):
        sigmas = (window.innovation[row] / np.sqrt(window.variance[row])).tolist()
    return plain(
        {
            "sensor": sensor.name,
            "seq": int(window.seq[row]),
            "stamp_ns": int(window.stamp_ns[row]),
            "arrival_ns": int(window.arrival_ns[row]),
            "decision": Decision(int(window.decision[row])),
            "nis": float(window.nis[row]),
            "dof": dof,
            "threshold": _threshold(sensor.settings.gate, dof),
            "innovation": innovation,
            "sigmas": dict(zip(sensor.names, sigmas, strict=False)),
        }
    )


@cache
def _threshold(gate: float | None, dof: int) -> float | None:
    return None if gate is None or dof <= 0 else chi_square_quantile(gate, dof)


def _behind(snapshot: Snapshot, told: dict[str, Any]) -> float | None:
    """How far the stamp is behind the newest of all sensors that had come before it (s)."""
    newest = [
        int(window.stamp_ns[earlier].max())
        for window in snapshot.recent
        if len(earlier := np.flatnonzero((window.arrival_ns < told["arrival_ns"]) & _stamped(window)))
    ]
    return (max(newest) - told["stamp_ns"]) / 1e9 if newest else None


def _stamped(window: Window) -> Any:
    """Rows whose stamp says something."""
    return ~np.isin(window.decision, [d for d in Decision if d.invalid])


def _words(told: dict[str, Any], sensor: SensorPlan, behind: float | None, window_s: float) -> list[str]:
    decision = Decision[told["decision"].upper()]
    words = [_MEANS[decision]]
    if told["nis"] is not None and told["dof"] > 0:
        words.append(_judged(told, sensor))
    for name, sigmas in told["sigmas"].items():
        if sigmas is not None:
            words.append(f"{name}: innovation {told['innovation'][name]:.6g}, {sigmas:+.2f} sigma")
    if behind is not None and behind > 0 and not decision.invalid:
        inside = behind <= window_s
        done = "the filter went back and took it at its own time" if inside else "the filter had gone past it"
        words.append(
            f"its stamp was {behind:.6g} s behind the newest that had come, lag.window is {window_s:g} s: {done}"
        )
    return words


def _judged(told: dict[str, Any], sensor: SensorPlan) -> str:
    nis = f"NIS {told['nis']:.4g} with {told['dof']} degrees of freedom"
    if told["threshold"] is None:
        return f"{nis}; the sensor has no gate"
    side = "above" if told["nis"] > told["threshold"] else "within"
    return f"{nis}, {side} the gate's {told['threshold']:.4g} (probability {sensor.settings.gate})"
