"""Hashes of types against those that ROS 2 publishes, and against those of rosbags for other shapes."""

import pytest

from fuselog.schemas import SchemaError, definition, known_definitions, rihs01

PUBLISHED = {  # in the sources of several implementations; Jazzy, and later while the definitions stay
    "sensor_msgs/msg/Imu": "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    "nav_msgs/msg/Odometry": "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "sensor_msgs/msg/NavSatFix": "62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404",
    "sensor_msgs/msg/MagneticField": "e80f32f56a20486c9923008fc1a1db07bbb273cbbf6a5b3bfa00835ee00e4dff",
    "geometry_msgs/msg/PoseStamped": "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    "geometry_msgs/msg/Twist": "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "geometry_msgs/msg/TransformStamped": "0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206",
    "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "rosgraph_msgs/msg/Clock": "692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
}
SHAPES = """
int8 a
uint16[3] fixed
int64[] list
float32[<=4] upto
string text
string<=5 bounded
string<=5[<=3] both
bool flag
byte raw
Inner[] inner
q/msg/Far far
int32 LIMIT=7
float64 valued 1.5  # a comment
================================================================================
MSG: p/Inner
================================================================================
MSG: q/Far
p/Inner near
"""


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_hashes(name: str) -> None:
    assert rihs01(name, definition(name)) == f"RIHS01_{PUBLISHED[name]}"


def test_as_rosbags_has_it() -> None:
    """An independent implementation, over every standard type that comes with fuselog and every shape of field."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    standard = [name for name in known_definitions() if name in store.types]
    assert len(standard) > 20
    for name in standard:
        assert rihs01(name, definition(name)) == store.hash_rihs01(name)
    store.register(get_types_from_msg(SHAPES, "p/msg/Shapes"))
    assert rihs01("p/msg/Shapes", SHAPES) == store.hash_rihs01("p/msg/Shapes")


def test_a_type_that_is_not_there() -> None:
    with pytest.raises(SchemaError, match="needs p/Inner, not defined here"):
        rihs01("p/msg/A", "Inner inner")
