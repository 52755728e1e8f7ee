"""The encoder: what it writes is read back by our decoder, by rosbags and by mcap-ros2-support."""

import numpy as np
import pytest
from numpy.typing import NDArray

from fuselog.schemas import CdrEncoder, Columns, SchemaError, compile_codec, definition

N = 7
T_NS = 1_477_010_443_000_000_001 + np.arange(N) * 123_456_789
ESTIMATE = "fuselog_msgs/msg/Estimate"
DECISION = "fuselog_msgs/msg/Decision"
ODOMETRY = "nav_msgs/msg/Odometry"


def random(width: int) -> NDArray[np.float64]:
    return np.random.default_rng(1).normal(size=(N, width))


def read(name: str, fields: list[str], data: NDArray[np.uint8], size: int) -> Columns:
    codec = compile_codec(
        encoding="cdr", schema_encoding="ros2msg", schema_name=name,
        schema_text=definition(name), fields=fields, stamp="header.stamp",
    )  # fmt: skip
    return codec.decode(data, np.arange(N) * size, np.full(N, size))


def test_odometry_is_read_back_by_everyone() -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    dynamic = pytest.importorskip("mcap_ros2._dynamic")
    columns = ["pose.pose", "twist.covariance", "twist.twist.linear.x"]
    constants = {"header.frame_id": "odom", "child_frame_id": "base_link", "pose.covariance[35]": 0.25}
    encoder = CdrEncoder(ODOMETRY, definition(ODOMETRY), columns=columns, constants=constants)
    values = random(44)
    data, size = encoder.encode(T_NS, values)
    assert data.shape == (N * size,)
    assert data[:4].tolist() == [0, 1, 0, 0]
    back = read(ODOMETRY, [*columns, "pose.covariance", "child_frame_id", "header.frame_id"], data, size)
    assert not back.fault.any()
    assert back.paths[:44] == encoder.paths
    np.testing.assert_array_equal(back.values[:, :44], values)
    np.testing.assert_array_equal(back.values[:, 44:], [[0.0] * 35 + [0.25]] * N)
    np.testing.assert_array_equal(back.t_ns, T_NS)
    assert back.texts == {"child_frame_id": ["base_link"] * N, "header.frame_id": ["odom"] * N}

    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    decoder = dynamic.generate_dynamic(ODOMETRY, definition(ODOMETRY))[ODOMETRY]
    for row in range(N):
        payload = data[row * size : (row + 1) * size].tobytes()
        for message in (store.deserialize_cdr(payload, ODOMETRY), decoder(payload)):
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == T_NS[row]
            assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
            assert message.pose.pose.orientation.w == values[row, 6]
            assert list(message.twist.covariance) == values[row, 7:43].tolist()
        assert bytes(store.serialize_cdr(store.deserialize_cdr(payload, ODOMETRY), ODOMETRY)) == payload


def test_sequences_of_strings_and_numbers_have_given_lengths() -> None:
    encoder = CdrEncoder(
        ESTIMATE, definition(ESTIMATE), columns=["state", "covariance"],
        constants={"names[0]": "x", "names[1]": "yaw", "model": "planar"},
        lengths={"names": 2, "state": 2, "covariance": 3},
    )  # fmt: skip
    values = random(5)
    data, size = encoder.encode(T_NS, values)
    fields = ["state[0]", "state[1]", "covariance[0]", "covariance[1]", "covariance[2]"]
    back = read(ESTIMATE, [*fields, "state[]", "covariance[]", "names[]", "names[1]", "model"], data, size)
    np.testing.assert_array_equal(back.values, np.hstack([values, np.tile([2.0, 3.0, 2.0], (N, 1))]))
    assert back.texts == {"names[1]": ["yaw"] * N, "model": ["planar"] * N}


