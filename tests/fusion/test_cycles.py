"""Samples of a period that are fused at once by fixed weights, and what happens when sensors are missing."""

import math

import numpy as np
import pytest
from tests.fusion.setups import Sample, events_of, make_plan
from tests.fusion.test_laws import assert_same_bytes, by_stamp

from fuselog.fusion import Decision, Engine, Plan, Track
from fuselog.schemas import ConfigError

SECOND = 1_000_000_000
SD = {"a": 0.1, "b": 0.2, "c": 0.4}
TOTAL = 1 / sum(1 / sd**2 for sd in SD.values())  # m², of the mean of all sensors
SHARES = {name: TOTAL / sd**2 for name, sd in SD.items()}
SPEED = {"topic": "/v", "kind": "input", "noise": {"v": 1e-9}}


def plan_of(total: float, *, cycle: dict | None, form: str = "state", **gain: object) -> Plan:
    """A random walk seen by three sensors whose fixed weights are the steady optimal ones for this total."""
    shares = {f"{name}.x": total * share for name, share in SHARES.items()}
    weights = {"x": shares} if form == "state" else shares
    sensors = {name: {"topic": f"/{name}", "fuse": ["x"], "noise": {"x": sd}} for name, sd in SD.items()}
    return make_plan(
        {
            "model": {"name": "brownian", "process_noise": {"x": walk(total)}},
            "initial": {"state": {"x": 0}, "sd": {"x": 0.1}},
            "gain": {"mode": "fixed", "form": form, "weights": weights, **({"cycle": cycle} if cycle else {}), **gain},
            "lag": {"window": "3 s"},
            "sensors": {"speed": SPEED, **sensors},
        }
    )


def walk(total: float) -> float:
    """The variance a second with which ``total`` is the steady gain of sensors that come every second."""
    return TOTAL * total**2 / (1 - total)


def samples_of(truth: np.ndarray, seed: int, *, dropped: float = 0.0, jitter: float = 0.0) -> list[Sample]:
    """Each second all sensors but those that are dropped, up to ``jitter`` seconds early."""
    rng, samples = np.random.default_rng(seed), list[Sample]()
    for k, x in enumerate(truth, 1):
        samples.append(Sample(k * SECOND, "speed", [0.0], 1e-18))
        for name, sd in SD.items():
            t_ns = k * SECOND - round(rng.uniform(0, jitter) * SECOND)
            z = x + rng.normal(0, sd)
            if rng.uniform() >= dropped:
                samples.append(Sample(t_ns, name, [z], sd**2))
    return samples


def at_moments(track: Track) -> np.ndarray:
    """The estimate after all samples of each moment."""
    last = np.append(track.t_ns[1:] != track.t_ns[:-1], True)
    return track.x[last, 0]


@pytest.mark.parametrize(
    ("total", "prediction", "renormalize", "rescale"),
    [(0.20, 0.0446, 0.0583, 0.0440), (0.66, 0.0936, 0.1154, 0.0890), (0.97, 0.280, 0.172, 0.1595)],
)
def test_the_weight_of_missing_sensors(total: float, prediction: float, renormalize: float, rescale: float) -> None:
    """Each sensor drops three samples of ten: the error by rule, for weights whose sum is ``total``."""
    rng = np.random.default_rng(1)
    truth = np.cumsum(rng.normal(0, math.sqrt(walk(total)), 20_000))
    samples = samples_of(truth, 2, dropped=0.3)
    for missing, expected in zip(
        ("prediction", "renormalize", "rescale"), (prediction, renormalize, rescale), strict=True
    ):
        plan = plan_of(total, cycle={"missing": missing})
        error = at_moments(Engine(plan).advance(events_of(plan, samples))) - truth
        assert np.sqrt(np.mean(error**2)) == pytest.approx(expected, rel=0.03), missing


