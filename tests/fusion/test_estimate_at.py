"""The estimate at a time: predicted by the model from what the filter has, and without touching it."""

import numpy as np
import pytest
from tests.fusion.runs import BEGIN, MS, POINT, SECOND, drive, merged, opened, plan_of
from tests.fusion.setups import Sample, events_of, make_plan

from fuselog.fusion import CommandError, Decision, Engine, Events, Filter


def fed(name: str) -> Filter:
    topics, messages = drive(name)
    filter = opened(name, topics, "as_received")
    filter.feed(messages.take(slice(0, len(messages) * 4 // 5)))
    return filter


@pytest.mark.parametrize("name", ["point", "careful", "cycles", "body"])
def test_the_filter_stays_as_it_is(name: str) -> None:
    filter = fed(name)
    newest = filter.estimate.t_ns
    before = filter.checkpoint()
    assert newest is not None
    for t_ns in (newest - 250 * MS, newest, newest + 1, newest + 30 * SECOND):
        assert filter.estimate_at(t_ns).t_ns == t_ns
    assert filter.checkpoint() == before


@pytest.mark.parametrize("name", ["point", "body"])
@pytest.mark.parametrize("ahead_ms", [0, 3, 900])
def test_it_is_what_a_refused_sample_leaves(name: str, ahead_ms: int) -> None:
    """Bit for bit: a sample that its gate refuses is one that says nothing."""
    filter = fed(name)
    engine, plan = Engine(filter.plan), filter.plan
    engine.restore(filter.snapshot())
    t_ns = engine.estimate.t_ns + ahead_ms * MS
    predicted = filter.estimate_at(t_ns)
    sensor = plan.sensors[0]
    events = events_of(plan, [Sample(t_ns, sensor.name, np.full(sensor.dof, 2.9), 1e-9)])
    track = engine.advance(events._replace(seq=np.array([9999])))
    assert track.decision[0] == Decision.GATED
    assert predicted.x.tobytes() == engine.estimate.x.tobytes()
    assert predicted.P.tobytes() == engine.estimate.P.tobytes()


def test_it_is_the_estimate_of_each_row_in_the_window() -> None:
    plan = plan_of("point")
    engine = Engine(plan)
    track = engine.advance(events_in_order())
    last = {int(t): row for row, t in enumerate(track.t_ns)}
    for t_ns in [t for t in last if t >= int(track.t_ns[-1]) - plan.tables.window_ns]:
        estimate = engine.estimate_at(t_ns)
        assert estimate.x.tobytes() == track.x[last[t_ns]].tobytes()


def events_in_order(n: int = 60) -> Events:
    rng, plan = np.random.default_rng(5), plan_of("point")
    names = [sensor.name for sensor in plan.sensors]
    return events_of(plan, [Sample(BEGIN + k * 17 * MS, names[k % 2], rng.normal(size=2), 0.01) for k in range(n)])


def test_the_covariance_grows_as_the_model_says() -> None:
    engine, dt = Engine(plan_of("point")), 0.75
    engine.advance(events_in_order())
    now = engine.estimate
    later = engine.estimate_at(now.t_ns + round(dt * 1e9))
    F = np.eye(4)
    F[0, 2] = F[1, 3] = dt
    Q = np.zeros((4, 4))
    for axis, q in enumerate((0.7, 0.4)):
        Q[axis, axis], Q[axis + 2, axis + 2] = q * dt**3 / 3, q * dt
        Q[axis, axis + 2] = Q[axis + 2, axis] = q * dt**2 / 2
    assert later.x == pytest.approx(F @ now.x, rel=1e-12)
    assert pytest.approx(F @ now.P @ F.T + Q, rel=1e-12) == later.P


def test_what_there_is_no_estimate_of() -> None:
    engine = Engine(make_plan(merged(POINT, lag={"window": 0.3, "max_step": 2.0})))
    with pytest.raises(CommandError, match="no estimate yet"):
        engine.estimate_at(BEGIN)
    engine.advance(events_in_order())
    newest = engine.estimate.t_ns
    assert engine.estimate_at(newest + 2 * SECOND).t_ns == newest + 2 * SECOND
    for t_ns in (newest - SECOND, newest + 2 * SECOND + 1, 0, -5, (1 << 63) - 1):
        with pytest.raises(CommandError, match=rf"no estimate at {t_ns} ns: there are such from \d+ to {newest} ns"):
            engine.estimate_at(t_ns)


def test_a_model_of_steps_has_none_between_them() -> None:
    noise = {"Q": [[1e-4, 0], [0, 1e-2]]}
    model = {"name": "linear", "states": {"p": "m", "v": "m/s"}, "step": 0.1, "F": [[1, 0.1], [0, 1]], **noise}
    sensor = {"topic": "/p", "fuse": ["p"], "fields": {"p": "data"}, "noise": {"p": 0.1}}
    plan = make_plan({"model": model, "sensors": {"p": sensor}})
    engine = Engine(plan)
    engine.advance(events_of(plan, [Sample(BEGIN + k * 100 * MS, "p", 1.0 + k, 0.01) for k in range(20)]))
    now = engine.estimate
    assert engine.estimate_at(now.t_ns + 200 * MS).x[0] == pytest.approx(now.x[0] + 0.2 * now.x[1])
    with pytest.raises(CommandError, match="between the steps"):
        engine.estimate_at(now.t_ns + 150 * MS)
