"""Smoothing against a plain Rauch-Tung-Striebel smoother and simulated truth; its laws: no bit from how it is cut."""

import math
from collections.abc import Sequence
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.fusion.reference import Ekf, measure, wrap
from tests.fusion.setups import MEASURED, MODELS, Sample, events_of, motion_of, place_of, setup, truth
from tests.fusion.test_inertial import INS, SECOND, G, State, differences, plan_of
from tests.fusion.test_laws import LAW, PLANS, arrivals, assert_same_bytes, cut

from fuselog.fusion import (
    Decision,
    Engine,
    Events,
    FixedInterval,
    FixedLag,
    Plan,
    Track,
    join_tracks,
    with_optimal_gain,
)
from fuselog.fusion.gate import chi_square_quantile
from fuselog.fusion.intake import StampOrder

Array = NDArray[np.float64]
MS = 1_000_000
SMOOTH = {"lag": "300 ms", "rate": 10.0}


def smoothed(plan: Plan, events: Events, places: Sequence[int] = (), rate: float | None = None) -> tuple[Track, Track]:
    """The filter's rows and the smoothed ones, of events in their order, in segments cut at ``places``."""
    plan = with_optimal_gain(plan)
    engine, segments, forth = Engine(plan, window_ns=0), [], []
    for segment in cut(events, list(places)):
        segments.append((engine.snapshot(), segment))
        forth.append(engine.advance(segment))
    way = FixedInterval(plan, rate=rate)
    back = [way.back(*segment) for segment in reversed(segments)]
    return join_tracks(forth), join_tracks(back[::-1])


def settled(plan: Plan, events: Events) -> Events:
    """All events, in the total order."""
    order = StampOrder(plan.tables.window_ns, plan.tables.M)
    batches = [order.push(events), order.finish()]
    return Events._make(np.concatenate(columns) for columns in zip(*batches, strict=True))


class Rts:
    """Rauch, Tung, Striebel 1965 over the steps of the plain EKF: C = P F' (P-)^-1, x = x + C (x' - x-)."""

    def __init__(self, plan: Plan, P: Array | None = None) -> None:
        noise = dict(zip(plan.card.noise, plan.tables.q, strict=False))
        self.ekf = Ekf(motion_of(plan), plan.x, plan.P if P is None else P, noise)
        self.steps: list[tuple[Array, Array, Array, Array, Array]] = []  # F, x-, P-, x, P
        self._plan, self._before = plan, None

    def take(self, sample: Sample) -> None:
        ekf, model = self.ekf, self._plan.card.name
        if sample.fault:
            self.steps.append((np.eye(len(ekf.x)), ekf.x, ekf.P, ekf.x, ekf.P))
            return
        sensor = next(s for s in self._plan.sensors if s.name == sample.sensor)
        drives = sensor.settings.kind == "input"
        if drives and sensor.settings.hold == "previous":
            ekf.u, ekf.U = np.array(sample.z, float), np.array(sample.R).diagonal()
        F = np.eye(len(ekf.x))
        if self._before is not None and sample.t_ns != self._before:
            dt = (sample.t_ns - self._before) * 1e-9
            F = ekf.motion.jacobian(ekf.x, ekf.u, dt)
            ekf.predict(dt)
        self._before = sample.t_ns
        predicted = F, ekf.x.copy(), ekf.P.copy()
        if drives:
            ekf.u, ekf.U = np.array(sample.z, float), np.array(sample.R).diagonal()
        else:
            gate = sensor.settings.gate
            threshold = math.inf if gate is None else chi_square_quantile(gate, sensor.dof)
            R = np.eye(len(sample.z)) * sample.R if np.ndim(sample.R) == 0 else sample.R
            place = place_of(model, sample.sensor, sample.beacon)
            ekf.correct(sample.z, R, MEASURED[model][sample.sensor], place=place, threshold=threshold)
        self.steps.append((*predicted, ekf.x.copy(), ekf.P.copy()))

    def back(self) -> tuple[Array, Array]:
        """x (n, N) and P (n, N, N)."""
        *_, x, P = self.steps[-1]
        xs, Ps = [x], [P]
        for (*_, x, P), (F, x_minus, P_minus, *_) in zip(self.steps[-2::-1], self.steps[:0:-1], strict=True):
            C = np.linalg.solve(P_minus, F @ P).T
            names = self.ekf.motion.names
            apart = [
                wrap(d) if n in self.ekf.motion.angles else d for n, d in zip(names, xs[-1] - x_minus, strict=True)
            ]
            moved = x + C @ np.array(apart)
            xs.append([wrap(v) if n in self.ekf.motion.angles else v for n, v in zip(names, moved, strict=True)])
            Ps.append(P + C @ (Ps[-1] - P_minus) @ C.T)
        return np.array(xs[::-1]), np.array(Ps[::-1])

    def _wrapped(self, x: Array) -> Array:
        return np.where([name in self.ekf.motion.angles for name in self.ekf.motion.names], [wrap(v) for v in x], x)


