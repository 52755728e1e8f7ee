"""Barometers: height of the standard atmosphere, its reference, its noise, and a bias that is estimated."""

import math
from typing import Any

import mpmath
import numpy as np
import pytest
from tests.fusion.from_python import from_python
from tests.fusion.setups import Sample, events_of, make_plan, put
from tests.logs import Topic, messages_of

from fuselog.fusion import Decision, Engine, Events, atmosphere
from fuselog.fusion.atmosphere import EXPONENT
from fuselog.fusion.events import join
from fuselog.fusion.intake import Intake
from fuselog.schemas import ConfigError

height = from_python(atmosphere.height)
height_slope = from_python(atmosphere.height_slope)
power = from_python(atmosphere.power)
SECOND = 1_000_000_000
BARO = {"topic": "/baro", "kind": "pressure"}


def test_heights_of_the_standard_atmosphere() -> None:
    """Pressures (Pa) of ISO 2533 at geopotential heights (m); its table has six digits."""
    for meters, pascal in [(-1000, 113929), (0, 101325), (1000, 89874.6), (5000, 54019.9), (11000, 22632.0)]:
        assert height(pascal) == pytest.approx(meters, abs=0.3)
    assert height(101325.0) == 0.0
    for pascal in (0.0, -1.0, math.nan, math.inf):
        assert math.isnan(height(pascal))


def test_power_against_many_digits() -> None:
    with mpmath.workdps(40):
        for base in np.geomspace(1e-3, 10, 2000).tolist():
            exact = mpmath.mpf(base) ** mpmath.mpf(EXPONENT)
            assert abs(power(base, EXPONENT) - exact) < 1e-15 * exact


def test_the_slope_of_height() -> None:
    for pascal in (30000.0, 90000.0, 105000.0):
        numeric = (height(pascal + 1.0) - height(pascal - 1.0)) / 2
        assert height_slope(pascal) == pytest.approx(numeric, rel=1e-9)


def baro(t_ns: Any, pressure: Any, variance: float = 25.0, topic: str = "/baro") -> Topic:
    fields = {"fluid_pressure": pressure, "variance": variance}
    return Topic(topic, "sensor_msgs/msg/FluidPressure", t_ns, fields)


def taken(sensor: dict[str, Any], topic: Topic, cuts: tuple[int, ...] = ()) -> Events:
    intake = Intake(make_plan({"model": {"name": "constant_velocity_3d"}, "sensors": {"baro": sensor}}))
    intake.open(1, topic.stream)
    messages, parts = messages_of([topic]), []
    for first, last in zip((0, *cuts), (*cuts, len(messages)), strict=True):
        names = ("stream", "start", "length", "log_time", "publish_time", "sequence")
        columns = {name: getattr(messages, name)[first:last] for name in names}
        parts.append(intake.take(type(messages)(data=messages.data, **columns)).events)
    return join(parts)


def test_height_above_the_first_good_sample() -> None:
    pressure = np.array([math.nan, 0.0, 95000.0, 94000.0, 96000.0])
    topic = baro(SECOND + np.arange(5), pressure)
    whole = taken(BARO, topic)
    nan = Decision.INVALID_NAN
    assert whole.fault.tolist() == [nan, nan, Decision.FUSED, Decision.FUSED, Decision.FUSED]
    assert whole.z[2, 0] == 0.0
    assert whole.z[3:, 0] == pytest.approx([height(94000) - height(95000), height(96000) - height(95000)], abs=1e-12)
    assert whole.R[3, 0] == pytest.approx(25 * height_slope(94000.0) ** 2, rel=1e-12)
    assert math.sqrt(whole.R[3, 0]) == pytest.approx(5 * 0.0886, rel=0.01)  # 8.9 cm a Pa up there
    for cuts in ((1, 2, 3, 4), (3,)):
        for one, other in zip(whole, taken(BARO, topic, cuts), strict=True):
            assert one.tobytes() == other.tobytes()


