"""``fuselog reprocess`` of a configuration whose topics capture names: a filter for each name in the log."""

import json
from pathlib import Path

import numpy as np

from .conftest import run, write_log

FLEET = """\
fuselog: 1
model: {name: constant_velocity_1d}
sensors:
  camera: {topic: "/fleet/{robot}/camera", fuse: [x], noise: {x: 0.1}}
output: {estimate: "fleet/{robot}/fused"}
"""


def test_a_filter_for_each_name(tmp_path: Path) -> None:
    """Each robot has its own track and summary, the same as with its name in the configuration; one can be chosen."""
    config, log, times = tmp_path / "fleet.yaml", tmp_path / "fleet.mcap", np.arange(50) * 0.1
    config.write_text(FLEET)
    pose = ("geometry_msgs/msg/PoseStamped", ["pose.position.x"])
    write_log(log, [(f"/fleet/r{n}/camera", *pose, times, 0.01, n * times[:, None]) for n in (1, 2)])
    done = run("reprocess", log, "-c", config, "-o", tmp_path / "out_{robot}.mcap", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["schema"], list(told["filters"])) == (1, ["r1", "r2"])
    assert [Path(one["output"]).name for one in told["filters"].values()] == ["out_r1.mcap", "out_r2.mcap"]
    assert abs(told["filters"]["r2"]["final"]["state"]["vx"] - 2) < 0.1
    plain = tmp_path / "r2.yaml"
    plain.write_text(FLEET.replace("{robot}", "r2"))
    alone = json.loads(run("reprocess", log, "-c", plain, "--json").stdout)
    one = json.loads(run("reprocess", log, "-c", config, "--only", "robot=r2", "--json").stdout)
    assert list(one["filters"]) == ["r2"]
    assert alone["sha256"] == one["filters"]["r2"]["sha256"] == told["filters"]["r2"]["sha256"]


def test_what_cannot_be(small_log: Path, tmp_path: Path) -> None:
    """One file for all, a name that is not captured, and a log without any: exit 2, and why."""
    config, log, times = tmp_path / "fleet.yaml", tmp_path / "fleet.mcap", np.arange(5) * 0.1
    config.write_text(FLEET)
    write_log(log, [("/fleet/r1/camera", "geometry_msgs/msg/PoseStamped", ["pose.position.x"], times, 0.01, times)])
    for arguments, reason in (
        ([log, "-o", tmp_path / "out.mcap"], "put {robot} into it"),
        ([log, "--only", "hall=east"], "--only robot=VALUE"),
        ([small_log], "no topic of the log is as /fleet/{robot}/camera"),
    ):
        done = run("reprocess", *arguments, "-c", config)
        assert done.returncode == 2, done.stderr
        assert reason in " ".join(done.stderr.split()), done.stderr