def mixture(model: str, n: int, seed: int = 3) -> list[Sample]:
    """Samples of all sensors with gaps, equal stamps, outliers and faults, in the total order."""
    rng, samples, t_ns = np.random.default_rng(seed), [], SECOND
    sensors, motion = list(MEASURED[model]), motion_of(setup(model))
    for k in range(n):
        t_ns += int(rng.choice([0, 10, 20, 50, 400])) * MS
        sensor = sensors[int(rng.integers(len(sensors)))]
        beacon = (5.0, -8.0, 2.0)
        if not MEASURED[model][sensor]:
            u = np.array([2.0 + math.sin(t_ns * 1e-9), 0.3])
            samples.append(Sample(t_ns, sensor, u + rng.normal(0, 0.05, 2), np.diag([0.01, 0.002])))
            continue
        z = measure(motion, truth(model, t_ns * 1e-9), MEASURED[model][sensor], place_of(model, sensor, beacon))
        z = z + rng.normal(0, 0.1, len(z)) + (40.0 if k % 11 == 5 else 0.0)
        fault = Decision.INVALID_NAN if k % 13 == 7 else 0
        samples.append(Sample(t_ns, sensor, z, 1.0, beacon, int(fault)))
    ranks = {sensor.name: sensor.rank for sensor in setup(model).sensors}
    return sorted(samples, key=lambda s: (s.t_ns, ranks[s.sensor]))


def gated(model: str, **changes) -> Plan:
    return setup(
        model, sensors={sensor: {"gate": 0.999} for sensor, names in MEASURED[model].items() if names}, **changes
    )


def dense(track: Track) -> Array:
    """P (n, N, N)."""
    return np.array([track.covariance(row) for row in range(len(track))])


@pytest.mark.parametrize("model", MODELS)
def test_rauch_tung_striebel(model: str) -> None:
    plan, samples = gated(model), mixture(model, 150)
    events = events_of(plan, samples)
    forth, back = smoothed(plan, events, [40, 41, 90])
    rts = Rts(plan)
    for sample in samples:
        rts.take(sample)
    x, P = rts.back()
    tolerance = 1e-9 if model == "constant_velocity" else 1e-7
    assert (forth.decision == Decision.GATED).any()
    assert (forth.decision == Decision.FUSED).sum() > 70
    assert np.abs(x).max() < 1e3
    assert np.abs(np.exp(1j * back.x) - np.exp(1j * x)).max() < tolerance  # angles at a whole turn are equal
    assert np.abs(dense(back) - P).max() < tolerance
    for column in fields(Track):
        if column.name not in ("x", "P", "states", "sensors"):
            assert getattr(back, column.name).tobytes() == getattr(forth, column.name).tobytes(), column.name


@pytest.mark.parametrize("model", MODELS)
def test_no_variance_is_above_that_of_the_filter(model: str) -> None:
    plan = gated(model)
    forth, back = smoothed(plan, events_of(plan, mixture(model, 300, seed=8)))
    before, after = dense(forth), dense(back)
    diagonal = np.diagonal(before, axis1=1, axis2=2)
    assert (np.diagonal(after, axis1=1, axis2=2) <= diagonal * (1 + 1e-12)).all()
    scale = np.sqrt(diagonal[:, :, None] * diagonal[:, None, :])
    assert np.linalg.eigvalsh(after / scale).min() > -1e-12
    assert np.linalg.eigvalsh((before - after) / scale).min() > -1e-12
    assert back.x[-1].tobytes() == forth.x[-1].tobytes()
    assert back.P[-1].tobytes() == forth.P[-1].tobytes()


