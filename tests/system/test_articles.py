"""The articles' systems, simulated as logs and fused by configuration: gains and errors as theory has them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fuselog.fusion import Plan, Track, compile_plan, parse_config
from fuselog.replay import open_log, reprocess
from fuselog.replay.simulate import simulate
from fuselog.replay.truth import read_truth

READING = {"fields": {"x": "values[0]"}}
SPEED = {"topic": "/input/velocity", "kind": "input", "fields": {"v": "values[0]"}, "noise": {"v": 1e-9}}


def plan_of(**configuration: Any) -> Plan:
    return compile_plan(*parse_config(json.dumps({"fuselog": 1, **configuration})))


def particle(sd: float, step: float, period: float) -> Plan:
    """A Brownian number with a known speed and start; ``step`` is the sd that a period adds."""
    return plan_of(
        model={"name": "brownian", "process_noise": {"x": step**2 / period}},
        initial={"state": {"x": 0}, "sd": {"x": 0}},
        sensors={
            "speed": SPEED,
            "position": {"topic": "/sensor/position", "fuse": ["x"], "noise": {"x": sd}, **READING},
        },
    )


def last_gain(track: Track) -> float:
    return float(track.absorbed[track.of("position")[-1], 0])


@pytest.mark.parametrize(("step", "sd", "gain"), [(0.02, 0.2, 0.095125), (0.2, 0.02, 0.990195)])
def test_kiselevs_particle_settles_at_his_gain(tmp_path: Path, step: float, sd: float, gain: float) -> None:
    log = tmp_path / "particle.mcap"
    simulate("kiselev_scalar", log, seed=1, parameters={"sigma_xi": step, "sigma_eta": sd})
    track = reprocess(log, particle(sd, step, 0.1))
    assert last_gain(track) == pytest.approx(gain, abs=1e-4)


def test_alymovs_gain_is_the_golden_ratio(tmp_path: Path) -> None:
    log = tmp_path / "alymov.mcap"
    simulate("alymov_1d", log, seed=1)
    assert last_gain(reprocess(log, particle(1.0, 1.0, 1.0))) == pytest.approx((5**0.5 - 1) / 2, abs=1e-12)


def test_kiselevs_wall_with_two_sensors(tmp_path: Path) -> None:
    """Figure 9: distance and gyro together; errors as the coupled filter's theory, .1248 m and .0213 rad."""
    log, xi, zeta, period = tmp_path / "wall.mcap", 0.1, 0.01, 0.1
    simulate("kiselev_wall_two", log, seed=2, duration=300.0)
    distance = {"topic": "/wall/distance", "fuse": ["y"], "fields": {"y": "values[0]"}}
    plan = plan_of(
        model={"name": "wall_follower", "process_noise": {"y": xi**2 / period, "yaw": zeta**2 / period}},
        initial={"state": {"y": 0, "yaw": 0.01}, "sd": {"y": 1e-9, "yaw": 1e-9}},
        sensors={
            "wheels": {"topic": "/wheel/twist", "kind": "input", "noise": {"v": 1e-9, "yaw_rate": 1e-9}},
            "distance": {**distance, "mount": {"xyz": [0.15, 0, 0]}, "noise": {"y": 0.2}},
            "gyro": {"topic": "/gyro/attitude", "fuse": ["yaw"], "noise": {"yaw": 0.05}},
        },
    )
    track = reprocess(log, plan)
    with open_log(log) as opened:
        truth = read_truth(opened, "/ground_truth")
    row = np.searchsorted(track.t_ns, truth.t_ns[10:], side="right") - 1
    error_y = track["y"][row] - truth.values["y"][10:]
    error_yaw = np.remainder(track["yaw"][row] - truth.values["yaw"][10:] + np.pi, 2 * np.pi) - np.pi
    assert np.sqrt(np.mean(error_y**2)) == pytest.approx(0.1248, rel=0.08)
    assert np.sqrt(np.mean(error_yaw**2)) == pytest.approx(0.0213, rel=0.08)
    for sensor, gain in (("distance", 0.3904), ("gyro", 0.1810)):
        rows = track.of(sensor)
        assert np.mean(track.nis[rows]) == pytest.approx(1.0, abs=0.1)
        assert track.absorbed[rows[-1], 0] == pytest.approx(gain, abs=2e-3)
