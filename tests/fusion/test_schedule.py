"""Gains that take turns, the optimal one at the start and after gaps, proof that fixed ones work, x without P."""

import math

import numpy as np
import pytest
from tests.fusion.setups import Sample, configuration, events_of, make_plan, setup
from tests.fusion.test_cycles import SD, SECOND, SHARES, SPEED, samples_of
from tests.fusion.test_laws import by_stamp
from tests.fusion.test_steady import RATES, wall, wall_samples

from fuselog.fusion import Engine, Plan
from fuselog.schemas import ConfigError

TWO = {"mode": "scheduled"}


def turns(*schedule: dict) -> dict:
    """Wheel and compass of the unicycle, by gains that take turns."""
    config = configuration("unicycle")
    config["sensors"] = {name: config["sensors"][name] for name in ("wheel", "compass")}
    config["initial"]["sd"] = {"x": 0.1, "y": 0.1}
    return config | {"gain": {"mode": "scheduled", "schedule": list(schedule)}}


def weights(v: float) -> dict:
    return {"weights": {"wheel.v": v, "wheel.yaw_rate": 0.1, "compass.yaw": 0.2}}


def wheel(t: float, v: float) -> Sample:
    return Sample(round(t * 1e9), "wheel", [v, 0.1], 0.01)


def test_the_first_gain_whose_conditions_hold() -> None:
    """By age, speed, a state and sensors that are heard; the last one where nothing else holds."""
    plan = make_plan(
        turns(
            {"when": {"age": {"below": "2 s"}}, **weights(0.9)},
            {"when": {"sensors": ["compass"], "speed": {"above": 1.5}}, **weights(0.8)},
            {"when": {"speed": {"above": 1.5}}, **weights(0.7)},
            {"when": {"states": {"v": {"above": 0.5, "below": 1.0}}}, "mode": "optimal"},
            weights(0.3),
        )
        | {"lag": {"window": 0}}
    )
    samples = [
        wheel(10.0, 1.0),  # age 0
        wheel(11.9, 2.0),  # age 1.9
        wheel(12.1, 2.0),  # v near 2, no compass
        wheel(12.2, 0.0),  # the same: the decision looks at what was known before
        wheel(12.3, 0.0),
        wheel(12.4, 0.0),  # v near 0.6, then lower
        wheel(12.5, 0.0),
    ]
    track = Engine(plan).advance(events_of(plan, samples))
    v = [1.0, *track["v"][:-1]]
    expected = [0.9, 0.9] + [0.7 if x > 1.5 else None if 0.5 < x < 1 else 0.3 for x in v[2:]]
    assert {0.7, 0.3, None} <= {*expected}
    for row, share in enumerate(expected):
        if share is None:
            assert track.absorbed[row, 0] not in (0.9, 0.8, 0.7, 0.3)
        else:
            assert track.absorbed[row, 0] == pytest.approx(share, abs=1e-12)


def test_a_sensor_that_is_heard() -> None:
    schedule = [{"when": {"sensors": ["compass"]}, **weights(0.8)}, weights(0.3)]
    config = turns(*schedule)
    config["gain"]["cycle"] = {"max_age": "1 s"}
    plan = make_plan(config)
    compass = Sample(10 * SECOND, "compass", [0.3], 0.01)
    track = Engine(plan).advance(
        events_of(plan, [wheel(9, 1), compass, wheel(10.5, 1), wheel(11.0, 1), wheel(11.1, 1)])
    )
    assert track.absorbed[track.of("wheel"), 0] == pytest.approx([0.3, 0.8, 0.8, 0.3], abs=1e-12)


def test_late_samples_meet_the_gain_of_their_own_time() -> None:
    plan = make_plan(
        turns(
            {"when": {"age": {"below": "2 s"}}, **weights(0.9)},
            {"when": {"states": {"v": {"above": 1}}}, **weights(0.5)},
            weights(0.3),
        )
        | {"lag": {"window": "3 s"}}
    )
    rng = np.random.default_rng(4)
    samples = [wheel(5 + 0.1 * k, 1 + math.sin(k)) for k in range(60)]
    shuffled = [samples[i] for i in np.argsort([k + rng.integers(0, 10) for k in range(60)])]
    received = Engine(plan)
    received.advance(events_of(plan, shuffled))
    stamped, _ = by_stamp(plan, [events_of(plan, shuffled)])
    assert received.estimate.x.tobytes() == stamped.x[-1].tobytes()


