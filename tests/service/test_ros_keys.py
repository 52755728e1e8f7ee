"""Keys and tokens of rmw_zenoh, between real sessions."""

import time

from fuselog.service.ros_keys import announce, ros_key, ros_publication, ros_subscription
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.zenoh_door import alive, subscribe

from .test_transport_security import endpoint

ODOMETRY = "nav_msgs/msg/Odometry"
HASH = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"


def test_keys() -> None:
    key = f"7/fused/odom/nav_msgs::msg::dds_::Odometry_/{HASH}"
    assert ros_publication("/fused/odom", ODOMETRY, domain=7) == key
    assert ros_key(key) == ("/fused/odom", ODOMETRY, HASH)
    assert ros_subscription("/imu", "sensor_msgs/msg/Imu", domain=0) == "0/imu/sensor_msgs::msg::dds_::Imu_/*"
    assert ros_subscription("imu", None, domain=0) == "0/imu/*/*"


def test_a_topic_is_heard_and_listed() -> None:
    """By type and without; in its domain only; and listed as long as it is announced."""
    at = endpoint("tcp")
    got: list[str] = []
    with (
        open_session(Endpoints(listen=[at]), timeout_s=5) as ours,
        open_session(Endpoints(connect=[at]), timeout_s=5) as theirs,
    ):
        for kind, domain in ((ODOMETRY, 7), (None, 7), (ODOMETRY, 8), ("sensor_msgs/msg/Imu", 7)):
            expression = ros_subscription("odom", kind, domain=domain)
            subscribe(theirs, expression, lambda _, expression=expression: got.append(expression))
        end = announce(ours, 1, "odom", ODOMETRY, domain=7)
        time.sleep(0.3)  # until the subscriptions are known
        ours.put(ros_publication("odom", ODOMETRY, domain=7), b"")
        listed = alive(theirs, "@ros2_lv/7/**", timeout_s=2)
        end()
        time.sleep(0.1)
        assert alive(theirs, "@ros2_lv/7/**", timeout_s=2) == []
        zid = ours.zid()
    assert sorted(got) == ["7/odom/*/*", "7/odom/nav_msgs::msg::dds_::Odometry_/*"]
    kind = f"nav_msgs::msg::dds_::Odometry_/{HASH}"
    assert listed == [f"@ros2_lv/7/{zid}/0/1/MP/%/%/fuselog/%odom/{kind}/::,:,:,:,,"]
