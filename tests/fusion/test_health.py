"""Health of filters whose trouble the test makes: each is said with its reason, and nothing else is."""

import re
from collections.abc import Sequence

import numpy as np
import pytest

from fuselog.fusion import Decision, Filter, Stream, compile_plan, parse_config
from fuselog.fusion.health import Health, Losses, Seen, assess, no_samples, remember, seen
from fuselog.schemas import CdrEncoder, Messages, definition

KIND = "geometry_msgs/msg/PoseStamped"
S = 1_000_000_000
CONFIG = """\
fuselog: 1
model: {name: constant_velocity, process_noise: {ax: 0.01, ay: 0.01}}
initial: {state: {vx: 0, vy: 0}, sd: {vx: 0.1, vy: 0.1}}
lag: {window: 0.5 s}
sensors:
  a: {topic: /a, fuse: [x, y], noise: {x: 1, y: 1}, gate: 0.99}
  b: {topic: /b, fuse: [x, y], noise: {x: 1, y: 1}}
"""
PLAN = compile_plan(*parse_config(CONFIG))
Rows = Sequence[tuple[str, float, float, float]]  # topic, stamp s, x, y


def health_of(rows: Rows, *, losses: dict[str, Losses] | None = None, pieces: int = 1) -> Health:
    """The health after these samples."""
    filter, recent = Filter(PLAN, order="as_received"), no_samples(PLAN)
    text = definition(KIND)
    encoder = CdrEncoder(KIND, text, columns=["pose.position.x", "pose.position.y"])
    for number, topic in enumerate("ab"):
        stream = Stream(topic=topic, encoding="cdr", schema_name=KIND, schema_encoding="ros2msg", schema_text=text)
        filter.intake.open(number, stream)
    for some in np.array_split(np.arange(len(rows)), pieces):
        part = [rows[i] for i in some]
        stamps = np.array([round(t * S) for _, t, _, _ in part], np.int64)
        data, size = encoder.encode(stamps, np.array([[x, y] for _, _, x, y in part]).reshape(-1, 2))
        n = len(part)
        messages = Messages(
            stream=np.array(["ab".index(topic) for topic, _, _, _ in part], np.int32),
            data=data,
            start=np.arange(n) * size,
            length=np.full(n, size),
            log_time=stamps,
            publish_time=stamps,
            sequence=np.zeros(n, np.int64),
        )
        recent = remember(recent, [seen(filter.feed(messages))])
    return assess(PLAN, estimate=filter.estimate, ledger=filter.ledger, recent=recent, losses=losses or {})


def noise(n: int, sd: float = 1.0, seed: int = 3) -> list[tuple[float, float]]:
    """Positions of a target that stands still."""
    return [(float(x), float(y)) for x, y in sd * np.random.default_rng(seed).normal(size=(n, 2))]


def both(n: int, sd: float = 1.0) -> list[tuple[str, float, float, float]]:
    """n samples of each sensor at 10 Hz."""
    return [("ab"[i % 2], 1 + i * 0.05, x, y) for i, (x, y) in enumerate(noise(2 * n, sd))]


def test_a_sound_filter_is_ok() -> None:
    """Right noise: NIS near its degrees of freedom, 5 % outside, nothing to say."""
    health = health_of(both(400))
    assert (health.status, health.reasons) == ("healthy", ())
    assert health.finite
    assert health.positive
    nis = health.sensors["b"].nis
    assert nis is not None
    assert (nis.tried, nis.dof) == (200, 2)
    assert 1.5 < nis.mean < 2.5
    assert nis.outside_95 < 0.1
    assert health.sensors["a"].period_s == pytest.approx(0.1)


def test_pieces_make_no_difference() -> None:
    """The memory is the same however the samples came."""
    assert health_of(both(150)) == health_of(both(150), pieces=77)


def test_nothing_yet() -> None:
    """Initializing until something is fused, then degraded while a sensor waits; one that is there does not."""
    nothing = health_of([])
    assert nothing.status == "initializing"
    assert nothing.reasons == ("a: no sample on /a yet", "b: no sample on /b yet", "nothing has been fused yet")
    some = health_of([row for row in both(30) if row[0] == "a"])
    assert (some.status, some.reasons) == ("degraded", ("b: no sample on /b yet",))
    assert (some.sensors["a"].status, some.sensors["b"].status) == ("ok", "waiting")


def test_noise_too_small() -> None:
    """Errors three times the noise that the configuration says."""
    health = health_of(both(200, sd=3.0))
    assert health.status == "degraded"
    assert any(reason.startswith("b: NIS is ") and "scale" in reason for reason in health.reasons)


