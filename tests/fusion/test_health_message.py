"""Health as a message: our decoder and an independent one read back what was meant."""

import math

import numpy as np
import pytest
from tests.fusion.health_runs import EPOCH, Run, S, driving, two

from fuselog.fusion.health import HEALTH, Losses, health_message
from fuselog.schemas import compile_codec, definition

PLAN = two()


def test_our_decoder_reads_it() -> None:
    """Status, reasons, figures and counts of each sensor; NaN where nothing was examined."""
    run = Run(PLAN).feed(driving(100))
    health = run.health(losses={"b": Losses(missed=2, unknown=5, reason="grüße")})
    payload = health_message(health, filter_id="robot-1", frame="odom")
    numbers = ["position_sd", "condition", "heading_sd", "idle", "sensors[1].nis", "sensors[1].missed"]
    numbers += ["sensors[0].received", "sensors[1].unusable", "sensors[]", "reasons[]", "balanced"]
    texts = ["status", "filter", "header.frame_id", "reasons[0]", "sensors[0].name", "sensors[1].status"]
    kind = {"encoding": "cdr", "schema_encoding": "ros2msg", "schema_name": HEALTH, "schema_text": definition(HEALTH)}
    codec = compile_codec(**kind, fields=[*numbers, *texts], stamp="header.stamp")  # pyright: ignore[reportArgumentType]  strings
    columns = codec.decode(np.frombuffer(payload, np.uint8), np.array([0]), np.array([len(payload)]))
    assert columns.fault.tolist() == [0]
    assert columns.t_ns.tolist() == [EPOCH + round(10.95 * S)] == [health.t_ns]
    row = dict(zip(columns.paths, columns.values[0].tolist(), strict=True))
    b = health.sensors["b"]
    assert b.nis is not None
    assert row["position_sd"] == health.position_sd_m
    assert row["condition"] == health.condition
    assert row["sensors[1].nis"] == b.nis.mean
    assert (row["sensors[0].received"], row["sensors[1].missed"], row["sensors[1].unusable"]) == (100, 2, 5)
    assert (row["sensors[]"], row["reasons[]"], row["balanced"]) == (2, 2, 1)
    assert math.isnan(row["heading_sd"])
    assert math.isnan(row["idle"])
    said = {path: values[0] for path, values in columns.texts.items()}
    assert said["reasons[0]"] == health.reasons[0] == "b: 5 samples of unusable type: grüße"
    assert (said["status"], said["filter"], said["header.frame_id"]) == ("degraded", "robot-1", "odom")
    assert (said["sensors[0].name"], said["sensors[1].status"]) == ("a", "degraded")


def test_an_independent_decoder_reads_it() -> None:
    """rosbags, from the definition alone; a filter that has seen nothing as well."""
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(typesys.get_types_from_msg(definition(HEALTH), HEALTH))
    for run in (Run(PLAN), Run(PLAN).feed(driving(300, sd=3.0))):
        health = run.health()
        told = store.deserialize_cdr(health_message(health, filter_id="f", frame="map"), HEALTH)
        assert (told.status, told.reasons, told.notes) == (health.status, list(health.reasons), list(health.notes))
        assert (told.finite, told.positive, told.balanced) == (True, True, True)
        for sensor, (name, mine) in zip(told.sensors, health.sensors.items(), strict=True):
            assert (sensor.name, sensor.topic, sensor.status) == (name, f"/{name}", mine.status)
            assert (sensor.received, sensor.fused) == (mine.account.received, mine.account.fused)
            assert sensor.reasons == list(mine.reasons)
            assert math.isnan(sensor.nis) is (mine.nis is None)
