"""A recording holds what the logs hold, row by row, and nothing it cannot show."""

import numpy as np
import pytest
from rerun.chunk import RrdReader

from fuselog.fusion import compile_plan, parse_config
from fuselog.replay import LogWriter, open_log, reprocess_to
from fuselog.replay.results import read_results
from fuselog.replay.simulate import simulate
from fuselog.schemas import LogError
from fuselog.service.views.view import write_recording
from fuselog.service.views.viewer import open_viewer

CONFIG = """\
fuselog: 1
model: {name: differential_drive, process_noise: {y: 1e-4}}
initial: {state: {x: 0}, sd: {x: 0.01}}
sensors:
  wheels: {topic: /wheel/twist, kind: input, noise: {v: 0.02, yaw_rate: 0.03}, hold: previous}
  wall: {topic: /wall/range, fuse: [y], fields: {y: range}, noise: {y: 0.05}, mount: {xyz: [0.5, 0, 0]}, gate: 0.9}
  gyro: {topic: /gyro/attitude, fuse: [yaw]}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("view")
    simulate("wall", folder / "wall.mcap", duration=20)
    plan = compile_plan(*parse_config(CONFIG))
    with open_log(folder / "wall.mcap") as log:
        reprocess_to(log, plan, folder / "out.mcap")
    return folder


def chunks_of(recording):
    return RrdReader(str(recording)).stream().to_chunks()


def rows_of(recording, entity):
    """Stamps (ns) and scalars of an entity."""
    found = [c.to_record_batch() for c in chunks_of(recording) if str(c.entity_path) == entity and not c.is_static]
    stamps = np.concatenate([np.asarray(b.column("stamp")).astype(np.int64) for b in found])
    values = [row for b in found for row in b.column("Scalars:scalars").to_pylist()]
    return stamps, np.array(values)


@pytest.fixture(scope="module")
def recording(folder):
    write_recording(folder / "all.rrd", outs=[folder / "out.mcap"], log=folder / "wall.mcap")
    return folder / "all.rrd"


def test_recording_has_everything_of_a_run(recording):
    entities = {str(chunk.entity_path) for chunk in chunks_of(recording)}
    assert entities >= {
        "/log/measured/wall/y",
        "/log/measured/gyro/yaw",
        "/log/truth/path",
        "/log/truth/states/yaw",
        "/runs/out/path",
        "/runs/out/position",
        "/runs/out/ellipses",
        "/runs/out/states/x/estimate",
        "/runs/out/states/yaw/band",
        "/runs/out/innovations/wall.y/samples",
        "/runs/out/innovations/wall.y/band",
        "/runs/out/gains/gyro.yaw",
        "/runs/out/nis/wall/samples",
        "/runs/out/nis/wall/unused",
        "/bounds/wall/upper",
    }
    assert RrdReader(str(recording)).blueprints(), "the layout comes with it"


def test_estimates_are_those_of_the_log(recording, folder):
    results = read_results(folder / "out.mcap")
    stamps, values = rows_of(recording, "/runs/out/states/y/estimate")
    np.testing.assert_array_equal(stamps, results.t_ns)
    np.testing.assert_array_equal(values[:, 0], results.x[:, results.states.index("y")])


def test_bands_are_two_sigma(recording, folder):
    wall = read_results(folder / "out.mcap").decisions["wall"]
    tried = np.isfinite(wall.innovation_variance[:, 0])
    stamps, limits = rows_of(recording, "/runs/out/innovations/wall.y/band")
    np.testing.assert_array_equal(stamps, wall.t_ns[tried])
    np.testing.assert_allclose(limits[:, 1], 2 * np.sqrt(wall.innovation_variance[tried, 0]), rtol=1e-15)
    np.testing.assert_array_equal(limits[:, 0], -limits[:, 1])


def test_raw_measurements_are_those_of_the_sensor(recording, folder):
    with open_log(folder / "wall.mcap") as log:
        heard = log.read("/wall/range", ["range"])
    stamps, values = rows_of(recording, "/log/measured/wall/y")
    np.testing.assert_array_equal(stamps, heard.t_ns)
    np.testing.assert_array_equal(values[:, 0], heard["range"])


def test_samples_not_used_are_marked(recording, folder):
    wall = read_results(folder / "out.mcap").decisions["wall"]
    stamps, _ = rows_of(recording, "/runs/out/nis/wall/unused")
    np.testing.assert_array_equal(stamps, wall.t_ns[(wall.decision != 0) & np.isfinite(wall.nis)])
    assert len(stamps) > 0, "a gate of 90 % lets some samples out"


def test_runs_without_their_log(folder):
    write_recording(folder / "bare.rrd", outs=[folder / "out.mcap"])
    entities = {str(chunk.entity_path) for chunk in chunks_of(folder / "bare.rrd")}
    assert "/runs/out/path" in entities
    assert not any(entity.startswith("/log/") for entity in entities)


def test_runs_of_one_name_stay_apart(folder):
    (folder / "other one").mkdir()
    other = folder / "other one" / "out.mcap"
    other.write_bytes((folder / "out.mcap").read_bytes())
    write_recording(folder / "two.rrd", outs=[folder / "out.mcap", other])
    runs = {
        str(chunk.entity_path).split("/")[2] for chunk in chunks_of(folder / "two.rrd") if "/runs" in chunk.entity_path
    }
    assert len(runs) == 2
    assert "other_one-out" in runs


def test_log_that_is_no_output(folder):
    with pytest.raises(LogError, match="output of fuselog reprocess"):
        write_recording(folder / "never.rrd", outs=[folder / "wall.mcap"])


def test_log_of_something_else(folder):
    with LogWriter(folder / "empty.mcap"):
        pass
    with open_log(folder / "empty.mcap") as log:
        assert not log.topics
    write_recording(folder / "empty.rrd", outs=[folder / "out.mcap"], log=folder / "empty.mcap")


def test_truth_topic_that_is_not_there(folder):
    with pytest.raises(LogError, match="/nowhere"):
        write_recording(folder / "never.rrd", outs=[folder / "out.mcap"], log=folder / "wall.mcap", truth="/nowhere")


def test_no_viewer_without_a_display(folder, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert not open_viewer(folder / "all.rrd")
