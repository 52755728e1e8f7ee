"""Gains with known answers: closed forms, the Riccati equation, Bezmen's weights and what they do to P."""

import math

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
from tests.fusion.reference import MOTIONS, observe
from tests.fusion.setups import Sample, configuration, events_of, make_plan, place_of, put, setup

from fuselog.fusion import Decision, Engine, Plan
from fuselog.fusion.gate import chi_square_quantile

SECOND = 1_000_000_000
WEIGHTS = {"lidar.x": 0.4, "lidar.y": 0.3, "speed.vx": 0.2, "speed.vy": 0.2}
WEIGHTS |= {"antenna.x": 0.1, "radar.range": 0.3, "radar.bearing": 0.2, "radar.range_rate": 0.1, "uwb.range": 0.2}


def random_walk(*, q: float, sensors: int = 1, weights: list[float] | None = None, P: float | None = None) -> Plan:
    """One number that walks at random: vx of constant_velocity, measured by ``sensors`` speed sensors at once."""
    config = configuration("constant_velocity", model={"name": "constant_velocity", "process_noise": {"ax": q}})
    config["initial"] = {"state": {"vx": 0.0}, "sd": {} if P is None else {"vx": math.sqrt(P)}}
    config["sensors"]["speed"]["fuse"] = ["vx"]
    for n in range(1, sensors):
        config["sensors"][f"speed{n}"] = {"topic": f"/speed{n}", "fuse": ["vx"]}
    if weights is not None:
        named = {f"speed{n or ''}.vx": weight for n, weight in enumerate(weights)}
        others = {name: weight for name, weight in WEIGHTS.items() if not name.startswith("speed")}
        config["gain"] = {"mode": "fixed", "weights": others | named}
    return make_plan(config)


def walk(plan: Plan, sds: list[float], values: np.ndarray):
    """One sample of each speed sensor every second."""
    samples = [
        Sample((1 + step) * SECOND, f"speed{n or ''}", [value], sd**2)
        for step, row in enumerate(values)
        for n, (value, sd) in enumerate(zip(row, sds, strict=True))
    ]
    return Engine(plan).advance(events_of(plan, samples))


@pytest.mark.parametrize(
    ("process", "sensor", "k", "P", "first"),
    [
        (0.02, 0.2, 0.095125, 3.805e-3, 0.00990),
        (0.2, 0.02, 0.990195, 3.961e-4, 0.99010),
        (0.1, 0.2, 0.390388, 0.015616, 0.2),
    ],
)
def test_the_scalar_filter_of_kiselev(process: float, sensor: float, k: float, P: float, first: float) -> None:
    """k = (-l^2 + sqrt(l^4 + 4 l^2)) / 2 with l = process / sensor; the first step starts from a known place."""
    ratio = process / sensor
    closed = (-(ratio**2) + math.sqrt(ratio**4 + 4 * ratio**2)) / 2
    track = walk(random_walk(q=process**2, P=0.0), [sensor], np.zeros((300, 1)))
    assert closed == pytest.approx(k, abs=5e-7)
    assert track.absorbed[-1, 0] == pytest.approx(closed, rel=1e-12)
    assert track.variance("vx")[-1] == pytest.approx(closed * sensor**2, rel=1e-12)
    assert track.variance("vx")[-1] == pytest.approx(P, rel=1e-3)
    assert track.absorbed[1, 0] == pytest.approx(first, abs=5e-6)


SDS, Q = [0.1, 0.2, 0.4], 0.05**2


def dare() -> tuple[float, np.ndarray]:
    """Steady P before the update, and the joint gain of the three sensors."""
    H, R = np.ones((3, 1)), np.diag(np.square(SDS))
    P = scipy.linalg.solve_discrete_are(np.eye(1), H.T, [[Q]], R)
    return P[0, 0], (P @ H.T @ np.linalg.inv(H @ P @ H.T + R))[0]


def one_after_another(joint: np.ndarray) -> list[float]:
    """The shares that, taken in turn, make the joint weights: g_q / (1 - sum of the later ones)."""
    return [g / (1 - joint[q + 1 :].sum()) for q, g in enumerate(joint)]


def test_the_optimal_gain_of_three_sensors_settles_at_the_riccati_equation() -> None:
    P, joint = dare()
    assert joint == pytest.approx([0.329, 0.082, 0.021], abs=5e-4)
    track = walk(random_walk(q=Q, sensors=3), SDS, np.zeros((200, 3)))
    assert track.absorbed[-3:, 0] == pytest.approx(one_after_another(joint), rel=1e-10)
    assert track.variance("vx")[-1] == pytest.approx((1 - joint.sum()) * P, rel=1e-10)


