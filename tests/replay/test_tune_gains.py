"""Gains found from simulated logs: those of theory, better on data held out, or refused with a reason."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fuselog.fusion import Plan, compile_plan, parse_config
from fuselog.fusion.design import dare, fixed_weights
from fuselog.replay import open_log
from fuselog.replay.signals import Signal, reading, stamps, write_signals
from fuselog.replay.simulate import simulate
from fuselog.replay.truth import read_truth
from fuselog.replay.tune import Tuned, tune_gains
from fuselog.schemas import ConfigError

SD = {"a": 0.1, "b": 0.2, "c": 0.4}
OPTIMAL = [0.329, 0.082, 0.021]  # Bezmen's weights at q = .05² a step
THIRDS = {"mode": "fixed", "form": "state", "weights": {"x": dict.fromkeys(("a.x", "b.x", "c.x"), 0.3333)}}
READ = {"fuse": ["x"], "fields": {"x": "values[0]"}}
ODOMETRY, TWIST = "nav_msgs/msg/Odometry", "geometry_msgs/msg/TwistStamped"


def plan_of(**configuration: Any) -> Plan:
    return compile_plan(*parse_config(json.dumps({"fuselog": 1, **configuration})))


def three(gain: dict[str, Any] | None = None, *, noise: dict[str, float] | None = None, **sensors: Any) -> Plan:
    """A number that wanders by .05 a step of .1 s, and its sensors, whose noise is in their messages."""
    known = {name: {"noise": {"x": sd}} for name, sd in (noise or {}).items()}
    stated = {"variance": {"x": "variances[0]"}}
    return plan_of(
        model={"name": "brownian", "process_noise": {"x": 0.025}},
        initial={"state": {"x": 0}, "sd": {"x": 0.1}},
        gain=gain or {},
        sensors={name: {"topic": f"/sensor/{name}", **READ, **known.get(name, stated)} for name in SD} | sensors,
    )


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """1000 s of Bezmen's three sensors, no sample missing."""
    path = tmp_path_factory.mktemp("tune") / "three.mcap"
    simulate("bezmen_redundant", path, seed=1, duration=1000, parameters={"missing": 0})
    return path


def tune(log: Path, plan: Plan, **options: Any) -> Tuned:
    with open_log(log) as opened:
        return tune_gains(opened, plan, **options)


def weights(tuned: Tuned) -> list[float]:
    """The weights of the three sensors in x."""
    return list(tuned.gain["weights"]["x"].values())


@pytest.mark.parametrize("by", ["inverse_variance", "dare"])
@pytest.mark.parametrize("start", [None, THIRDS])
def test_three_sensors_have_bezmens_weights(log: Path, by: str, start: dict[str, Any] | None) -> None:
    """Finding 1: s* w is the steady optimal gain; whatever the configuration had before."""
    tuned = tune(log, three(start), by=by, form="state")
    assert weights(tuned) == pytest.approx(OPTIMAL, abs=5e-4)
    assert weights(tuned) == pytest.approx(fixed_weights(0.05**2, np.square(list(SD.values()))), rel=1e-5)
    assert tuned.radius == pytest.approx(1 - 0.4318, abs=1e-4)
    assert {name: pace.hz for name, pace in tuned.seen.paces.items()} == dict.fromkeys(SD, 10)
    assert "rates" not in tuned.gain  # the proof needs noises in the configuration; these are in the messages


@pytest.mark.parametrize("form", ["absorb", "matrix"])
def test_one_after_another_is_the_same(log: Path, form: str) -> None:
    """g / (1 - sum of the later g) is what samples that are applied in turn need, as shares and as a matrix."""
    table = tune(log, three(THIRDS), by="dare", form=form).gain["weights"]
    turn = list((table if form == "absorb" else table["x"]).values())
    assert [turn[0] * (1 - turn[1]) * (1 - turn[2]), turn[1] * (1 - turn[2]), turn[2]] == pytest.approx(
        OPTIMAL, abs=5e-4
    )


def test_the_optimal_filter_is_hardly_better_than_its_steady_gain(log: Path) -> None:
    tuned = tune(log, three(), by="dare")
    assert tuned.form == "absorb"
    assert tuned.after is not None
    assert tuned.after.prediction_error == pytest.approx(tuned.before.prediction_error, abs=1e-3)
    for name, fitted in tuned.after.sensors.items():
        assert fitted.nis == pytest.approx(1, abs=0.08)
        assert abs(fitted.whiteness["x"]) < 0.05
        assert fitted.n == pytest.approx(3000, abs=1), name


