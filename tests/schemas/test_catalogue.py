"""The message definitions that come with fuselog."""

import pytest

from fuselog.schemas import SchemaError, definition, field_paths, known_definitions

_NAMES = ("Command", "Decision", "Estimate", "Health", "Reading", "SensorHealth")
OURS = tuple(f"fuselog_msgs/msg/{name}" for name in _NAMES)


@pytest.mark.parametrize("name", known_definitions())
def test_each_is_complete(name: str) -> None:
    text = definition(name)
    assert field_paths(encoding="cdr", schema_encoding="ros2msg", schema_name=name, schema_text=text)
    assert text.endswith("\n")
    titles = [line for line in text.splitlines() if line.startswith("MSG: ")]
    assert len(titles) == len(set(titles)) == text.count("=" * 80 + "\n")


@pytest.mark.parametrize("name", sorted(set(known_definitions()) - set(OURS)))
def test_standard_ones_are_those_of_ros_2(name: str) -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    theirs = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    mine = typesys.get_typestore(typesys.Stores.EMPTY)
    mine.register(typesys.get_types_from_msg(definition(name), name))
    assert mine.hash_rihs01(name) == theirs.hash_rihs01(name)


def test_ours_are_known_and_a_short_name_will_do() -> None:
    assert set(OURS) <= set(known_definitions())
    assert definition("nav_msgs/Odometry") == definition("nav_msgs/msg/Odometry")
    assert definition("nav_msgs/msg/Odometry").startswith("std_msgs/Header header\nstring child_frame_id\n")


@pytest.mark.parametrize("name", ["nav_msgs/msg/Odom", "Odometry", "../nav_msgs/msg/Odometry", ""])
def test_an_unknown_name_says_what_is_known(name: str) -> None:
    with pytest.raises(SchemaError, match=r"not a definition that comes with fuselog; .*nav_msgs/msg/Odometry"):
        definition(name)
