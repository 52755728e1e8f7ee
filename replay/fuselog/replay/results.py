"""What an output log holds: the estimates and decisions of a run, as arrays."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Decision
from fuselog.fusion.outputs import DECISION, ESTIMATE
from fuselog.replay.log import Log
from fuselog.replay.log.channels import Channel
from fuselog.replay.opening import open_log
from fuselog.schemas import LogError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Decisions:
    """What became of a sensor's samples, in the order of the log."""

    t_ns: NDArray[np.int64]  # (n,) stamps
    decision: NDArray[np.int64]  # (n,) of ``Decision``
    nis: Floats  # (n,) NaN where the sample was not tried
    dof: NDArray[np.int64]  # (n,)
    innovation: Floats  # (n, m)
    innovation_variance: Floats  # (n, m)
    absorbed: Floats  # (n, m)

    @property
    def tried(self) -> NDArray[np.bool_]:
        """Rows whose innovation was judged: the state had an opinion of it."""
        return (self.dof > 0) & np.isin(self.decision, (Decision.FUSED, Decision.GATED))


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The estimates of a run, at each time the last one, and the decisions by sensor."""

    states: tuple[str, ...]
    t_ns: NDArray[np.int64]  # (n,) increasing
    x: Floats  # (n, N)
    P: Floats  # (n, N (N + 1) / 2) upper triangle, row by row
    decisions: Mapping[str, Decisions]
    about: Mapping[str, str]  # version, order, datum, config; smoothed and gain where it was smoothed

    @property
    def datum(self) -> Floats | None:
        """Latitude, longitude (deg), altitude (m) of the origin; None when nothing was geodetic."""
        text = self.about.get("datum", "")
        return np.array([float(number) for number in text.split()]) if text else None


def read_results(out: Log | str | Path, topic: str | None = None) -> Results:
    """Read an output log, of several topics with estimates the first. Raises ``LogError`` when it has none."""
    if not isinstance(out, Log):
        with open_log(out) as opened:
            return read_results(opened, topic)
    estimate = _channel(out, ESTIMATE, topic)
    states = _states(out, estimate)
    n = len(states)
    fields = [f"state[{i}]" for i in range(n)] + [f"covariance[{i}]" for i in range(n * (n + 1) // 2)]
    columns = out.read(estimate.topic, fields)
    order = np.argsort(columns.t_ns, kind="stable")
    stamps = columns.t_ns[order]
    last = order[np.append(stamps[1:] != stamps[:-1], True)] if len(order) else order
    return Results(
        states=states,
        t_ns=columns.t_ns[last],
        x=columns.values[last, :n],
        P=columns.values[last, n:],
        decisions=_decisions(out),
        about=out.metadata().get("fuselog", {}),
    )


def _channel(out: Log, schema: str, topic: str | None = None) -> Channel:
    for channel in out.channels.values():
        if channel.schema.name == schema and topic in (None, channel.topic):
            return channel
    where = "in it" if topic is None else f"on {topic}"
    raise LogError(str(out.path), 0, f"no {schema} {where}; is it the output of fuselog reprocess?")


def _states(out: Log, channel: Channel) -> tuple[str, ...]:
    count = out.read(channel.topic, ["names[]"])["names[]"]
    if len(count) == 0 or not np.isfinite(count[0]):
        raise LogError(str(out.path), 0, f"{channel.topic} has no estimate")
    names = [f"names[{i}]" for i in range(int(count[0]))]
    texts = out.read(channel.topic, names).texts
    return tuple(texts[name][0] for name in names)


def _decisions(out: Log) -> dict[str, Decisions]:
    """Decisions by sensor, read as wide as the sensor that measures most."""
    channel = _channel(out, DECISION)
    m = int(np.nanmax(out.read(channel.topic, ["innovation[]"]).values, initial=1))
    tables = [f"{name}[{i}]" for name in ("innovation", "innovation_variance", "absorbed") for i in range(m)]
    columns = out.read(channel.topic, ["sensor", "decision", "nis", "dof", *tables])
    sensor = np.array(columns.texts["sensor"])
    found: dict[str, Decisions] = {}
    for name in dict.fromkeys(columns.texts["sensor"]):
        rows = np.flatnonzero(sensor == name)
        table = columns.values[rows, 3:].reshape(len(rows), 3, m)
        used = max(1, int(np.isfinite(table[:, 0]).sum(axis=1).max(initial=1)))
        found[name] = Decisions(
            t_ns=columns.t_ns[rows],
            decision=columns["decision"][rows].astype(np.int64),
            nis=columns["nis"][rows],
            dof=columns["dof"][rows].astype(np.int64),
            innovation=table[:, 0, :used],
            innovation_variance=table[:, 1, :used],
            absorbed=table[:, 2, :used],
        )
    return found