def test_first_values_are_what_a_flat_prior_gives() -> None:
    """Velocities are known first, positions later: both as if the prior of a waiting state had no end."""
    plan = setup("constant_velocity", initial={})
    rng, samples = np.random.default_rng(4), []
    for k in range(60):
        t_ns = SECOND + k * 50 * MS
        true = truth("constant_velocity", t_ns * 1e-9)
        if k % 3 == 0 and k > 20:
            samples.append(Sample(t_ns, "lidar", true[:2] + rng.normal(0, 0.1, 2), 0.01))
        else:
            samples.append(Sample(t_ns, "speed", true[2:] + rng.normal(0, 0.3, 2), 0.09))
    _, back = smoothed(plan, events_of(plan, samples), [10, 25])
    rts = Rts(plan, np.eye(4) * 1e7)
    for sample in samples:
        rts.take(sample)
    x, P = rts.back()
    first = next(k for k, sample in enumerate(samples) if sample.sensor == "lidar")
    assert np.isnan(back.x[:first, :2]).all()
    assert not np.isnan(back.x[first:]).any()
    assert np.abs(back.x[:, 2:] - x[:, 2:]).max() < 1e-5
    assert np.abs(back.x[first:] - x[first:]).max() < 1e-5
    assert np.abs(dense(back)[:, 2:, 2:] - P[:, 2:, 2:]).max() < 1e-5
    assert np.abs(dense(back)[first:] - P[first:]).max() < 1e-5


@pytest.mark.parametrize("model", ["unicycle", "attitude"])
def test_states_known_late_leave_sound_covariances(model: str) -> None:
    """First values through a lever arm, levelled attitudes, and updates while others still wait."""
    rng = np.random.default_rng(6)
    if model == "unicycle":
        plan = setup("unicycle", initial={})
        first = [Sample(SECOND + k * 50 * MS, "wheel", [2.0, 0.1], 0.01) for k in range(5)]
        first += [Sample(SECOND + 240 * MS, "gps", [3.0, 1.0], 0.25), Sample(SECOND + 245 * MS, "compass", [0.4], 0.01)]
        samples = first + [s._replace(t_ns=s.t_ns + SECOND) for s in mixture("unicycle", 60)]
    else:
        plan, field = plan_of("attitude", initial={}), (0.0, 20e-6, -40e-6)
        samples = [Sample(SECOND, "gyro", [0.0, 0.0, 0.1], 1e-6), Sample(SECOND + MS, "up", G, 0.01)]
        for k in range(2, 60):
            at = SECOND + k * 10 * MS
            samples += [
                Sample(at, "gyro", rng.normal(0, 0.2, 3), 1e-6),
                Sample(at, "up", G + rng.normal(0, 0.1, 3), 0.01),
            ]
            samples += [Sample(at, "compass", [math.pi / 2 + rng.normal(0, 0.1)], 0.01, field)] if k > 20 else []
    forth, back = smoothed(plan, events_of(plan, samples), [3, 9])
    assert np.isnan(forth.x).any()
    assert np.array_equal(np.isnan(forth.x), np.isnan(back.x))
    before, after = dense(forth), dense(back)
    diagonal = np.diagonal(before, axis1=1, axis2=2)
    scale = np.sqrt(diagonal[:, :, None] * diagonal[:, None, :])
    assert np.linalg.eigvalsh(after / scale).min() > -1e-10
    assert np.linalg.eigvalsh((before - after) / scale).min() > -1e-10
    assert (after[0].diagonal() < 0.9 * before[0].diagonal()).any()


def test_gains_of_other_modes_are_not_used() -> None:
    events = events_of(gated("unicycle"), mixture("unicycle", 80))
    weights = {"gps.x": 0.4, "gps.y": 0.4, "wheel.v": 0.5, "wheel.yaw_rate": 0.5, "compass.yaw": 0.3, "corner.v": 0.1}
    weights |= {"radar.range": 0.1, "radar.bearing": 0.1, "radar.range_rate": 0.1, "uwb.range": 0.2}
    fixed = gated("unicycle", gain={"mode": "fixed", "weights": weights})
    assert_same_bytes(smoothed(fixed, events)[1], smoothed(gated("unicycle"), events)[1])