def redundant(gain: dict) -> Plan:
    sensors = {name: {"topic": f"/{name}", "fuse": ["x"], "noise": {"x": sd}} for name, sd in SD.items()}
    model = {"name": "brownian", "process_noise": {"x": 0.05**2}}
    initial = {"state": {"x": 0}, "sd": {"x": 0.05}}
    return make_plan({"model": model, "initial": initial, "gain": gain, "sensors": {"speed": SPEED, **sensors}})


def test_after_a_gap_the_optimal_gain_finds_back() -> None:
    """600 s of silence: the error of the ten updates after it, with fixed gains, the optimal one, and both in turn."""
    g = {f"{name}.x": 0.4318 * share for name, share in SHARES.items()}
    fixed = {"mode": "fixed", "form": "state", "weights": {"x": g}}
    rates = {"rates": dict.fromkeys(SD, 1)}
    rng, runs, settled = np.random.default_rng(5), 400, 40
    errors = {}
    for name, gain in {
        "optimal": {"mode": "optimal"},
        "fixed": fixed,
        "both": fixed | rates | {"reacquire": {"gap": "5 s"}},
        "by covariance": fixed | rates | {"reacquire": {"gap": "1000 s"}},
    }.items():
        plan, squares, rng = redundant(gain), list[float](), np.random.default_rng(5)
        for _ in range(runs):
            steps = np.concatenate([rng.normal(0, 0.05, settled), [rng.normal(0, 0.05 * math.sqrt(600))]])
            truth = np.cumsum(np.concatenate([steps, rng.normal(0, 0.05, 9)]))
            samples = samples_of(truth, int(rng.integers(1 << 30)))
            late = [s._replace(t_ns=s.t_ns + 599 * SECOND * (s.t_ns > settled * SECOND)) for s in samples]
            track = Engine(plan).advance(events_of(plan, late))
            last = np.append(track.t_ns[1:] != track.t_ns[:-1], True)
            squares.append(float(np.mean((track.x[last, 0] - truth)[-10:] ** 2)))
        errors[name] = math.sqrt(np.mean(squares))
    print(errors)
    assert errors["fixed"] > 3 * errors["optimal"]
    assert errors["both"] == pytest.approx(errors["optimal"], rel=0.02)
    assert errors["by covariance"] == pytest.approx(errors["both"], rel=0.01)


def test_reacquisition_ends_where_the_covariance_has_settled() -> None:
    """From a bad start the shares are the optimal ones, and the configured ones once P is near its steady value."""
    gain = {"mode": "fixed", "weights": {"distance.y": 0.39, "gyro.yaw": 0.18}, "rates": RATES, "reacquire": {}}
    config = wall(gain) | {"initial": {"state": {"y": 0, "yaw": 0}, "sd": {"y": 5.0, "yaw": 1.0}}}
    plan = make_plan(config)
    track = Engine(plan).advance(events_of(plan, wall_samples(200)))
    y = track.absorbed[track.of("distance"), 0]
    assert y[0] > 0.99
    assert y[-1] == pytest.approx(0.39, abs=1e-12)
    first = int(np.flatnonzero(np.abs(y - 0.39) < 1e-12)[0])
    assert 1 < first < 60
    assert (np.abs(y[first:] - 0.39) < 1e-12).all()


def test_a_configuration_without_reacquisition_ends_one() -> None:
    """Otherwise the optimal gain would stay for good."""
    gain = {"mode": "fixed", "weights": {"distance.y": 0.39, "gyro.yaw": 0.18}, "rates": RATES, "reacquire": {}}
    start = {"initial": {"state": {"y": 0, "yaw": 0}, "sd": {"y": 5.0, "yaw": 1.0}}}
    plan, other = make_plan(wall(gain) | start), make_plan(wall({**gain, "reacquire": None}) | start)
    events, engine = events_of(plan, wall_samples(200)), Engine(plan)
    first = engine.advance(events.take(slice(0, 2)))
    assert first.absorbed[first.of("distance"), 0].max() > 0.99
    engine.settle()
    engine.configure(other)
    after = engine.advance(events.take(slice(2, None)))
    assert after.absorbed[after.of("distance"), 0] == pytest.approx(0.39, abs=1e-12)


