"""What would break an estimate is refused: the pole of Euler angles, what is no number, what is no covariance."""

import math
from pathlib import Path

import numpy as np
import pytest
from tests.fusion.reference import MOTIONS
from tests.fusion.setups import MEASURED, Sample, events_of, place_of, put, setup
from tests.fusion.test_step import assert_all_symmetric

from fuselog.fusion import Decision, Engine, Filter, Outputs, load_plan
from fuselog.fusion.health import assess, no_samples, remember, seen
from fuselog.fusion.track import unpack

SECOND = 1_000_000_000
LIMIT = math.radians(85)
NAMES = MOTIONS["omni3d"].names
PITCH = NAMES.index("pitch")


def level(pitch=0.0, pitch_rate=0.0):
    x = np.zeros(15)
    x[PITCH], x[NAMES.index("pitch_rate")], x[0] = pitch, pitch_rate, 7.0
    return x


def imu(pitch, t_ns):
    """An IMU's sample of a body at rest with this pitch; its lever arm does not matter then."""
    g = 9.80665
    return Sample(t_ns, "imu", [0, pitch, 0, 0, 0, 0, -g * math.sin(pitch), 0, g * math.cos(pitch)], 1e-4)


def begun(plan, x):
    engine = Engine(plan)
    engine.advance(events_of(plan, [imu(0.0, SECOND)]))
    put(engine, x, 0.01 * np.eye(15), t_ns=SECOND)
    return engine


def health_of(plan, engine, *tracks):
    recent = no_samples(plan)
    for track in tracks:
        recent = remember(recent, [seen(track)])
    ledger = Filter(plan, order="as_received").ledger
    return assess(plan, estimate=engine.estimate, ledger=ledger, recent=recent, losses={})