@LAW
@given(case=arrivals(), places=st.lists(st.integers(0, 80), max_size=10))
def test_no_bit_depends_on_segments(case, places) -> None:
    model, samples = case
    events = settled(PLANS[model], events_of(PLANS[model], samples))
    _, whole = smoothed(PLANS[model], events)
    for cuts in (places, range(events.size)):
        assert_same_bytes(smoothed(PLANS[model], events, list(cuts))[1], whole)


@LAW
@given(case=arrivals(most_late_ms=100), seed=st.integers(0, 1 << 30))
def test_late_samples_are_smoothed_as_if_they_had_been_in_time(case, seed) -> None:
    model, samples = case
    samples = [sample for sample in {(s.t_ns, s.sensor): s for s in samples}.values() if not sample.fault]
    events = events_of(PLANS[model], samples)
    in_time = events.take(np.lexsort((events.seq, events.sensor, events.t_ns)))
    jitter = np.random.default_rng(seed).uniform(0, PLANS[model].tables.window_ns, events.size)
    late = in_time.take(np.argsort(in_time.t_ns + jitter, kind="stable"))
    in_time, late = settled(PLANS[model], in_time), settled(PLANS[model], late)
    one, other = smoothed(PLANS[model], in_time)[1], smoothed(PLANS[model], late)[1]
    assert one.x.tobytes() == other.x.tobytes()
    assert one.P.tobytes() == other.P.tobytes()


def test_with_a_rate_only_what_is_published_is_made() -> None:
    plan = gated("unicycle")
    events = events_of(plan, mixture("unicycle", 200))
    forth, whole = smoothed(plan, events)
    _, thin = smoothed(plan, events, [50, 51, 120], rate=2.0)
    period = forth.t_ns // (SECOND // 2)
    moved = np.flatnonzero(forth.decision <= Decision.GATED)
    last = moved[np.append(period[moved][1:] != period[moved][:-1], True)]
    made = np.flatnonzero(~np.isnan(thin.x).all(axis=1))
    assert made.tolist() == last.tolist()
    assert thin.x[made].tobytes() == whole.x[made].tobytes()
    assert thin.P[made].tobytes() == whole.P[made].tobytes()


LAGGING = {
    model: setup(
        model,
        lag={"window": "200 ms"},
        smooth=SMOOTH,
        sensors={sensor: {"gate": 0.9} for sensor, names in MEASURED[model].items() if names},
    )
    for model in PLANS
}


@LAW
@given(case=arrivals(), places=st.lists(st.integers(0, 80), max_size=30))
def test_fixed_lag_does_not_depend_on_batches(case, places) -> None:
    model, samples = case
    plan = LAGGING[model]
    events = settled(plan, events_of(plan, samples))
    whole = FixedLag(plan).advance(events)
    for cuts in (places, list(range(events.size))):
        smoother = FixedLag(plan)
        assert_same_bytes(join_tracks([smoother.advance(batch) for batch in cut(events, cuts)]), whole)