def test_fixed_shares_can_be_the_optimal_ones() -> None:
    """g = s* w with w the inverse variances and s* the steady gain of their mean: the same P, and the same track."""
    P, joint = dare()
    inverse = 1 / np.square(SDS)
    R = 1 / inverse.sum()
    scalar = (-Q + math.sqrt(Q * Q + 4 * Q * R)) / 2 + Q  # steady P before the update, of one sensor with R
    assert scalar == pytest.approx(P)
    g = scalar / (scalar + R) * inverse / inverse.sum()
    assert g == pytest.approx(joint, rel=1e-9)
    values = np.random.default_rng(4).normal(0, SDS, (300, 3))
    fixed = walk(random_walk(q=Q, sensors=3, weights=one_after_another(g)), SDS, values)
    optimal = walk(random_walk(q=Q, sensors=3), SDS, values)
    assert fixed.variance("vx")[-1] == pytest.approx((1 - joint.sum()) * P, rel=1e-10)
    assert fixed["vx"][-300:] == pytest.approx(optimal["vx"][-300:], abs=1e-9)


def test_a_fixed_gain_knows_its_own_error() -> None:
    """Joseph is honest: P settles at its closed form, and errors agree with it (eq. 26 would say .0233 here)."""
    g, q, r = 0.3, 0.01, 1.0
    rng = np.random.default_rng(8)
    truth = np.cumsum(rng.normal(0, math.sqrt(q), 20_000))
    track = walk(random_walk(q=q, weights=[g]), [1.0], (truth + rng.normal(0, 1, 20_000))[:, None])
    P = ((1 - g) ** 2 * q + g * g * r) / (1 - (1 - g) ** 2)
    assert pytest.approx(0.1861, abs=5e-5) == P
    assert track.variance("vx")[-1] == pytest.approx(P, rel=1e-12)
    nees = (track["vx"] - truth) ** 2 / track.variance("vx")
    assert nees[100:].mean() == pytest.approx(1.0, abs=0.07)
    assert track.nis[100:].mean() == pytest.approx(1.0, abs=0.07)


def once(plan: Plan, x, P, sample: Sample):
    """One sample applied to a state."""
    engine = Engine(plan)
    engine.advance(events_of(plan, [sample._replace(z=np.asarray(sample.z) + 1.0)]))
    put(engine, np.asarray(x, float), P, t_ns=sample.t_ns)
    return engine.advance(events_of(plan, [sample]))


X = np.array([3.0, -2.0, 1.0, 0.5])
A = np.random.default_rng(2).normal(size=(4, 4))
COVARIANCE = A @ A.T + 0.1 * np.eye(4)


def test_joseph_differs_from_equation_26_by_exactly_what_the_gain_lacks() -> None:
    """P_Joseph - (I - G H) P = (G - K) S G'."""
    plan = setup("constant_velocity", gain={"mode": "fixed", "weights": WEIGHTS})
    names, R = ["range", "bearing", "range_rate"], np.diag([0.2, 0.01, 0.1])
    h, H = observe(MOTIONS["constant_velocity"], X, names, place_of("constant_velocity", "radar"))
    track = once(plan, X, COVARIANCE, Sample(SECOND, "radar", h + 0.01, R))
    W = np.diag([WEIGHTS[f"radar.{name}"] for name in names])
    G = COVARIANCE @ H.T @ np.linalg.solve(H @ COVARIANCE @ H.T, W)
    S = H @ COVARIANCE @ H.T + R
    K = COVARIANCE @ H.T @ np.linalg.inv(S)
    equation_26 = (np.eye(4) - G @ H) @ COVARIANCE
    assert track.covariance(0) - equation_26 == pytest.approx((G - K) @ S @ G.T, abs=1e-12)
    assert track.absorbed[0, :3] == pytest.approx(np.diag(W), abs=1e-12)
    assert track.x[0] == pytest.approx(X + G @ np.full(3, 0.01), abs=1e-12)


def test_a_share_of_one_takes_the_measurement_and_a_share_of_zero_ignores_it() -> None:
    weights = WEIGHTS | {"lidar.x": 1.0, "lidar.y": 0.0}
    plan = setup("constant_velocity", gain={"mode": "fixed", "weights": weights})
    track = once(plan, X, COVARIANCE, Sample(SECOND, "lidar", [7.0, 8.0], 0.01))
    assert track["x"][0] == pytest.approx(7.0, abs=1e-12)
    assert track["y"][0] == pytest.approx(X[1], abs=1e-12)
    assert track.absorbed[0, :2] == pytest.approx([1.0, 0.0], abs=1e-14)
    assert track.variance("x")[0] == pytest.approx(0.01, rel=1e-9)
    assert track.variance("y")[0] == pytest.approx(COVARIANCE[1, 1], rel=1e-9)
    radar = setup("constant_velocity", gain={"mode": "fixed", "weights": WEIGHTS | {"uwb.range": 1.0}})
    h, _ = observe(MOTIONS["constant_velocity"], X, ["beacon_range"], place_of("constant_velocity", "uwb"))
    after = once(radar, X, COVARIANCE, Sample(SECOND, "uwb", h + 1e-6, 0.01)).x[0]
    moved, _ = observe(MOTIONS["constant_velocity"], after, ["beacon_range"], place_of("constant_velocity", "uwb"))
    assert moved == pytest.approx(h + 1e-6, abs=1e-10)


