"""The decoder on messages whose bytes are written down here."""

import struct

import numpy as np
import pytest

from fuselog.schemas import Codec, Columns, Fault, SchemaError, compile_codec, definition

STAMP_NS = 1_477_010_443_123_456_789


def codec(schema: str, fields: list[str], stamp: str | None = None) -> Codec:
    name = schema if "\n" not in schema else "pk/msg/Root"
    text = definition(schema) if "\n" not in schema else schema
    return compile_codec(
        encoding="cdr", schema_encoding="ros2msg",
        schema_name=name, schema_text=text, fields=fields, stamp=stamp,
    )  # fmt: skip


def decode(decoder: Codec, *payloads: bytes) -> Columns:
    length = np.array([len(payload) for payload in payloads], np.int64)
    return decoder.decode(np.frombuffer(b"".join(payloads), np.uint8), np.cumsum(length) - length, length)


def transform(number: float, *, pad: int) -> bytes:
    """A geometry_msgs/TransformStamped that begins ``pad`` bytes before a multiple of 8."""
    head = struct.pack("<iiI5sxxxI2sxx", 1, 2, 5, b"odom\0", 2, b"b\0")
    head += bytes(-(len(head) - pad) % 8)
    return head + struct.pack("<7d", *(number + index for index in range(7)))


def test_an_imu_in_both_byte_orders() -> None:
    decoder = codec("sensor_msgs/msg/Imu", ["angular_velocity.z", "orientation", "header.frame_id"], "header.stamp")
    assert decoder.paths == (
        "angular_velocity.z", "orientation.x", "orientation.y", "orientation.z", "orientation.w",
    )  # fmt: skip
    sec, nanosec = divmod(STAMP_NS, 1_000_000_000)
    numbers = [float(number) for number in range(37)]
    payloads = [
        bytes([0, order == "<", 0, 0]) + struct.pack(f"{order}iII9s3x37d", sec, nanosec, 9, b"imu_link\0", *numbers)
        for order in "<>"
    ]
    columns = decode(decoder, *payloads)
    assert columns.t_ns.tolist() == [STAMP_NS] * 2
    assert columns.values.tolist() == [[15.0, 0.0, 1.0, 2.0, 3.0]] * 2
    assert columns.texts == {"header.frame_id": ["imu_link", "imu_link"]}
    assert columns.fault.tolist() == [Fault.NONE] * 2


def test_elements_counts_and_what_is_missing_of_a_sequence_of_messages() -> None:
    fields = ["transforms[]", "transforms[1].transform.rotation.w", "transforms[0].transform.translation.x",
              "transforms[2].child_frame_id", "transforms[0].child_frame_id"]  # fmt: skip
    payloads = [b"\0\1\0\0" + struct.pack("<I", n) for n in range(4)]
    for n in range(4):
        for index in range(n):
            payloads[n] += transform(10.0 * index, pad=len(payloads[n]) - 4 and -(len(payloads[n]) - 4) % 8)
    columns = decode(codec("tf2_msgs/msg/TFMessage", fields), *payloads)
    assert columns.fault.tolist() == [0, 0, 0, 0]
    np.testing.assert_array_equal(columns["transforms[]"], [0, 1, 2, 3])
    np.testing.assert_array_equal(columns["transforms[1].transform.rotation.w"], [np.nan, np.nan, 16, 16])
    np.testing.assert_array_equal(columns["transforms[0].transform.translation.x"], [np.nan, 0, 0, 0])
    assert columns.texts["transforms[2].child_frame_id"] == ["", "", "", "b"]
    assert columns.texts["transforms[0].child_frame_id"] == ["", "b", "b", "b"]


def test_a_message_without_the_element_that_holds_its_stamp_is_another_schema() -> None:
    decoder = codec("tf2_msgs/msg/TFMessage", [], "transforms[0].header.stamp")
    columns = decode(decoder, b"\0\1\0\0" + bytes(4), b"\0\1\0\0\1\0\0\0" + transform(0.0, pad=4))
    assert columns.fault.tolist() == [Fault.SCHEMA, Fault.NONE]
    assert columns.t_ns.tolist() == [0, 1_000_000_002]