def test_learned_gains_are_near_those_of_the_riccati_equation(log: Path) -> None:
    """From equal thirds, without truth, R or Q; on the part held out as good as the optimal filter (finding 8)."""
    with open_log(log) as opened:
        truth = read_truth(opened, "/ground_truth", fields={"x": "values[0]"})
        truth = truth.only(np.arange(len(truth.t_ns)) % 5 == 0)
    tuned = tune(log, three(THIRDS), by="learn", truth=lambda _: truth)
    best = dare([[1]], np.ones((3, 1)), [[0.05**2]], np.diag(np.square(list(SD.values())))).G[0]
    assert tuned.accepted
    assert tuned.form == "state"
    assert np.linalg.norm(weights(tuned) - best) < 0.05 * np.linalg.norm(best)
    assert tuned.after is not None
    assert tuned.after.prediction_error < tuned.before.prediction_error - 0.3
    assert list(tuned.learning) == sorted(tuned.learning, reverse=True)
    assert tuned.before.rmse is not None
    assert tuned.after.rmse is not None
    assert tuned.before.rmse["x"] == pytest.approx(0.1527, rel=0.05)  # equal thirds
    assert tuned.after.rmse["x"] == pytest.approx(0.0573, rel=0.05)  # the optimal filter


def test_learning_where_samples_are_missing(tmp_path: Path) -> None:
    """One in ten is lost: what is learned is what a sample deserves when it comes."""
    log = tmp_path / "gaps.mcap"
    simulate("bezmen_redundant", log, seed=2, duration=600)
    tuned = tune(log, three(THIRDS), by="learn", form="matrix")
    assert tuned.accepted
    assert all(pace.missing == pytest.approx(0.1, abs=0.02) for pace in tuned.seen.paces.values())
    best = tune(log, three(), by="dare", form="matrix")
    assert weights(tuned) == pytest.approx(weights(best), abs=0.03)


def test_a_gain_that_cannot_be_improved_stays(tmp_path: Path) -> None:
    """From the best gain, 200 samples teach nothing that holds: the copy is the configuration as it was."""
    log = tmp_path / "short.mcap"
    simulate("bezmen_redundant", log, seed=3, duration=30, parameters={"missing": 0})
    best = {"mode": "fixed", "form": "state", "weights": {"x": dict(zip(("a.x", "b.x", "c.x"), OPTIMAL, strict=True))}}
    plan = three(best)
    tuned = tune(log, plan, by="learn")
    assert not tuned.accepted
    assert tuned.text == plan.source.text
    assert tuned.reason is not None
    assert "no better" in tuned.reason
    assert tuned.after is not None
    assert tuned.after.prediction_error >= tuned.before.prediction_error
    assert tuned.to_json()["accepted"] is False


def test_noise_from_the_log(log: Path) -> None:
    """A configuration that trusts the worst sensor most; the three-cornered hat knows better."""
    wrong = three(noise={"a": 0.4, "b": 0.2, "c": 0.1})
    misled, told = (tune(log, wrong, by="inverse_variance", noise=noise) for noise in ("given", "log"))
    assert weights(misled) == pytest.approx(OPTIMAL[::-1], abs=5e-4)
    assert np.sqrt([R[0, 0] for R in told.seen.noise.values()]) == pytest.approx(list(SD.values()), rel=0.05)
    assert weights(told) == pytest.approx(OPTIMAL, abs=0.015)
    assert told.after is not None
    assert misled.after is not None
    assert told.after.prediction_error < misled.after.prediction_error


def test_kappa_of_one_state_changes_nothing(log: Path) -> None:
    assert weights(tune(log, three(), by="kappa", kappa={"x": 7.0})) == pytest.approx(OPTIMAL, abs=5e-4)


def wall(gain: dict[str, Any], sensors: dict[str, Any], xi: float = 0.1, zeta: float = 0.01) -> Plan:
    """Kiselev's robot; what a step of .1 s adds to y (m) and yaw (rad)."""
    return plan_of(
        model={"name": "wall_follower", "process_noise": {"y": xi**2 / 0.1, "yaw": zeta**2 / 0.1}},
        initial={"state": {"y": 0, "yaw": 0}, "sd": {"y": 0.1, "yaw": 0.1}},
        gain=gain,
        sensors={"wheels": {"topic": "/wheel/twist", "kind": "input", "noise": {"v": 1e-9, "yaw_rate": 1e-9}}}
        | sensors,
    )