def test_messages_in_a_sequence() -> None:
    name = "tf2_msgs/msg/TFMessage"
    encoder = CdrEncoder(
        name, definition(name), columns=["transforms[1].transform"], lengths={"transforms": 2},
        constants={"transforms[0].child_frame_id": "a", "transforms[1].child_frame_id": "longer"},
        stamp="transforms[1].header.stamp",
    )  # fmt: skip
    values = random(7)
    data, size = encoder.encode(T_NS, values)
    codec = compile_codec(
        encoding="cdr", schema_encoding="ros2msg", schema_name=name, schema_text=definition(name),
        fields=["transforms[1].transform", "transforms[1].child_frame_id"],
        stamp="transforms[1].header.stamp",
    )  # fmt: skip
    back = codec.decode(data, np.arange(N) * size, np.full(N, size))
    np.testing.assert_array_equal(back.values, values)
    np.testing.assert_array_equal(back.t_ns, T_NS)
    assert back.texts["transforms[1].child_frame_id"] == ["longer"] * N


def test_every_kind_of_number_is_stored_exactly() -> None:
    limits = {
        "uint8": (0, 255), "int8": (-128, 127), "uint16": (0, 65535), "int16": (-32768, 32767),
        "uint32": (0, 2**32 - 1), "int32": (-(2**31), 2**31 - 1), "uint64": (0, 2**53),
        "int64": (-(2**63), 2**62),
        "float32": (-1.5, np.inf), "float64": (-1e300, 1e-300), "bool": (0, 1),
        "byte": (0, 255), "char": (0, 255),
    }  # fmt: skip
    text = "".join(f"{kind} {kind}_\n" for kind in limits)
    encoder = CdrEncoder("pk/msg/All", text, columns=[f"{kind}_" for kind in limits], stamp=None)
    values = np.array(list(zip(*limits.values(), strict=True)), np.float64)
    data, size = encoder.encode(np.zeros(2, np.int64), values)
    codec = compile_codec(
        encoding="cdr", schema_encoding="ros2msg", schema_name="pk/msg/All", schema_text=text,
        fields=list(encoder.paths), stamp=None,
    )  # fmt: skip
    np.testing.assert_array_equal(codec.decode(data, np.array([0, size]), np.array([size, size])).values, values)


@pytest.mark.parametrize("value", [-1.0, 256.0, 0.5, np.nan, np.inf])
def test_a_number_that_does_not_fit_is_refused(value: float) -> None:
    encoder = CdrEncoder(DECISION, definition(DECISION), columns=["nis", "decision", "dof"])
    with pytest.raises(SchemaError, match="dof has values that uint8 cannot hold"):
        encoder.encode(T_NS[:1], np.array([[1.0, 0.0, value]]))


def test_a_stamp_that_does_not_fit_is_refused() -> None:
    encoder = CdrEncoder(DECISION, definition(DECISION), columns=[])
    with pytest.raises(SchemaError, match="stamp has values that int32 cannot hold"):
        encoder.encode(np.array([2**31 * 10**9]), np.empty((1, 0)))


def test_negative_stamps_and_no_messages() -> None:
    encoder = CdrEncoder(DECISION, definition(DECISION), columns=["nis"])
    data, size = encoder.encode(np.full(N, -1), np.zeros((N, 1)))
    assert read(DECISION, [], data, size).t_ns.tolist() == [-1] * N
    assert encoder.encode(np.empty(0, np.int64), np.empty((0, 1)))[0].shape == (0,)


@pytest.mark.parametrize(
    ("columns", "constants", "lengths", "reason"),
    [
        (["nis_"], {}, {}, "no field nis_: .*did you mean nis"),
        (["innovation"], {}, {}, "innovation holds no number here"),
        (["sensor"], {}, {}, "sensor holds no number here"),
        ([], {"sensr": "imu"}, {}, "no field sensr: .*did you mean sensor"),
        ([], {"nis": "imu"}, {}, "nis is no string here"),
        ([], {}, {"nis": 3}, "nis is no sequence here"),
        ([], {"sensor": 3}, {}, "sensor holds no number here"),
        ([], {"decision": -1}, {}, "decision cannot hold -1"),
    ],
)
def test_a_wrong_path_says_what_would_be_right(
    columns: list[str], constants: dict[str, str | float], lengths: dict[str, int], reason: str
) -> None:
    with pytest.raises(SchemaError, match=reason):
        CdrEncoder(DECISION, definition(DECISION), columns=columns, constants=constants, lengths=lengths)


def test_values_of_another_width_are_refused() -> None:
    with pytest.raises(ValueError, match=r"values are \(7, 2\), not \(7, 1\)"):
        CdrEncoder(DECISION, definition(DECISION), columns=["nis"]).encode(T_NS, random(2))