def test_a_prediction_over_the_pole_is_refused_and_the_attitude_begins_anew() -> None:
    plan = setup("omni3d")
    engine = begun(plan, level(pitch=1.45, pitch_rate=1.0))
    first = engine.advance(events_of(plan, [imu(1.5, SECOND + SECOND // 10)]))
    assert Decision(first.decision[0]) == Decision.INVALID_SINGULAR
    assert np.isnan(first.x[0, PITCH])
    assert len(Outputs(plan).estimates(Outputs(plan).encode(first))) == 0
    near = engine.advance(events_of(plan, [imu(1.55, SECOND + SECOND // 5)]))
    assert Decision(near.decision[0]) == Decision.INVALID_SINGULAR
    health = health_of(plan, engine, first, near)
    assert health.status == "initializing"
    assert any("pitch came to 85 deg: omni3d has no estimate there" in reason for reason in health.reasons)
    back = engine.advance(events_of(plan, [imu(0.4, SECOND + SECOND // 2)]))
    assert Decision(back.decision[0]) == Decision.FUSED
    assert back.x[0, PITCH] == pytest.approx(0.4)
    t = SECOND + SECOND // 2
    pose = Sample(t, "pose", [3.0, 4.0, 5.0, 0.0, 0.4, 0.0], 0.01)
    done = engine.advance(events_of(plan, [Sample(t, "wheel", [0, 0, 0], 0.01), pose]))
    assert np.isfinite(done.x[-1]).all()
    assert done.x[-1, :3] == pytest.approx([3.0, 4.0, 5.0], abs=0.1)
    assert engine.estimate.resets == 0


def test_a_correction_over_the_pole_is_taken_back() -> None:
    plan = setup("omni3d")
    engine = begun(plan, level(pitch=1.4))
    track = engine.advance(events_of(plan, [Sample(SECOND, "pose", [7, 0, 0, 0, 1.54, 0], 1e-6)]))
    assert Decision(track.decision[0]) == Decision.INVALID_SINGULAR
    assert not engine.estimate.known[PITCH]


def test_random_steps_about_the_pole() -> None:
    """A body that turns over and over: never a pitch past the limit, never a P that is none, and it comes back."""
    plan, rng, samples, t = setup("omni3d"), np.random.default_rng(6), [], SECOND
    pitch, rate = 0.0, 0.0
    for _ in range(20_000):
        dt = int(rng.integers(1, 30_000_000))
        rate += rng.normal(0, 0.3) - 0.02 * rate
        pitch, t = pitch + rate * dt * 1e-9, t + dt
        flipped = math.cos(pitch) < 0
        seen = math.asin(math.sin(pitch)) + rng.normal(0, 0.01)
        turned = math.pi if flipped else 0.0
        name = ("imu", "wheel", "pose", "gps", "radar", "uwb")[rng.integers(6)]
        numbers = rng.normal(0, 1, len(MEASURED["omni3d"][name]))
        if name in ("imu", "pose"):
            numbers[PITCH if name == "pose" else 1] = seen
            numbers[[3, 5] if name == "pose" else [0, 2]] = turned + rng.normal(0, 0.01, 2)
        if name == "imu":
            numbers[4] = rate
        samples.append(Sample(t, name, numbers, 0.01, tuple(rng.normal(0, 5, 3))))
    engine = Engine(plan)
    track = engine.advance(events_of(plan, samples))
    lost = track.decision == Decision.INVALID_SINGULAR
    known = np.isfinite(track.x[:, PITCH])
    assert lost.sum() > 100
    assert known.sum() > 5_000
    assert np.abs(track.x[known, PITCH]).max() < LIMIT
    assert np.count_nonzero(np.diff(known.astype(int)) > 0) > 10
    assert np.isfinite(track.P).all()
    for row in track.P[::7]:
        P = unpack(row, 15)
        sd = np.sqrt(np.diag(P))
        assert np.linalg.eigvalsh(P / np.outer(sd, sd))[0] > -1e-9
    assert_all_symmetric(engine)
    assert place_of("omni3d", "pose").lever == (0.0, 0.0, 0.0)


BREAKS = """\
import sympy as sp
from fuselog.fusion.models import DT, Model, symbols, white_noise

def breaks():
    x, v = symbols("x v")
    return Model(
        name="breaks",
        states={"x": "m", "v": "m/s"},
        transition={"x": sp.sqrt(x) + v * DT, "v": v * sp.Float("1e200")},
        noise={"x": 1e-4, "v": 1e-4},
        covariance=white_noise("x", "v"),
    )
"""
CONFIG = """\
fuselog: 1
model: breaks.py:breaks
initial: {state: {x: 4, v: 0}, sd: {x: 0.1, v: 0.1}}
sensors:
  x: {topic: /x, fuse: [x], noise: {x: 0.1}}
"""


def test_a_model_that_gives_no_number_keeps_the_state_before(tmp_path: Path) -> None:
    """sqrt of a negative number in the prediction, and a variance past all numbers: no NaN in any row."""
    (tmp_path / "breaks.py").write_text(BREAKS)
    (tmp_path / "fusion.yaml").write_text(CONFIG)
    plan = load_plan(tmp_path / "fusion.yaml")
    engine = Engine(plan)
    engine.advance(events_of(plan, [Sample(SECOND, "x", [4.0], 0.01)]))
    put(engine, np.array([-1.0, 0.0]), np.diag([0.04, 0.0]), t_ns=SECOND)
    track = engine.advance(events_of(plan, [Sample((2 + i) * SECOND, "x", [1.0], 0.01) for i in range(3)]))
    assert [Decision(d) for d in track.decision] == [Decision.INVALID_NAN] * 3
    assert track.x[-1].tolist() == [-1.0, 0.0]
    assert track.t_ns.tolist() == [SECOND] * 3
    put(engine, np.array([4.0, 0.0]), np.diag([0.04, 1.0]), t_ns=SECOND)
    track = engine.advance(events_of(plan, [Sample((6 + i) * SECOND, "x", [2.0], 0.01) for i in range(3)]))
    assert (track.decision == Decision.INVALID_COVARIANCE).all()
    assert engine.estimate.resets == 3
    assert np.isfinite(track.P).all()
    assert np.isfinite(track.x).all()
    health = health_of(plan, engine, track)
    assert "the covariance began anew 3 times: it was no covariance any more" in health.reasons


def test_a_covariance_that_is_none_begins_anew_in_the_extended_filter() -> None:
    plan = setup("omni3d")
    engine = begun(plan, level())
    P = np.eye(15)
    P[0, 1] = P[1, 0] = 3.0
    put(engine, level(), P, t_ns=SECOND)
    sample = Sample(SECOND, "pose", [7.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.01)
    track = engine.advance(events_of(plan, [sample._replace(z=[7.0, 0, 0, 0, 0, 0.01])]))
    assert Decision(track.decision[0]) == Decision.INVALID_COVARIANCE
    assert engine.estimate.resets == 1
    track = engine.advance(events_of(plan, [sample._replace(t_ns=2 * SECOND)]))
    assert Decision(track.decision[0]) == Decision.FUSED