@pytest.mark.parametrize("kind", ["int64", "uint64"])
def test_a_stamp_in_ns_is_exact(kind: str) -> None:
    columns = decode(codec(f"{kind} t\nfloat64 x\n", ["t"], "t"), b"\0\1\0\0" + struct.pack("<qd", STAMP_NS, 1))
    assert columns.t_ns.tolist() == [STAMP_NS]
    assert columns["t"].tolist() == [float(STAMP_NS)]


def test_bytes_above_127_are_unsigned_and_any_true_is_one() -> None:
    columns = decode(codec("byte a\nchar b\nuint8 c\nint8 d\nbool e\n", list("abcde")), b"\0\1\0\0\xff\xff\xff\xff\x07")
    assert columns.values.tolist() == [[255.0, 255.0, 255.0, -1.0, 1.0]]


def test_a_field_may_be_asked_for_twice() -> None:
    decoder = codec("float64[3] a\n", ["a[1]", "a", "a[1]"])
    columns = decode(decoder, b"\0\1\0\0" + struct.pack("<3d", 1, 2, 3), b"\0\1\0\0")
    assert decoder.paths == ("a[1]", "a[0]", "a[1]", "a[2]", "a[1]")
    np.testing.assert_array_equal(columns.values, [[2, 1, 2, 3, 2], [np.nan] * 5])


def test_no_messages_and_no_fields() -> None:
    assert decode(codec("float64 a\n", ["a"])).values.shape == (0, 1)
    assert decode(codec("float64 a\n", []), b"\0\1\0\0" + bytes(8)).values.shape == (1, 0)


def test_data_may_be_writable_strided_or_read_only() -> None:
    payload = np.frombuffer(b"\0\1\0\0" + struct.pack("<d", 7.0), np.uint8)
    decoder = codec("float64 a\n", ["a"])
    wide = np.zeros((12, 2), np.uint8)
    wide[:, 0] = payload
    for data in (payload, payload.copy(), wide[:, 0]):
        assert decoder.decode(data, np.array([0]), np.array([12])).values.tolist() == [[7.0]]


@pytest.mark.parametrize(
    ("field", "reason"),
    [
        ("header.stmp", "header has stamp, frame_id; did you mean header.stamp"),
        ("twist.linear.x", "did you mean twist.twist.linear.x"),
        ("pose.covariance[36]", r"pose.covariance is float64\[36\]"),
        ("header", "header is not all numbers: header.frame_id is string"),
        ("child_frame_id.x", "child_frame_id is string"),
        ("a..b", "not a field path"),
        ("", "not a field path"),
        ("pose.covariance[]", r"pose.covariance is float64\[36\]"),
    ],
)
def test_a_wrong_field_says_what_would_be_right(field: str, reason: str) -> None:
    with pytest.raises(SchemaError, match=f"nav_msgs/msg/Odometry: .*{reason}"):
        codec("nav_msgs/msg/Odometry", [field])


@pytest.mark.parametrize("stamp", ["header", "header.frame_id", "header.stamp.sec", "pose.covariance[0]"])
def test_a_stamp_must_be_a_time(stamp: str) -> None:
    with pytest.raises(SchemaError, match="not a stamp"):
        codec("nav_msgs/msg/Odometry", [], stamp)


def test_a_sequence_as_a_whole_has_no_width() -> None:
    with pytest.raises(SchemaError, match=r"only from the data; ask for elements \(position\[0\]\)"):
        codec("sensor_msgs/msg/JointState", ["position"])


def test_an_unknown_encoding_says_what_is_supported() -> None:
    with pytest.raises(SchemaError, match=r"protobuf encoding with no schema is not supported .*cdr with ros2msg"):
        compile_codec(
            encoding="protobuf", schema_encoding="", schema_name="x", schema_text="", fields=[], stamp=None
        )  # fmt: skip
