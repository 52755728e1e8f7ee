"""Everything compiled before the first sample comes."""

import numpy as np

from fuselog.fusion import Filter, Outputs, Plan, Stream, compile_plan, parse_config
from fuselog.fusion.health import assess, no_samples
from fuselog.fusion.intake import Intake
from fuselog.schemas import CdrEncoder, Messages, definition, pack

_KIND = "geometry_msgs/msg/PoseStamped"
_SIMPLEST = """\
fuselog: 1
model: {name: constant_velocity}
sensors:
  any: {topic: any, fuse: [x], noise: {x: 1}}
"""


def warm_up(plan: Plan) -> None:
    """Compile the kernels of a plan, or load them from the cache: no sample and no result waits for it later."""
    _decode_one()
    filter = Filter(plan, order="as_received")
    filter.warm_up()
    Outputs(plan).encode(filter.feed(_messages([])))
    assess(plan, estimate=filter.estimate, ledger=filter.ledger, recent=no_samples(plan), losses={})


def warm_up_for(change: Plan, running: Plan) -> None:
    """``warm_up``, where a plan that takes the place of another needs kernels that this one has not."""
    if change.kernel is not running.kernel:
        warm_up(change)


def _decode_one() -> None:
    """Decoding and binding are one kernel each, whatever the type and the model; any sample compiles them."""
    intake = Intake(compile_plan(*parse_config(_SIMPLEST)))
    text = definition(_KIND)
    stream = Stream(topic="any", encoding="cdr", schema_name=_KIND, schema_encoding="ros2msg", schema_text=text)
    intake.open(0, stream)
    payload, _ = CdrEncoder(_KIND, text, columns=["pose.position.x"]).encode(np.ones(1, np.int64), np.ones((1, 1)))
    intake.take(_messages([payload.tobytes()]))


def _messages(payloads: list[bytes]) -> Messages:
    """Messages of stream 0, in read-only memory as those of Zenoh are."""
    n = len(payloads)
    data, start, length = pack(payloads)
    times = np.ones(n, np.int64)
    return Messages(
        stream=np.zeros(n, np.int32),
        data=data,
        start=start,
        length=length,
        log_time=times,
        publish_time=times,
        sequence=times,
    )