DISTANCE = {"topic": "/wall/distance", "fuse": ["y"], "fields": {"y": "values[0]"}, "noise": {"y": 0.2}}
TWO = {
    "distance": {**DISTANCE, "mount": {"xyz": [0.15, 0, 0]}},
    "gyro": {"topic": "/gyro/attitude", "fuse": ["yaw"], "noise": {"yaw": 0.05}},
}


@pytest.fixture(scope="module")
def wall_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tune") / "wall.mcap"
    simulate("kiselev_wall_two", path, seed=1, duration=300)
    return path


def joint(tuned: Tuned) -> np.ndarray:
    """The gain (2, 2) of both innovations at once that a matrix of gains in turn amounts to."""
    table = tuned.gain["weights"]
    rows = [[table[state].get(name, 0.0) for name in ("distance.y", "gyro.yaw")] for state in ("y", "yaw")]
    distance, gyro = np.array(rows).T
    return np.stack([distance - gyro * distance[1], gyro], axis=1)


def test_the_wall_has_its_steady_gain(wall_log: Path) -> None:
    """Figure 9: DARE's G of [u, beta]; and with learned gains the errors are as small."""
    tuned = tune(wall_log, wall({}, TWO), by="dare", form="matrix")
    assert joint(tuned) == pytest.approx(np.array([[0.3904, -0.0207], [0.0004, 0.1810]]), abs=2e-3)
    start = {"mode": "fixed", "form": "absorb", "weights": {"distance.y": 0.1, "gyro.yaw": 0.6}}
    learned = tune(wall_log, wall(start, TWO), by="learn", form="matrix")
    assert learned.accepted
    assert learned.after is not None
    assert tuned.after is not None
    assert learned.after.prediction_error < tuned.after.prediction_error + 0.02
    assert np.diag(joint(learned)) == pytest.approx([0.39, 0.18], abs=0.08)


@pytest.mark.parametrize(("kappa", "published"), [(0.01, [0.152, 0.033]), (0.99, [0.169, 0.409])])
def test_kappa_decides_where_cross_gains_are_missing(tmp_path: Path, kappa: float, published: list[float]) -> None:
    """Kiselev's fast robot (E15): u less a beta stands for y, so that both numbers share the gyro's noise."""
    a, eta, theta, n = 0.5, 0.02, 0.3, 400
    R = np.array([[eta**2 + (a * theta) ** 2, -a * theta**2], [-a * theta**2, theta**2]])
    z = np.random.default_rng(4).multivariate_normal([0, 0], R, n)
    t_ns, entries = stamps(np.arange(n) * 0.1), {7: R[0, 0], 11: R[0, 1], 31: R[0, 1], 35: R[1, 1]}
    values = np.stack([z[:, 0], np.sin(z[:, 1] / 2), np.cos(z[:, 1] / 2)], axis=1)
    pose = ["pose.pose.position.y", "pose.pose.orientation.z", "pose.pose.orientation.w"]
    stated: dict[str, str | float] = {f"pose.covariance[{i}]": float(entry) for i, entry in entries.items()}
    signals = [
        Signal(topic="/pose", schema_name=ODOMETRY, t_ns=t_ns, columns=pose, values=values, constants=stated),
        Signal(
            topic="/wheel/twist", schema_name=TWIST, t_ns=t_ns, columns=["twist.linear.x"], values=np.full((n, 1), 1.25)
        ),
    ]
    write_signals(tmp_path / "fast.mcap", signals)
    plan = wall({}, {"pose": {"topic": "/pose", "fuse": ["y", "yaw"]}}, xi=0.01, zeta=0.01)
    tuned = tune(tmp_path / "fast.mcap", plan, by="kappa", kappa={"y": kappa, "yaw": 1 - kappa})
    table = tuned.gain["weights"]
    assert [table["y"]["pose.y"], table["yaw"]["pose.yaw"]] == pytest.approx(published, abs=1e-3)


def test_a_state_that_nothing_measures_is_left_open_on_demand(log: Path) -> None:
    """constant_velocity_1d by its speed alone: x is dead reckoned."""
    plan = plan_of(
        model={"name": "constant_velocity_1d", "process_noise": {"ax": 0.025}},
        initial={"state": {"x": 0}},
        sensors={
            n: {"topic": f"/sensor/{n}", "fuse": ["vx"], "fields": {"vx": "values[0]"}, "noise": {"vx": sd}}
            for n, sd in SD.items()
        },
    )
    with pytest.raises(ConfigError, match=r"model.name: no sensor sees x .*open_loop"):
        tune(log, plan, by="dare")
    with pytest.raises(ConfigError, match="others depend on vx: it cannot be left open"):
        tune(log, plan, by="dare", open_loop=["x", "vx"])
    tuned = tune(log, plan, by="dare", form="state", open_loop=["x"])
    assert list(tuned.gain["weights"]) == ["vx"]
    assert tuned.gain["open_loop"] == ["x"]  # with the rates, so that the rest is proved whenever it is loaded
    assert tuned.gain["rates"] == dict.fromkeys(SD, 10)
    assert list(tuned.gain["weights"]["vx"].values()) == pytest.approx(OPTIMAL, abs=5e-4)