def test_a_gate_that_refuses_all() -> None:
    """A sensor that is far off from the others: the gate hides it, health does not."""
    rows = [(topic, t, x + (50.0 if topic == "a" and t > 5 else 0.0), y) for topic, t, x, y in both(200)]
    assert "a: the gate refuses every sample" in health_of(rows).reasons


def test_a_gate_that_never_fires() -> None:
    """A note: ten refusals by chance were to be expected, none came."""
    health = health_of(both(2000, sd=0.05))
    assert health.status == "healthy"
    assert health.sensors["a"].notes[0].startswith("the gate never fired in 2000 samples, 20 were to be expected")
    assert not any("gate" in note for note in health.sensors["b"].notes)


def test_a_sensor_gone() -> None:
    """Silent in event time, judged by its own period."""
    health = health_of([row for row in both(200) if row[0] == "b" or row[1] < 10])
    assert health.reasons == ("a: silent for 11.1 s, it used to come every 0.1 s",)
    assert health.sensors["a"].age_s == pytest.approx(11.05)


def test_samples_that_cannot_be_used() -> None:
    """NaN and late ones, by their share of the last samples."""
    rows = [
        (topic, t + (8 if i % 8 == 7 else 10), np.nan if i % 8 == 2 else x, y)
        for i, (topic, t, x, y) in enumerate(both(80))
    ]
    reasons = health_of(rows).reasons
    assert "a: invalid (nan): 25% of the last 80 samples" in reasons
    assert "b: late: 25% of the last 80 samples are older than lag.window" in reasons


def test_losses_on_the_way() -> None:
    """What the transport counted, by topic without its slash."""
    losses = {"a": Losses(shed=1, missed=2, unknown=3, reason="of no type")}
    assert health_of(both(50), losses=losses).reasons == (
        "a: 3 samples of unusable type: of no type",
        "a: 1 samples shed: the filter cannot keep up",
        "a: 2 samples missed on the way here",
    )


def test_memory_is_bounded() -> None:
    """The last 1000 of each sensor, the newest last; what a window sees never changes."""
    first = remember(no_samples(PLAN), [filled(range(500))])
    windows, whole = first, list(range(500))
    for begin in range(500, 4000, 7):
        windows = remember(windows, [filled(range(begin, begin + 7))])
        whole += range(begin, begin + 7)
        assert windows[0].stamp_ns.tolist() == whole[-1000:]
    assert first[0].stamp_ns.tolist() == list(range(500))
    assert [len(window) for window in windows] == [1000, 0]
    assert windows[0].log.whole.shape[1] < 1500
    assert remember(windows, [filled(range(5000))])[0].stamp_ns.tolist() == list(range(4000, 5000))


def test_memory_may_be_continued_twice() -> None:
    """Two continuations of one memory do not write over each other."""
    base = remember(no_samples(PLAN), [filled(range(10))])
    one, other = remember(base, [filled([20, 21])]), remember(base, [filled([30])])
    assert one[0].stamp_ns.tolist() == [*range(10), 20, 21]
    assert other[0].stamp_ns.tolist() == [*range(10), 30]
    assert base[0].stamp_ns.tolist() == list(range(10))


def filled(stamps: Sequence[int]) -> Seen:
    """Samples of the first sensor."""
    n = len(stamps)
    return Seen(
        t_ns=np.array(stamps),
        stamp_ns=np.array(stamps),
        arrival_ns=np.array(stamps),
        sensor=np.zeros(n, np.int64),
        seq=np.arange(n),
        decision=np.full(n, Decision.FUSED, np.uint8),
        z=np.zeros((n, 5)),
        nis=np.ones(n),
        dof=np.full(n, 2),
        innovation=np.zeros((n, 2)),
        innovation_variance=np.zeros((n, 2)),
    )


def test_sensors_that_disagree() -> None:
    """Two that measure the same: by how much, how surely and for how long; chance alone says nothing."""
    rng = np.random.default_rng(5)
    rows = [(topic, t, x + (8.0 if topic == "b" and t > 40 else 0.0), y) for topic, t, x, y in both(600)]
    reasons = [reason for reason in health_of(rows).reasons if "disagree" in reason]
    assert len(reasons) == 1
    assert re.fullmatch(r"a: a and b disagree on x by -[78]\.\d+ \(\d+ sigma\) for 49 samples: .*", reasons[0])
    for _ in range(20):
        rows = [(topic, t, float(rng.normal()), float(rng.normal())) for topic, t, _, _ in both(100)]
        assert not any("disagree" in reason for reason in health_of(rows).reasons)
