"""An output log beside the log it was made from: all numbers that a picture or a comparison wants, by name."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan, compile_plan, parse_config
from fuselog.fusion.config.settings import GainSettings, SensorSettings
from fuselog.fusion.intake import Intake
from fuselog.fusion.readings import PARTS, SAME_QUANTITY
from fuselog.fusion.tables import Role
from fuselog.fusion.track import packed_diagonal
from fuselog.replay import Log, open_log
from fuselog.replay.reprocess import stream_of
from fuselog.schemas import LogError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Named numbers over time, such as what one sensor measured or a robot's true states."""

    names: tuple[str, ...]
    t_ns: Ints  # (n,)
    values: Floats  # (n, m)

    def __getitem__(self, name: str) -> Floats:
        return self.values[:, self.names.index(name)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Decisions:
    """What became of the samples of one sensor that measures m numbers."""

    sensor: str
    names: tuple[str, ...]
    t_ns: Ints  # (n,) stamps
    decision: Floats  # (n,) of fuselog.fusion.Decision
    nis: Floats  # (n,)
    innovation: Floats  # (n, m)
    innovation_sd: Floats  # (n, m)
    absorbed: Floats  # (n, m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One output log: estimates, their standard deviations, and decisions by sensor."""

    name: str
    plan: Plan
    datum: tuple[float, ...] | None  # latitude, longitude (deg), altitude (m) of the origin
    states: Series
    covariance: Floats  # (n, N (N + 1) / 2) upper triangle, row by row
    decisions: tuple[Decisions, ...]

    def sd(self, state: str) -> Floats:
        """Standard deviations (n,) of one state."""
        return np.sqrt(
            self.covariance[:, packed_diagonal(len(self.plan.states))[self.plan.states.index(state)]]
        )


def load_run(path: Path) -> Run:
    """Read an output log. Raises ``LogError`` when fuselog did not make it."""
    with open_log(path) as log:
        made = log.metadata().get("fuselog")
        if made is None:
            raise LogError(
                str(path), 0, "not an output of fuselog reprocess: it does not say how it was made"
            )
        plan = compile_plan(*parse_config(made["config"], name=f"{path}: configuration"))
        base, n = plan.config.output.estimate.rstrip("/"), len(plan.states)
        wanted = [f"state[{i}]" for i in range(n)] + [f"covariance[{i}]" for i in range(n * (n + 1) // 2)]
        read = log.read(base, wanted)
        return Run(
            name=path.stem,
            plan=plan,
            datum=tuple(float(number) for number in made["datum"].split()) or None,
            states=Series(names=plan.states, t_ns=read.t_ns, values=read.values[:, :n]),
            covariance=read.values[:, n:],
            decisions=_decisions(log, plan, f"{base}/decision"),
        )


def load_measured(log: Log, plan: Plan) -> dict[str, Series]:
    """What each sensor measured, as the filter got it: mounted, scaled, in local coordinates.

    The position of a beacon follows the measured numbers as ``beacon_x beacon_y beacon_z``.
    """
    intake = Intake(plan)
    used = {c.topic for c in log.channels.values() if intake.open(c.id, stream_of(c))}
    batches = [intake.take(messages).events for messages in log.batches(used)]
    found: dict[str, Series] = {}
    for sensor in plan.sensors if batches else ():
        parts = [
            events.take(np.flatnonzero((events.sensor == sensor.rank) & (events.fault == 0)))
            for events in batches
        ]
        z = np.concatenate([events.z for events in parts])
        beacon = sensor.settings.kind == "beacon_range"
        columns = [*range(sensor.dof), *(range(plan.tables.M, plan.tables.M + 3) if beacon else ())]
        names = (*sensor.names, *(("beacon_x", "beacon_y", "beacon_z") if beacon else ()))
        t_ns = np.concatenate([events.t_ns for events in parts])
        found[sensor.name] = Series(names=names, t_ns=t_ns, values=z[:, columns])
    return found


def load_truth(log: Log, run: Run, topic: str | None) -> Series | None:
    """The true states by their names, from ``topic`` or from one called like a truth; None where there is none.

    Raises ``LogError`` for a topic that is not there or says nothing of the model's states.
    """
    chosen = topic or next((name for name in log.topics if "truth" in name), None)
    if chosen is None:
        return None
    if chosen not in log.topics:
        raise LogError(log.path, 0, f"no topic {chosen!r}; it has {', '.join(log.topics)}")
    names = _states_in(log.topics[chosen][0].schema.name, run.plan.states)
    if not names:
        if topic is None:
            return None
        raise LogError(log.path, 0, f"{topic} ({log.topics[topic][0].schema.name}) has none of the states")
    reader = SensorSettings(topic=chosen, fuse=names, noise=dict.fromkeys(names, 1.0), datum=_datum(run))
    as_sensor = {"sensors": {"truth": reader}, "gain": GainSettings.model_validate({})}
    plan = compile_plan(run.plan.config.model_copy(update=as_sensor), run.plan.source)
    return load_measured(log, plan).get("truth")


def _states_in(message_type: str, states: Sequence[str]) -> list[str]:
    gives = {name for part in PARTS.get(message_type, ()) for name in part.names}
    return [state for state in states if SAME_QUANTITY.get(state, state) in gives]


def _datum(run: Run) -> "tuple[float, float, float] | str":
    return "first_fix" if run.datum is None else (run.datum[0], run.datum[1], run.datum[2])


def _decisions(log: Log, plan: Plan, topic: str) -> tuple[Decisions, ...]:
    M = plan.tables.M
    tables = [f"{name}[{i}]" for name in ("innovation", "innovation_variance", "absorbed") for i in range(M)]
    read = log.read(topic, ["sensor", "decision", "nis", *tables])
    sensors = np.array(read.texts["sensor"], np.str_)
    found: list[Decisions] = []
    for sensor in plan.sensors:
        if sensor.role != Role.MEASURES:
            continue
        mine, m = np.flatnonzero(sensors == sensor.name), sensor.dof
        innovation, variance, absorbed = np.split(read.values[mine, 2:], 3, axis=1)
        found.append(
            Decisions(
                sensor=sensor.name,
                names=sensor.names,
                t_ns=read.t_ns[mine],
                decision=read["decision"][mine],
                nis=read["nis"][mine],
                innovation=innovation[:, :m],
                innovation_sd=np.sqrt(variance[:, :m]),
                absorbed=absorbed[:, :m],
            )
        )
    return tuple(found)
