"""Topics of ROS 2 as rmw_zenoh has them on Zenoh: keys of topic, type and hash, and tokens that say who sends."""
# Zenoh's stubs leave out what some methods return.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

import re
from collections.abc import Callable
from typing import Final, NamedTuple

import zenoh

from fuselog.schemas import definition, rihs01
from fuselog.service.wire import media_type

# Topics of ROS 2 as rmw_zenoh has them in its keys: <domain>/<topic>/<pkg>::msg::dds_::<Type>_/<hash of the type>.
_RMW_KEY: Final = re.compile(
    r"\d+/(?P<topic>.+)/(?P<package>\w+)::(?P<kind>msg|srv|action)::dds_::(?P<name>\w+)_/(?P<hash>\w+)"
)
_NODE: Final = "fuselog"
_NO_MEDIA: Final = "zenoh/bytes"
_DEFAULT_QUALITY: Final = "::,:,:,:,,"  # reliable, volatile, as rmw_zenoh has it by default


class RosKey(NamedTuple):
    """What a key of rmw_zenoh says."""

    topic: str
    type: str
    hash: str


def ros_key(key: str) -> RosKey | None:
    """The parts of a key of rmw_zenoh, None for any other."""
    match = _RMW_KEY.fullmatch(key)
    if match is None:
        return None
    return RosKey(f"/{match['topic']}", f"{match['package']}/{match['kind']}/{match['name']}", match["hash"])


def ros_subscription(topic: str, type_name: str | None, *, domain: int) -> str:
    """The key expression of a topic, whatever the hash of its type: it differs between distributions of ROS 2."""
    return f"{domain}/{topic.strip('/')}/{_mangled(type_name) if type_name else '*'}/*"


def media_of(sample: zenoh.Sample) -> str:
    """Zenoh's encoding of a sample; of one of rmw_zenoh, which gives none, the type and hash that its key says."""
    media = str(sample.encoding)
    ros = ros_key(str(sample.key_expr)) if media == _NO_MEDIA else None
    return media if ros is None else media_type("cdr", f"{ros.type};{ros.hash}")


def ros_publication(topic: str, type_name: str, *, domain: int) -> str:
    """The key of a topic of a type that comes with fuselog."""
    return f"{domain}/{topic.strip('/')}/{_mangled(type_name)}/{rihs01(type_name, definition(type_name))}"


def announce_node(session: zenoh.Session, *, domain: int) -> Callable[[], None]:
    """Have ROS 2 list us as a node; returns what ends it."""
    return session.liveliness().declare_token(f"@ros2_lv/{domain}/{session.zid()}/0/0/NN/%/%/{_NODE}").undeclare


def announce(session: zenoh.Session, number: int, topic: str, type_name: str, *, domain: int) -> Callable[[], None]:
    """Have ROS 2 list a topic that we publish, by our publisher of this ``number`` > 0; returns what ends it."""
    zid, hashed = session.zid(), rihs01(type_name, definition(type_name))
    place = f"@ros2_lv/{domain}/{zid}/0/{number}/MP/%/%/{_NODE}"
    kind = f"%{topic.strip('/').replace('/', '%')}/{_mangled(type_name)}/{hashed}/{_DEFAULT_QUALITY}"
    return session.liveliness().declare_token(f"{place}/{kind}").undeclare


def _mangled(type_name: str) -> str:
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"