def test_a_matrix_that_goes_astray_is_not_accepted(tmp_path: Path) -> None:
    """A robot that gets fifty times as fast in the part held out: what the distance says of its yaw is far too much."""
    n = 3000
    rng = np.random.default_rng(5)
    v = np.where(np.arange(n) < 0.75 * n, 1.0, 50.0)
    y = np.cumsum(rng.normal(0, 0.01, n))
    signals = [
        reading("/wall/distance", stamps(np.arange(n) * 0.1), {"u": y + rng.normal(0, 0.01, n)}),
        Signal(
            topic="/wheel/twist",
            schema_name=TWIST,
            t_ns=stamps(np.arange(n) * 0.1),
            columns=["twist.linear.x"],
            values=v[:, np.newaxis],
        ),
    ]
    write_signals(tmp_path / "fast.mcap", signals)
    plan = wall({}, {"distance": {**DISTANCE, "noise": {"y": 0.01}}}, xi=0.01, zeta=0.02)
    tuned = tune(tmp_path / "fast.mcap", plan, by="dare", form="matrix")
    assert not tuned.accepted
    assert tuned.reason is not None
    assert "the filter goes astray: distance.y has an innovation RMS of" in tuned.reason
    assert tuned.text == plan.source.text


def uneven(path: Path) -> Path:
    """A log of three sensors of which b comes at random times, and c is hardly there."""
    rng = np.random.default_rng(6)
    times = {"a": np.arange(500) * 0.1, "b": np.cumsum(rng.exponential(0.1, 500)), "c": np.arange(3.0)}
    write_signals(
        path,
        [reading(f"/sensor/{n}", stamps(t), {"x": rng.normal(size=len(t))}, sd=[SD[n]]) for n, t in times.items()],
    )
    return path


def test_rates_that_are_none(tmp_path: Path) -> None:
    log = uneven(tmp_path / "uneven.mcap")
    with pytest.raises(ConfigError, match=r"sensors.c.topic: 3 good samples in the part of the log to tune by"):
        tune(log, three(), by="dare")
    two = plan_of(
        model={"name": "brownian"},
        sensors={n: {"topic": f"/sensor/{n}", **READ, "noise": {"x": SD[n]}} for n in "ab"},
    )
    with pytest.raises(
        ConfigError, match=r"sensors.b.topic: samples do not come at a constant rate: .* jitter of \d+ %"
    ):
        tune(log, two, by="dare")


def test_what_cannot_be_tuned_says_why(log: Path, wall_log: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"sensors.d.topic: no topic '/sensor/d' there \(did you mean"):
        tune(log, three(d={"topic": "/sensor/d", **READ, "noise": {"x": 1}}), by="dare")
    with pytest.raises(ConfigError, match=r"kappa: there is no state 'alpha' to correct"):
        tune(log, three(), by="kappa", kappa={"alpha": 0.5})
    with pytest.raises(ConfigError, match=r"kappa: say how much yaw matters: --kappa yaw=0.5"):
        tune(wall_log, wall({}, TWO), by="kappa", kappa={"y": 0.5})
    with pytest.raises(ConfigError, match="brownian has no state 'y' to leave open"):
        tune(log, three(), by="dare", open_loop=["y"])
    with pytest.raises(ConfigError, match="noise from the log needs three sensors that measure one state"):
        tune(wall_log, wall({}, TWO), by="dare", noise="log")
    with pytest.raises(ConfigError, match=r"no gain by learn: the error does not decay in x \(eigenvalue -1"):
        tune(
            log,
            three({"mode": "fixed", "form": "matrix", "weights": {"x": {"a.x": 2.5, "b.x": 0.1, "c.x": 0.1}}}),
            by="learn",
        )
    short = tmp_path / "short.mcap"
    simulate("bezmen_redundant", short, seed=1, duration=20, parameters={"missing": 0})
    message = r"sensors.a.topic: 140 samples are too few to learn a gain of 3 numbers; 150 are needed"
    with pytest.raises(ConfigError, match=message):
        tune(short, three(THIRDS), by="learn")