@pytest.mark.parametrize("form", ["state", "absorb"])
def test_a_cycle_is_equation_29(form: str) -> None:
    """Samples anywhere in the period count at its end, all at once: x + the sum of g (z - x)."""
    plan = plan_of(0.6, cycle={"period": "1 s"}, form=form)
    truth = np.cumsum(np.random.default_rng(3).normal(0, 0.1, 50))
    samples = samples_of(truth, 4, jitter=0.9)
    x, estimates = 0.0, at_moments(Engine(plan).advance(events_of(plan, samples)))
    for k, estimate in enumerate(estimates, 1):
        z = {s.sensor: s.z[0] for s in samples if -(-s.t_ns // SECOND) == k}
        x += sum(0.6 * SHARES[name] * (z[name] - x) for name in SHARES)
        assert estimate == pytest.approx(x, abs=1e-13)


def test_the_order_of_arrival_makes_no_difference() -> None:
    plan = plan_of(0.6, cycle={"period": "1 s", "max_age": "1.5 s"})
    samples = samples_of(np.zeros(60), 5, dropped=0.2, jitter=0.9)
    rng = np.random.default_rng(6)
    shuffled = [samples[i] for i in np.argsort([s.t_ns + rng.integers(0, SECOND) for s in samples])]
    received = Engine(plan)
    for sample in np.array_split(np.arange(len(shuffled)), 7):
        received.advance(events_of(plan, shuffled).take(sample))
    sorted_samples = sorted(samples, key=lambda s: s.t_ns)
    one, stamped = by_stamp(plan, [events_of(plan, shuffled)])
    other, _ = by_stamp(plan, [events_of(plan, sorted_samples)])
    assert received.estimate.x.tobytes() == stamped.estimate.x.tobytes()
    assert received.estimate.P.tobytes() == stamped.estimate.P.tobytes()
    assert np.array_equal(received.counts, stamped.counts)
    assert one.x.tobytes() == other.x.tobytes()


def test_batches_make_no_difference() -> None:
    plan = plan_of(0.6, cycle={"period": "1 s"})
    events = events_of(plan, samples_of(np.zeros(40), 7, dropped=0.2, jitter=0.9))
    whole, _ = by_stamp(plan, [events])
    single, _ = by_stamp(plan, [events.take(slice(i, i + 1)) for i in range(events.size)])
    assert_same_bytes(single, whole)


def test_a_sensor_has_one_vote_a_cycle() -> None:
    """Its newest sample counts, by stamp; the others are skipped, and the account says so."""
    plan = plan_of(0.5, cycle={"period": "1 s", "missing": "prediction"})
    early, late = Sample(SECOND + 1, "a", [9.0], 0.01), Sample(SECOND + 2, "a", [1.0], 0.01)
    for samples in ([early, late], [late, early]):
        engine = Engine(plan)
        engine.advance(events_of(plan, samples))
        assert engine.estimate.t_ns == 2 * SECOND
        assert engine.estimate.x[0] == pytest.approx(0.5 * SHARES["a"])
        assert engine.counts[1, Decision.SKIPPED] == 1
        assert engine.counts[1, Decision.FUSED] == 1


def test_a_cycle_with_a_missing_sensor_can_be_skipped() -> None:
    """With ``max_age`` a sensor may be late by that much before its weight is passed on, or the cycle left out."""
    cycle = {"period": "1 s", "missing": "skip", "max_age": "2 s"}
    plan = plan_of(0.5, cycle=cycle)
    samples = [Sample(SECOND, name, [1.0], sd**2) for name, sd in SD.items()]
    engine = Engine(plan)
    engine.advance(events_of(plan, samples))
    together = engine.estimate.x[0]
    assert together == pytest.approx(0.5)
    for k, moves in ((2, True), (3, True), (4, False)):
        before = engine.estimate.x[0]
        engine.advance(events_of(plan, [Sample(k * SECOND, name, [1.0], 0.01) for name in ("a", "b")]))
        assert (engine.estimate.x[0] != before) == moves
    assert engine.counts[:, Decision.SKIPPED].tolist() == [0, 1, 1, 0]


@pytest.mark.parametrize(
    ("gain", "expected"),
    [
        ({"mode": "optimal", "cycle": {"period": 1}}, "gain.cycle: is for fixed weights"),
        (
            {"mode": "fixed", "weights": {"a.x": 0.1}, "cycle": {"period": 1, "max_age": 0.5}},
            "gain.cycle.max_age: is less than the period",
        ),
        (
            {"mode": "fixed", "form": "matrix", "weights": {"x": {"a.x": 0.1}}, "cycle": {"period": 1}},
            "gain.cycle: is for fixed weights, form: absorb or state",
        ),
    ],
)
def test_cycles_that_make_no_sense(gain: dict, expected: str) -> None:
    sensors = {"a": {"topic": "/a", "fuse": ["x"]}}
    with pytest.raises(ConfigError, match=expected.replace("[", r"\[")):
        make_plan({"model": {"name": "brownian"}, "gain": gain, "sensors": sensors})