def test_weights_that_add_up_to_one_leave_nothing_of_the_prediction() -> None:
    """h = x and sum: one: the result is the measurement, P is R; eq. 26 would say P = 0 (Bezmen 2019, eq. 30)."""
    table = {"x": {"lidar.x": 1.0}, "y": {"lidar.y": 1.0}, "vx": {"speed.vx": 1.0}, "vy": {"speed.vy": 1.0}}
    gain = {"mode": "fixed", "form": "state", "sum": "one", "weights": table}
    config = configuration("constant_velocity", gain=gain)
    config["sensors"] = {name: config["sensors"][name] for name in ("lidar", "speed")}
    plan = make_plan(config)
    R = np.array([[0.04, 0.01], [0.01, 0.09]])
    results = [
        once(plan, prediction, COVARIANCE, Sample(SECOND, "lidar", [1.9, -4.0], R))
        for prediction in (X, X + 100, [-12.0, 163.0, 0.0, 0.0])
    ]
    for track in results:
        assert track.x[0, :2] == pytest.approx([1.9, -4.0], abs=1e-12)
        assert track.covariance(0)[:2, :2] == pytest.approx(R, abs=1e-12)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
@pytest.mark.parametrize("prior", [0.0, 100.0])
def test_sensors_of_one_stamp_are_a_weighted_mean(order: tuple[int, ...], prior: float) -> None:
    """sum: one over several sensors gives sum(g z), whatever was predicted, in any order of arrival (eq. 30)."""
    table = {"vx": {"speed.vx": 0.5, "speed1.vx": 0.3, "speed2.vx": 0.2}}
    config = configuration("constant_velocity", gain={"mode": "fixed", "form": "state", "sum": "one", "weights": table})
    speed = {"topic": "/speed", "fuse": ["vx"]}
    config["sensors"] = {name: speed for name in ("speed", "speed1", "speed2")}
    config["initial"] = {"state": {"vx": prior}}
    samples = [Sample(SECOND, name, [z], 0.01) for name, z in (("speed", 1.0), ("speed1", 2.0), ("speed2", 4.0))]
    plan = make_plan(config)
    track = Engine(plan).advance(events_of(plan, [samples[n] for n in order]))
    assert track["vx"][-1] == pytest.approx(0.5 * 1.0 + 0.3 * 2.0 + 0.2 * 4.0, abs=1e-12)
    assert track.variance("vx")[-1] == pytest.approx((0.25 + 0.09 + 0.04) * 0.01, rel=1e-12)


def test_the_half_way_angle_goes_through_180_degrees() -> None:
    """A weighted mean of 179 and -179 degrees is 180, not 0: fused by wrapped innovations."""
    plan = setup("unicycle")
    heading = math.radians(179)
    P = np.eye(5) * 0.01
    track = once(plan, [0, 0, heading, 0, 0], P, Sample(SECOND, "compass", [-heading], 0.01))
    assert track.innovation[0, 0] == pytest.approx(math.radians(2))
    assert abs(track["yaw"][0]) == pytest.approx(math.pi)
    before = once(plan, [0, 0, heading, 0, 0], P, Sample(SECOND, "compass", [-heading + 0.02], 0.01))
    assert -math.pi < before["yaw"][0] < -3.1


@pytest.mark.parametrize("dof", range(1, 10))
def test_the_gate_is_a_quantile_of_chi_square(dof: int) -> None:
    for p in (0.001, 0.05, 0.5, 0.9, 0.95, 0.99, 0.999, 0.999999):
        assert chi_square_quantile(p, dof) == pytest.approx(scipy.stats.chi2.ppf(p, dof), rel=1e-9)


def test_a_gate_turns_away_as_many_good_samples_as_it_says() -> None:
    """After a sample that passed, the next is turned away with probability 1 - gate, and NIS is chi-square."""
    rng, n, q, r = np.random.default_rng(12), 20_000, 25.0, 0.01
    gate = {"speed": {"gate": 0.95}}
    noise = {"name": "constant_velocity", "process_noise": {"ax": q, "ay": q}}
    plan = setup("constant_velocity", sensors=gate, model=noise)
    values = np.cumsum(rng.normal(0, math.sqrt(q), (n, 2)), axis=0) + rng.normal(0, math.sqrt(r), (n, 2))
    samples = [Sample((1 + i) * SECOND, "speed", value, r) for i, value in enumerate(values)]
    track = Engine(plan).advance(events_of(plan, samples))
    fused = track.decision == Decision.FUSED
    after = np.flatnonzero(fused[:-1]) + 1
    share = 1 - fused[after].mean()
    assert share == pytest.approx(0.05, abs=4 * math.sqrt(0.05 * 0.95 / len(after)))
    assert scipy.stats.kstest(track.nis[after], scipy.stats.chi2(2).cdf).pvalue > 1e-3
