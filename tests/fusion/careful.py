"""What is done with samples that do not fit, and noises that are not as stated, in dense numpy; and the laws for it."""

import math
from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2
from tests.fusion.reference import MOTIONS, Ekf, is_angle, measure, wrap
from tests.fusion.setups import MEASURED, Sample, events_of, place_of

from fuselog.fusion import Decision, Engine, Plan, Track, join_tracks
from fuselog.fusion.health import Losses, assess, no_samples, remember, seen
from fuselog.fusion.ledger import make_ledger

MS = 1_000_000


class Memory:
    """What is remembered of one sensor."""

    def __init__(self) -> None:
        self.factor, self.seen, self.refused, self.recovered, self.last = 1.0, 0, 0, 0, None
        self.stretch: list[np.ndarray] = []
        self.begun, self.stood, self.denied = 0, 0, 0


class Careful(Ekf):
    """The dense filter with all that ``robust``, ``adapt``, ``gate_recovery`` and ``stationary`` say."""

    def __init__(self, plan: Plan) -> None:
        q = dict(zip(plan.card.noise, plan.tables.q, strict=False))
        super().__init__(MOTIONS[plan.card.name], plan.x, plan.P, q)
        self.plan, self.model, self.stated, self.process = plan, plan.card.name, dict(q), 1.0
        self.memory = {sensor.name: Memory() for sensor in plan.sensors}
        self.t = None

    def take(self, sample: Sample) -> str:
        """Predict to the sample, and do with it what the configuration says; returns the decision."""
        if self.t is not None and sample.t_ns > self.t:
            self.q = {name: value * self.process for name, value in self.stated.items()}
            self.predict((sample.t_ns - self.t) * 1e-9)
        self.t = sample.t_ns
        settings = self.plan.config.sensors[sample.sensor]
        decision = self._weigh(sample, settings, self.memory[sample.sensor])
        if settings.stationary:
            self._stand(sample, settings.stationary, self.memory[sample.sensor])
        return decision

    def _weigh(self, sample: Sample, settings, memory: Memory) -> str:
        names = MEASURED[self.model][sample.sensor]
        h, H = self.observe(names, place_of(self.model, sample.sensor, sample.beacon))
        nu = np.array([wrap(d) if is_angle(n) else d for d, n in zip(np.asarray(sample.z) - h, names, strict=True)])
        m, R = len(nu), (np.eye(len(nu)) * sample.R if np.ndim(sample.R) == 0 else np.array(sample.R)) * memory.factor
        nis = self._nis(H, nu, R)
        most = math.inf if settings.gate is None else chi2.ppf(settings.gate, m)
        passed, recovery = nis <= most, settings.gate_recovery
        memory.refused = 0 if passed else memory.refused + 1
        if not passed and recovery and memory.refused >= recovery.samples:
            waited = memory.last is None or sample.t_ns - memory.last >= recovery.time * 1e9
            wide = [self.motion.names.index(name) for name in settings.fuse]
            while waited and nis > m:
                self.P[wide, wide] *= 2
                nis = self._nis(H, nu, R)
                passed = True
            memory.recovered += passed
            memory.refused *= not passed
        robust, weight = settings.robust, 1.0
        if robust:
            tail = (robust.dof + m) / (robust.dof + nis)
            weight = math.sqrt(chi2.ppf(robust.threshold, m) / nis) if robust.kind == "huber" else tail
        R = R / min(weight, 1.0)
        trust = 1.0 if passed else most / nis
        inverse = np.linalg.inv(H @ self.P @ H.T + R)
        excess = trust * nu @ inverse @ R @ inverse @ nu - np.trace(inverse @ R)
        total = trust * nu @ inverse @ nu
        if settings.adapt:
            share = max(1 / settings.adapt.window, 1 / (memory.seen + 6))
            before, memory.seen = memory.factor, memory.seen + 1
            bounds = settings.adapt.floor**2, settings.adapt.ceiling**2
            memory.factor = float(np.clip(before * (1 + share * excess / m), *bounds))
            R = R * memory.factor / before
        adapt = self.plan.config.model.adapt
        if adapt:
            moved = self.process * (1 + (total - m - excess) / m / adapt.window)
            self.process = float(np.clip(moved, adapt.floor, adapt.ceiling))
        if not passed:
            return "GATED"
        self._correct(H, nu, R)
        memory.last = sample.t_ns
        return "FUSED"

    def _stand(self, sample: Sample, stationary, memory: Memory) -> None:
        """Velocities of 0 where all of a stretch is slower than ``speed``."""
        if not memory.stretch:
            memory.begun = sample.t_ns
        memory.stretch.append(np.array(sample.z))
        age = sample.t_ns - memory.begun
        if age < stationary.window * 1e9:
            return
        rows, memory.stretch = np.array(memory.stretch), []
        if len(rows) < 3 or age > 2e9 * stationary.window:
            return
        if (rows.std(axis=0, ddof=1) > stationary.speed).any() or (abs(rows.mean(axis=0)) > stationary.speed).any():
            return
        told = [self.motion.names.index(name) for name in ("v", "vx", "vy") if name in self.motion.names]
        R = stationary.velocity_sd**2
        if any(self.x[i] ** 2 > chi2.ppf(stationary.gate, 1) * (self.P[i, i] + R) for i in told):
            memory.denied += 1
            return
        memory.stood += 1
        H = np.eye(len(self.x))[told]
        self._correct(H, -self.x[told], R * np.eye(len(told)))

    def _nis(self, H, nu, R) -> float:
        return float(nu @ np.linalg.solve(H @ self.P @ H.T + R, nu))

    def _correct(self, H, nu, R) -> None:
        G = np.linalg.solve(H @ self.P @ H.T + R, H @ self.P).T
        self.x = self._wrapped(self.x + G @ nu)
        A = np.eye(len(self.x)) - G @ H
        self.P = A @ self.P @ A.T + G @ R @ G.T


