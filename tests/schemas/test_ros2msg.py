"""The parser of message definitions."""

import pytest

from fuselog.schemas import SchemaError, field_paths, stamp_path
from fuselog.schemas.ros2msg import parse_ros2msg
from fuselog.schemas.tree import Array, Number, Record, Text

LINE = "=" * 80


def paths(text: str, name: str = "pk/msg/Root") -> dict[str, str]:
    return field_paths(encoding="cdr", schema_encoding="ros2msg", schema_name=name, schema_text=text)


def stamp(text: str) -> str | None:
    return stamp_path(encoding="cdr", schema_encoding="ros2msg", schema_name="pk/msg/Root", schema_text=text)


def test_every_shape_of_field() -> None:
    text = """
        # a comment
        int32 LIMIT=7
        string NAME = "a = b # not a comment"
        float64 plain        # with a comment
        float64 valued 1.5
        string quoted "x # y = z"
        int32[] list [1, 2]
        string<=5 bounded
        string<=5[<=3] both
        float32[<=4] upto
        uint8[16] id
        wstring wide
    """
    root = parse_ros2msg("pk/msg/Root", text)
    assert root.fields == {
        "plain": Number("float64"),
        "valued": Number("float64"),
        "quoted": Text(),
        "list": Array(Number("int32"), None),
        "bounded": Text(),
        "both": Array(Text(), None),
        "upto": Array(Number("float32"), None),
        "id": Array(Number("uint8"), 16),
        "wide": Text(wide=True),
    }


def test_names_of_the_same_package_of_others_and_header() -> None:
    text = (
        f"Header header\nOther near\nq/msg/Far far\n{LINE}\nMSG: pk/Other\nfloat64 x\n"
        f"{LINE}\r\nMSG: q/msg/Far\r\nOther other\r\n{LINE}\nMSG: q/Other\nint8 y\n"
        f"{LINE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    )
    assert paths(text) == {
        "header.stamp.sec": "int32",
        "header.stamp.nanosec": "uint32",
        "header.frame_id": "string",
        "near.x": "float64",
        "far.other.y": "int8",
    }


def test_an_empty_message_holds_one_byte() -> None:
    assert parse_ros2msg("std_msgs/msg/Empty", "# nothing\n") == Record(
        "std_msgs/Empty", {"structure_needs_at_least_one_member": Number("uint8")}
    )


def test_paths_that_can_be_asked_for() -> None:
    text = f"Point[] cloud\nPoint[2] pair\nfloat64[9] matrix\nfloat64[] list\n{LINE}\nMSG: pk/Point\nfloat64 x\n"
    assert paths(text) == {
        "cloud[]": "uint32",
        "cloud[0].x": "float64",
        "pair[0].x": "float64",
        "matrix": "float64[9]",
        "list[]": "uint32",
        "list[0]": "float64",
    }


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("float64\n", "not a field of pk/Root: 'float64'"),
        ("float64 x y=\nfloat65 x\n", "pk/Root needs pk/float65, not defined here"),
        (
            f"A a\n{LINE}\nMSG: pk/A\nB b\n{LINE}\nMSG: pk/B\nA a\n",
            "pk/A holds itself: pk/Root -> pk/A -> pk/B -> pk/A",
        ),
        ("Root again\n", "pk/Root holds itself"),
        ("float64[0] x\n", "an array of 0 elements"),
        ("uint8[99999999999] x\n", "an array of 99999999999 elements"),
    ],
)
def test_a_bad_definition_says_where(text: str, reason: str) -> None:
    with pytest.raises(SchemaError, match="pk/msg/Root: ") as caught:
        paths(text)
    assert reason in str(caught.value)


def test_a_definition_that_doubles_at_every_level_is_refused() -> None:
    text = "A0 a\n" + "".join(f"{LINE}\nMSG: pk/A{n}\nA{n + 1} a\nA{n + 1} b\n" for n in range(40))
    with pytest.raises(SchemaError, match="more than 100000 fields"):
        paths(text + f"{LINE}\nMSG: pk/A40\nuint8 x\n")


@pytest.mark.parametrize(
    ("text", "path"),
    [
        (
            f"std_msgs/Header header\n{LINE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\n",
            "header.stamp",
        ),
        ("float64 x\nbuiltin_interfaces/Time stamp\n", "stamp"),
        ("uint64 timestamp\nint64 timestamp_ns\n", "timestamp_ns"),
        ("float64 timestamp\n", None),
        ("uint8 x\n", None),
    ],
)
def test_the_stamp_is_guessed(text: str, path: str | None) -> None:
    assert stamp(text) == path