def test_height_above_a_reference() -> None:
    events = taken(BARO | {"reference": 101325, "noise": {"z": 0.5}}, baro([SECOND], 89874.6, variance=0.0))
    assert events.z[0, 0] == pytest.approx(1000, abs=0.05)
    assert events.R[0, 0] == 0.25


def test_a_pressure_of_another_type() -> None:
    topic = Topic("/baro", "sensor_msgs/msg/Range", [SECOND], {"range": 95000.0})
    events = taken(BARO | {"value": "range", "reference": 95000, "noise": {"z": 0.5}}, topic)
    assert events.fault.tolist() == [Decision.FUSED]
    assert events.z[0, 0] == 0.0


def test_an_unknown_variance_needs_a_noise() -> None:
    assert taken(BARO, baro([SECOND], 95000.0, variance=0.0)).fault.tolist() == [Decision.INVALID_COVARIANCE]


@pytest.mark.parametrize(
    ("model", "sensor", "expected"),
    [
        ("unicycle", {}, r"sensors.baro.kind: unicycle has no z"),
        ("omni3d", {"reference": -1}, r"sensors.baro.reference: input should be"),
        ("omni3d", {"reference": "sea"}, r"sensors.baro.reference: input should be"),
        ("omni3d", {"station": [1, 2, 3]}, r"sensors.baro.station: means nothing to kind: pressure, only to polar"),
        ("omni3d", {"mount": {"rpy": [0, 0, 1]}}, r"sensors.baro.mount.rpy: kind: pressure has no axes to turn"),
    ],
)
def test_mistakes_have_a_place(model: str, sensor: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected) as caught:
        make_plan({"model": {"name": model}, "sensors": {"baro": BARO | sensor}})
    assert len(caught.value.problems) == 1


def test_a_drifting_barometer_beside_a_satellite_receiver() -> None:
    """NEES of a body that wanders, its height measured well with a drifting bias and badly without: inside 95 %."""
    names, nees, runs, dt = ("x", "y", "z", "vx", "vy", "vz"), [], 60, 0.1
    plan = make_plan(
        {
            "model": {"name": "constant_velocity_3d", "process_noise": {"ax": 0.1, "ay": 0.1, "az": 0.2}},
            "initial": {"state": dict.fromkeys(names, 0.0)},
            "sensors": {
                "fix": {"topic": "/fix", "fuse": ["x", "y", "z"]},
                "baro": BARO | {"states": {"bias": {"z": {"sd": 3.0, "drift": 0.1}}}},
            },
        }
    )
    assert plan.states == (*names, "baro.bias.z")
    q = plan.tables.q[:3]
    for run in range(runs):
        rng = np.random.default_rng(run)
        x, samples, t_ns = rng.normal(0, 1, 7) * np.sqrt(np.diag(plan.P)), [], SECOND
        engine = Engine(plan)
        engine.advance(events_of(plan, [Sample(t_ns, "fix", [0.0, 0.0, 0.0], 1e12)]))
        put(engine, np.zeros(7), plan.P, t_ns=t_ns)
        block = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        for k in range(1, 301):
            x[:3] += x[3:6] * dt
            for axis in range(3):
                x[[axis, 3 + axis]] += np.linalg.cholesky(block * q[axis]) @ rng.normal(size=2)
            x[6] += rng.normal(0, 0.1 * math.sqrt(dt))
            t_ns += 100_000_000
            samples.append(Sample(t_ns, "baro", [x[2] + x[6] + rng.normal(0, 0.1)], 0.01))
            if k % 10 == 0:
                samples.append(Sample(t_ns, "fix", x[:3] + rng.normal(0, 2, 3), 4.0))
        engine.advance(events_of(plan, samples))
        error = x - engine.estimate.x
        nees.append(error @ np.linalg.solve(engine.estimate.P, error))
    assert abs(np.mean(nees) - 7) < 1.96 * math.sqrt(2 * 7 / runs), np.mean(nees)
    assert engine.estimate.P[6, 6] < 0.4**2 * plan.P[6, 6]