@pytest.mark.parametrize("model", LAGGING)
def test_fixed_lag_is_fixed_interval_up_to_the_lag(model: str) -> None:
    """Long enough for the history to let go and to grow; every tick is there that can be."""
    plan, samples = LAGGING[model], mixture(model, 1500)
    events = events_of(plan, samples)
    smoother = FixedLag(plan)
    found = join_tracks([smoother.advance(batch) for batch in cut(events, list(range(0, 1500, 7)))])
    lag, period = 300 * MS, 100 * MS
    stamps = events.t_ns[events.fault == 0]
    ticks = np.unique(-(-stamps // period) * period)
    ticks = ticks[ticks + lag < stamps[-1]]
    assert found.t_ns.tolist() == [int(stamps[stamps <= tick][-1]) for tick in ticks]
    for row in range(0, len(found), 29):
        known = events.take(np.flatnonzero(events.t_ns <= ticks[row] + lag))
        _, whole = smoothed(plan, known)
        at = np.flatnonzero((whole.stamp_ns <= ticks[row]) & (known.fault == 0))[-1]
        for name in ("x", "P", "nis", "decision", "sensor", "seq", "innovation"):
            assert getattr(found, name)[row].tobytes() == getattr(whole, name)[at].tobytes(), name


FLIGHT = {name: INS[name] for name in ("imu", "fix", "doppler", "compass")}
FLIGHT_SD = np.concatenate([np.full(3, sd) for sd in (1.0, 0.05, 0.3, 0.01, 0.05)])


def flight(seed: int, *, scale: float = 1.0, seconds: float = 3.0) -> tuple[Plan, list[Sample], list[State]]:
    """A simulated flight of ins3d: a plan that begins beside the truth, the samples, and the truth after each."""
    rng, dt_ns, density = np.random.default_rng(seed), 10 * MS, plan_of("ins3d").tables.q[:15]
    true = State("ins3d", np.array([0, 0, 0, 0.1, 0.4, 0.5, 3, 1, 0.2, *np.zeros(6)]))
    begin, t_ns = true.plus(rng.normal(0, 1, 15) * scale * FLIGHT_SD), SECOND
    names = list(plan_of("ins3d").states)
    given = {"state": begin.x.tolist(), "sd": (scale * FLIGHT_SD).tolist()}
    given = {key: dict(zip(names, values, strict=True)) for key, values in given.items()}
    samples, truths = [], []
    for k in range(int(seconds * 100)):
        push = G + np.array([0.3, 0.2 * math.sin(k / 30), 0.0])
        u = np.array([0.2 * math.cos(k / 50), -0.1, 0.3, *true.rotation.inv().apply(push)])
        u += np.concatenate([true.x[9:12], true.x[12:15]])
        samples.append(Sample(t_ns, "imu", u + rng.normal(0, 1e-3, 6) / math.sqrt(dt_ns * 1e-9), 1e-6))
        if k % 20 == 10:
            field = true.rotation.inv().apply([0.0, 1.0, -2.0])
            fix = true.seen("fix", u, np.zeros(3)) + rng.normal(0, 0.5 * scale, 3)
            samples.append(Sample(t_ns, "fix", fix, (0.5 * scale) ** 2))
            heading = math.pi / 2 + rng.normal(0, 0.1 * scale)
            samples.append(Sample(t_ns, "compass", [heading], (0.1 * scale) ** 2, tuple(field)))
        truths += [true] * (len(samples) - len(truths))
        true = true.moved(u, dt_ns * 1e-9)
        true = true.plus(rng.normal(0, 1, 15) * np.sqrt(density * dt_ns * 1e-9))
        t_ns += dt_ns
    return plan_of("ins3d", initial=given, sensors=FLIGHT), samples, truths


def test_rauch_tung_striebel_of_attitudes() -> None:
    """With turns about body axes and F by central differences, where corrections are small enough to add up."""
    plan, samples, _ = flight(1, scale=1e-3)
    forth, back = smoothed(plan, events_of(plan, samples), [50])
    states, P = [State("ins3d", x) for x in forth.x], dense(forth)
    x, P_s, u = states[-1], P[-1], [np.array(sample.z) for sample in samples if sample.sensor == "imu"]
    for k in range(len(samples) - 2, -1, -1):
        if samples[k + 1].sensor == "imu":  # a prediction and nothing else: what is there after it was there before
            u.pop()
            F = differences(lambda s: s.moved(u[-1], 0.01), states[k])
            C = np.linalg.solve(P[k + 1], F @ P[k]).T
            x = states[k].plus(C @ x.minus(states[k + 1]))
            P_s = P[k] + C @ (P_s - P[k + 1]) @ C.T
        scale = np.sqrt(P[k].diagonal())
        assert np.abs(State("ins3d", back.x[k]).minus(x) / scale).max() < 1e-3
        assert np.abs((back.covariance(k) - P_s) / np.outer(scale, scale)).max() < 1e-4
    assert np.abs(State("ins3d", back.x[0]).minus(states[0]) / np.sqrt(P[0].diagonal())).max() > 0.3


def test_flights_are_consistent_and_better_than_filtered() -> None:
    """NEES of smoothed ins3d at the start, inside, and at the end of each flight, and errors that shrink."""
    runs, rows = 25, (0, 100, 200, -1)
    nees, errors = np.empty((runs, len(rows))), np.zeros((2, 15))
    for run in range(runs):
        plan, samples, truths = flight(run)
        forth, back = smoothed(plan, events_of(plan, samples), [77])
        for column, row in enumerate(rows):
            error = truths[row].minus(State("ins3d", back.x[row]))
            nees[run, column] = error @ np.linalg.solve(back.covariance(row), error)
        for k in range(0, len(truths), 10):
            for which, track in enumerate((forth, back)):
                errors[which] += truths[k].minus(State("ins3d", track.x[k])) ** 2
    band = 1.96 * math.sqrt(2 * 15 / runs)
    assert (np.abs(nees.mean(axis=0) - 15) < band).all(), nees.mean(axis=0)
    position, attitude, velocity = slice(0, 3), slice(3, 6), slice(6, 9)
    for part in (position, attitude, velocity):
        assert errors[1, part].sum() < 0.5 * errors[0, part].sum()


def apart(x: Array, y: Array) -> Array:
    """x - y of omni3d."""
    d = x - y
    d[3:6] = [wrap(angle) for angle in d[3:6]]
    return d


def test_drives_of_omni3d_are_consistent_and_better_than_filtered() -> None:
    runs, rows = 25, (0, 60, 150, -1)
    names = motion_of(setup("omni3d")).names
    sd = np.array([1.0] * 3 + [0.05] * 3 + [0.2] * 3 + [0.05] * 3 + [0.1] * 3)
    density = dict(zip(names, [0.01] * 3 + [1e-4] * 3 + [0.05] * 3 + [0.02] * 3 + [0.05] * 3, strict=True))
    start = np.array([0, 0, 0, 0.1, -0.1, 0.5, 2, 0.3, 0.1, 0.1, 0.05, 0.3, 0.1, 0.1, 0])
    nees, errors = np.empty((runs, len(rows))), np.zeros((2, 15))
    for run in range(runs):
        rng = np.random.default_rng(run)
        begin = start + rng.normal(0, 1, 15) * sd
        initial = {"state": dict(zip(names, begin.tolist(), strict=True)), "sd": dict(zip(names, sd, strict=True))}
        plan = setup("omni3d", initial=initial, model={"name": "omni3d", "process_noise": density})
        motion, x, samples, truths = motion_of(plan), start, [], []
        for k in range(300):
            sensor = ("wheel", "imu", "wheel", "gps")[k % 4] if k % 8 == 3 else ("imu", "wheel")[k % 2]
            z = measure(motion, x, MEASURED["omni3d"][sensor], place_of("omni3d", sensor))
            noise = {"imu": 0.05, "wheel": 0.1, "gps": 0.5}[sensor]
            samples.append(Sample(SECOND + k * 20 * MS, sensor, z + rng.normal(0, noise, len(z)), noise**2))
            truths.append(x)
            x = motion.f(x, None, 0.02) + rng.normal(0, 1, 15) * np.sqrt(plan.tables.q[:15] * 0.02)
            x[3:6] = [wrap(angle) for angle in x[3:6]]
        forth, back = smoothed(plan, events_of(plan, samples), [77])
        for column, row in enumerate(rows):
            error = apart(truths[row], back.x[row])
            nees[run, column] = error @ np.linalg.solve(back.covariance(row), error)
        for which, track in enumerate((forth, back)):
            errors[which] += sum(apart(true, x) ** 2 for true, x in zip(truths, track.x, strict=True))
    band = 1.96 * math.sqrt(2 * 15 / runs)
    assert (np.abs(nees.mean(axis=0) - 15) < band).all(), nees.mean(axis=0)
    assert (errors[1] < errors[0]).all(), errors[1] / errors[0]


def test_corrections_of_attitudes_are_turns() -> None:
    """Far from the wrong start of the filter, the smoothed attitude is the true one, whatever the axes."""
    states = ("roll", "pitch", "yaw")
    initial = {"state": {"roll": 0.5, "pitch": -0.3, "yaw": 0.8}, "sd": dict.fromkeys(states, 1.0)}
    plan = plan_of("attitude", initial=initial)
    samples = [Sample(SECOND, "gyro", [0.0, 0.0, 0.0], 1e-8)]
    samples += [Sample(SECOND + k * 100 * MS, "vision", [0.0, 0.0, 0.0], 1e-4) for k in range(1, 30)]
    forth, back = smoothed(plan, events_of(plan, samples))
    assert np.abs(forth.x[0, :3]).max() > 0.7
    assert np.abs(back.x[:, :3]).max() < 0.1
    assert np.abs(back.x[1:, :3]).max() < 0.04