@pytest.mark.parametrize(
    ("gain", "expected"),
    [
        (
            {"form": "matrix", "weights": {"y": {"distance.y": 2.5}, "yaw": {"gyro.yaw": 0.2}}},
            "these weights cannot work: the error does not decay in y (eigenvalue -1.5): spectral radius 1.5",
        ),
        (
            {"form": "matrix", "weights": {"y": {"distance.y": 0.4, "gyro.yaw": 0.1}}},
            "the error does not decay in ",
        ),
        ({"weights": {"distance.y": 0.4, "gyro.yaw": 0.2}, "open_loop": ["yaw"]}, "yaw is not open_loop: "),
        ({"weights": {"distance.y": 0.4, "gyro.yaw": 0.2}, "open_loop": ["yam"]}, "no state 'yam' (did you mean yaw?)"),
    ],
)
def test_weights_that_cannot_work_are_refused(gain: dict, expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make_plan(wall({"mode": "fixed", "rates": RATES, "nominal": {"v": 0.025}} | gain))
    assert expected in str(caught.value)


def test_weights_that_work_are_not() -> None:
    make_plan(wall({"mode": "fixed", "rates": RATES, "weights": {"distance.y": 0.4, "gyro.yaw": 0.2}}))
    states = {"y": {"distance.y": 0.4}, "yaw": {"gyro.yaw": 0.2}}
    make_plan(wall({"mode": "fixed", "form": "state", "rates": RATES, "weights": states, "cycle": {"period": 0.2}}))


def test_a_state_that_nothing_would_ever_correct() -> None:
    config = configuration("unicycle", model={"name": "unicycle", "process_noise": dict.fromkeys(("v", "yaw_rate"), 0)})
    config["initial"]["sd"] = dict.fromkeys(("x", "y", "yaw", "v", "yaw_rate"), 0)
    with pytest.raises(ConfigError, match=r"initial.sd.v: 0, and no process noise reaches it"):
        make_plan(config)


@pytest.mark.parametrize(
    ("gain", "expected"),
    [
        (TWO, "gain.schedule: its last gain has no conditions"),
        (TWO | {"schedule": [{"mode": "optimal", "when": {"age": {"below": 1}}}]}, "its last gain has no conditions"),
        (TWO | {"schedule": [{"mode": "optimal"}, {"mode": "optimal"}]}, "what follows would never hold"),
        (
            TWO | {"schedule": [{"when": {"states": {"a": {"below": 1}}}, "mode": "optimal"}, {"mode": "optimal"}]},
            "no state 'a'",
        ),
        (TWO | {"schedule": [{"when": {"age": {}}, "mode": "optimal"}, {"mode": "optimal"}]}, "needs above, below"),
        (
            TWO | {"schedule": [{"when": {"sensors": ["gps2"]}, "mode": "optimal"}, {"mode": "optimal"}]},
            "'gps2' corrects",
        ),
        (TWO | {"schedule": [{"when": {"age": {"below": 1}}}, {"mode": "optimal"}]}, "needs a mode, or weights"),
        ({"mode": "optimal", "schedule": [{"mode": "optimal"}]}, "needs mode: scheduled"),
        ({"mode": "optimal", "reacquire": {}}, "gain.reacquire: is for gains other than the optimal one"),
        ({"mode": "optimal", "covariance": "none"}, "gain.covariance: optimal needs the covariance"),
    ],
)
def test_schedules_that_make_no_sense(gain: dict, expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        setup("unicycle", gain=gain)
    assert expected in str(caught.value)


def test_the_estimate_without_its_covariance() -> None:
    """The same x to the last bit, no P, no NIS."""
    rows = {"y": {"distance.y": 0.4, "gyro.yaw": -0.02}, "yaw": {"gyro.yaw": 0.18, "distance.y": 0.001}}
    tracks = []
    for covariance in ("joseph", "none"):
        plan = make_plan(wall({"mode": "fixed", "form": "matrix", "weights": rows, "covariance": covariance}))
        tracks.append(Engine(plan).advance(events_of(plan, wall_samples(100))))
    assert tracks[0].x.tobytes() == tracks[1].x.tobytes()
    assert tracks[0].P.any()
    assert not tracks[1].P.any()
    assert np.isnan(tracks[1].nis).all()
    assert np.array_equal(tracks[0].innovation, tracks[1].innovation, equal_nan=True)
