"""Filters of two position sensors that a test feeds and whose health it reads; arrivals are the test's to say."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from tests.fusion.setups import Sample, events_of

from fuselog.fusion import Engine, Ledger, Plan, compile_plan, parse_config
from fuselog.fusion.health import Health, HealthMemory, Recent, assess, no_judgement, no_samples, remember, seen, watch
from fuselog.fusion.ledger import make_ledger

S = 1_000_000_000
EPOCH = 1_700_000_000 * S
_CONFIG = """\
fuselog: 1
model: {name: constant_velocity, process_noise: {ax: 0.01, ay: 0.01}}
initial: {state: {vx: 0, vy: 0}, sd: {vx: 0.5, vy: 0.5}}
lag: {window: 0.5 s}
sensors:
  a: {topic: /a, fuse: [x, y], noise: {x: 1, y: 1}, A}
  b: {topic: /b, fuse: [x, y], noise: {x: 1, y: 1}, B}
"""


def two(a: str = "gate: 0.99", b: str = "gate: null") -> Plan:
    """The plan with these keys of its sensors."""
    return compile_plan(*parse_config(_CONFIG.replace("A}", f"{a}}}").replace("B}", f"{b}}}")))


class Reading(NamedTuple):
    """A sample at t (s after ``EPOCH``), and when it came."""

    sensor: str
    t: float
    x: float
    y: float
    arrival: float
    stamp_ns: int | None = None  # in place of t


def driving(n: int, *, speed: float = 0.0, sd: float = 1.0, latency: float = 0.02, seed: int = 3) -> list[Reading]:
    """n samples of each sensor at 10 Hz, of a target that drives along x."""
    errors = np.random.default_rng(seed).normal(0, sd, (2 * n, 2)).tolist()
    times = [1 + 0.05 * i for i in range(2 * n)]
    return [
        Reading("ab"[i % 2], t, speed * (t - 1) + dx, dy, t + latency)
        for i, (t, (dx, dy)) in enumerate(zip(times, errors, strict=True))
    ]


class Run:
    """A filter and what health remembers of it."""

    def __init__(self, plan: Plan) -> None:
        self.plan, self.engine = plan, Engine(plan)
        self.recent: Recent = no_samples(plan)
        self.memory: HealthMemory = no_judgement()
        self._received = np.zeros(len(plan.sensors), np.int64)

    def feed(self, readings: Iterable[Reading]) -> "Run":
        """Take samples in the order in which they came."""
        came = sorted(readings, key=lambda r: r.arrival)
        if not came:
            return self
        stamps = [r.stamp_ns if r.stamp_ns is not None else EPOCH + round(r.t * S) for r in came]
        which = {sensor.name: ["xy".index(name) for name in sensor.names] for sensor in self.plan.sensors}
        samples = [
            Sample(t, r.sensor, np.array([r.x, r.y])[which[r.sensor]], 1.0) for t, r in zip(stamps, came, strict=True)
        ]
        events = events_of(self.plan, samples)
        events = events._replace(arrival_ns=np.array([EPOCH + round(r.arrival * S) for r in came], np.int64))
        self._received += np.bincount(events.sensor, minlength=len(self._received))
        self.recent = remember(self.recent, [seen(self.engine.advance(events))])
        return self

    @property
    def ledger(self) -> Ledger:
        """What became of all samples."""
        received = self._received.tolist()
        return make_ledger(self.plan, received, np.zeros(len(received), np.int64), self.engine.counts)

    def health(self, **more: Any) -> Health:
        """As it is now, without a clock."""
        given: Mapping[str, Any] = {"losses": {}, **more}
        return assess(self.plan, estimate=self.engine.estimate, ledger=self.ledger, recent=self.recent, **given)

    def look(self, now_s: float, **more: Any) -> Health:
        """As it is judged at a time of the service's clock."""
        given: Mapping[str, Any] = {"losses": {}, **more}
        estimate, ledger, now_ns = self.engine.estimate, self.ledger, round(now_s * S)
        self.memory = watch(
            self.memory, self.plan, now_ns=now_ns, estimate=estimate, ledger=ledger, recent=self.recent, **given
        )
        assert self.memory.health is not None
        return self.memory.health


def codes(health: Health) -> set[str]:
    """Everything that is said, ``sensor.code`` or ``code``."""
    theirs = {f"{name}.{f.code}" for name, sensor in health.sensors.items() for f in sensor.findings}
    return theirs | {f.code for f in health.findings}