def assert_as_witnessed(plan: Plan, samples: list[Sample]) -> tuple[Track, Careful, Engine]:
    """x, P and decisions of every row, and what was learned by the end."""
    engine, witness = Engine(plan), Careful(plan)
    track = engine.advance(events_of(plan, samples))
    for row, sample in enumerate(samples):
        assert witness.take(sample) == Decision(track.decision[row]).name, row
        assert np.abs(track.x[row] - witness.x).max() < 1e-7 * max(1.0, np.abs(witness.x).max()), row
        assert np.abs(track.covariance(row) - witness.P).max() < 1e-7 * max(1e-3, np.abs(witness.P).max()), row
    learned = engine.estimate.learned
    memories = [witness.memory[sensor.name] for sensor in plan.sensors]
    assert learned.noise**2 == pytest.approx([memory.factor for memory in memories], rel=1e-6)
    assert learned.process == pytest.approx(witness.process, rel=1e-6)
    assert learned.recovered.tolist() == [memory.recovered for memory in memories]
    assert learned.stood.tolist() == [memory.stood for memory in memories]
    assert learned.refused.tolist() == [memory.denied for memory in memories]
    return track, witness, engine


def assert_laws(plan: Plan, samples: list[Sample], seed: int = 0) -> None:
    """Cutting changes no bit; samples late inside the window end in the same bits as in stamp order; nor does a return
    to a snapshot change any.
    """
    events, rng = events_of(plan, samples), np.random.default_rng(seed)
    whole = Engine(plan)
    track = whole.advance(events)
    places = [0, *sorted(rng.integers(0, events.size, 20).tolist()), events.size]
    for cuts in (places, list(range(events.size + 1))):
        engine = Engine(plan)
        pieces = join_tracks([engine.advance(events.take(slice(a, b))) for a, b in pairwise(cuts)])
        for column in fields(Track):
            one, other = getattr(pieces, column.name), getattr(track, column.name)
            assert one == other if isinstance(one, tuple) else one.tobytes() == other.tobytes(), column.name
        assert remembered(engine) == remembered(whole)
    late = events.t_ns + rng.uniform(0, plan.tables.window_ns, events.size)
    received = Engine(plan)
    decisions = received.advance(events.take(np.argsort(late, kind="stable"))).decision
    assert not (decisions == Decision.LATE).any()
    assert remembered(received) == remembered(whole)
    engine = Engine(plan)
    half = events.size // 2
    engine.advance(events.take(slice(0, half)))
    snapshot = engine.snapshot()
    for _ in range(2):
        engine.advance(events.take(slice(half, None)))
        assert remembered(engine) == remembered(whole)
        engine.restore(snapshot)


def remembered(engine: Engine) -> tuple[bytes, ...]:
    """Everything that a filter is at its newest time."""
    newest = engine.estimate
    learned = [np.asarray(getattr(newest.learned, column.name)) for column in fields(newest.learned)]
    return tuple(a.tobytes() for a in (newest.x, newest.P, newest.known, engine.counts, *learned))


def along(model: str, seconds: float, seed: int, *, outliers: float = 0.0, step_ms: int = 40) -> list[Sample]:
    """Samples of all sensors in turn, of a target that moves as the model says."""
    rng, samples = np.random.default_rng(seed), []
    sensors, x = list(MEASURED[model]), np.array([2.0, -1.0, 1.0, 0.5])
    for k in range(int(seconds * 1000 / step_ms)):
        dt = step_ms * 1e-3
        a = rng.normal(size=2) * np.sqrt(np.array([0.7, 0.4]) / dt)
        x = np.concatenate([x[:2] + x[2:] * dt + a * dt**2 / 2, x[2:] + a * dt])
        sensor = sensors[k % len(sensors)]
        beacon = tuple(float(v) for v in rng.uniform(-30, 30, 3)) if sensor == "uwb" else (0.0, 0.0, 0.0)
        h = measure(MOTIONS[model], x, MEASURED[model][sensor], place_of(model, sensor, beacon))
        noise = rng.normal(size=len(h)) * 0.05 * (40 if rng.random() < outliers else 1)
        samples.append(Sample((1000 + (k + 1) * step_ms) * MS, sensor, h + noise, 0.05**2, beacon))
    return samples


def notes_of(plan: Plan, engine: Engine, track: Track, sensor: str) -> tuple[str, ...]:
    """What health remarks on a sensor."""
    received = np.bincount(track.sensor, minlength=len(plan.sensors))
    ledger = make_ledger(plan, received.tolist(), np.zeros(len(plan.sensors), np.int64), engine.counts)
    recent = remember(no_samples(plan), [seen(track)])
    losses: dict[str, Losses] = {}
    health = assess(plan, estimate=engine.estimate, ledger=ledger, recent=recent, losses=losses)
    return health.sensors[sensor].notes
