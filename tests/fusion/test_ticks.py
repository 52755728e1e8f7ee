"""Estimates at event-time ticks, and settled ones: beside the rows, of known values, the same in any cut."""

import numpy as np
import pytest
from tests.fusion.runs import BEGIN, CASES, MS, Written, drive, merged, opened, pieces, plan_of
from tests.fusion.setups import make_plan
from tests.logs import messages_of, position

from fuselog.fusion import Engine, Outputs, SetState
from fuselog.schemas import ConfigError

TICK_MS = 20  # of the case "smoothed"


def written(name: str, order, cuts) -> dict[str, bytes]:
    topics, messages = drive(name, seed=7)
    filter, all_bytes = opened(name, topics, order), Written(plan_of(name))
    for piece in pieces(messages, cuts):
        all_bytes.add(filter.feed(piece), filter.beside())
    all_bytes.add(filter.finish(), filter.beside())
    return all_bytes.finish()


@pytest.mark.parametrize("name", ["smoothed", "cycles"])
def test_any_cut_gives_the_same_bytes(name: str) -> None:
    n = len(drive(name, seed=7)[1])
    for order in ("as_received", "by_stamp"):
        whole = written(name, order, ())
        assert whole["fused/odom/tick"]
        assert written(name, order, range(n)) == whole
        assert written(name, order, np.random.default_rng(1).integers(0, n, 9).tolist()) == whole


@pytest.mark.parametrize("name", ["smoothed", "cycles"])
def test_the_settled_ones_are_those_in_the_order_of_stamps(name: str) -> None:
    received, stamped = written(name, "as_received", (3, 50)), written(name, "by_stamp", (11, 90))
    assert received["fused/odom/settled"] == stamped["fused/odom"]
    assert received["fused/odom/settled"] != received["fused/odom"]
    assert stamped["fused/odom/settled"] == b""


@pytest.mark.parametrize("order", ["as_received", "by_stamp"])
def test_a_tick_is_what_was_known_before_the_first_sample_after_it(order) -> None:
    topics, messages = drive("smoothed", seed=7)
    filter, witness = opened("smoothed", topics, order), opened("smoothed", topics, order)
    engine, told, t_ns = Engine(plan_of("smoothed"), window_ns=None if order == "as_received" else 0), {}, None
    expected = {}
    for piece in pieces(messages, range(len(messages))):
        events = witness.prepare(piece).events
        for row in range(events.size):
            one = events.take(slice(row, row + 1))
            stamp = int(one.t_ns[0])
            if one.fault[0] == 0:
                while t_ns is not None and t_ns < stamp:
                    if engine.estimate.known.all():
                        expected[t_ns] = engine.estimate_at(t_ns)
                    t_ns += TICK_MS * MS
                if t_ns is None:
                    t_ns = -(-stamp // (TICK_MS * MS)) * TICK_MS * MS
            engine.advance(one)
        filter.feed(piece)
        ticks = filter.beside().ticks
        if ticks is not None:
            told |= dict(zip(ticks.t_ns.tolist(), zip(ticks.x, ticks.P, strict=True), strict=True))
    assert list(told) == list(expected)
    assert len(told) > 50
    for t, (x, P) in told.items():
        assert x.tobytes() == expected[t].x.tobytes()
        assert P.tobytes() == expected[t].P[np.triu_indices(4)].tobytes()


def test_ticks_end_in_a_long_silence() -> None:
    plan = make_plan(merged(CASES["point"].config, output={"ticks": 10}, lag={"window": 0.3, "max_step": 2.0}))
    stamps = BEGIN + np.array([0, 100, 200, 86_400_000, 86_400_100, 86_400_200, 86_400_300, 86_400_400]) * MS
    topic = position(stamps, x=np.arange(8.0), y=0.0, topic="/one")
    filter = opened("point", [topic], "as_received", plan)
    filter.command(SetState({"vx": 0.0, "vy": 0.0}, {}))
    filter.feed(messages_of([topic]))
    ticks = filter.beside().ticks
    assert ticks is not None
    steps = (ticks.t_ns - BEGIN) // (100 * MS)
    assert steps.tolist() == [0, 1, *range(2, 23), 864_003]


def test_ticks_are_not_there_by_default() -> None:
    names = [output.topic for output in Outputs(plan_of("point")).topics]
    assert names == ["fused/odom", "fused/odom/decision", "fused/odom/command"]


def test_a_model_of_fixed_steps_has_no_ticks() -> None:
    model = {"name": "linear", "states": {"p": "m"}, "step": 0.1, "F": [[1]], "Q": [[1]]}
    sensor = {"topic": "/p", "fuse": ["p"], "fields": {"p": "data"}, "noise": {"p": 0.1}}
    with pytest.raises(ConfigError, match=r"output\.ticks: a model of fixed steps"):
        make_plan({"model": model, "sensors": {"p": sensor}, "output": {"ticks": 10}})
