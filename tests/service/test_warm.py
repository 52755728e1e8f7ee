"""Nothing is compiled after the warm-up: every kernel has all its signatures by then."""

import json
import subprocess
import sys

SCRIPT = """
import json, sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from fuselog.fusion import Filter, Outputs, Stream, compile_plan, parse_config
from fuselog.fusion.health import assess, no_samples, remember, seen
from fuselog.schemas import CdrEncoder, definition
from fuselog.service.batch import Batch
from fuselog.service.live.warm import warm_up

def signatures():
    modules = list(sys.modules.values())
    found = [v for m in modules for v in list(getattr(m, "__dict__", {}).values()) if isinstance(v, Dispatcher)]
    return sorted({f"{v.py_func.__module__}.{v.py_func.__name__} {s}" for v in found for s in v.signatures})

plan = compile_plan(*parse_config(\"\"\"
fuselog: 1
model: {name: unicycle}
sensors:
  odom: {topic: odom, fuse: [x, y, yaw, v], noise: {x: 1, y: 1, yaw: 1, v: 1}, gate: 0.99}
smooth: {lag: 0.5, rate: 2}
\"\"\"))
warm_up(plan)
before = signatures()
kind = "nav_msgs/msg/Odometry"
encoder = CdrEncoder(kind, definition(kind), columns=["pose.pose.orientation.w"])
times = [10**18 + k * 10**9 for k in range(4)]
payloads = [encoder.encode(np.array([t]), np.ones((1, 1)))[0].tobytes() for t in times]
filter = Filter(plan, order="as_received")
filter.intake.open(0, Stream(topic="odom", encoding="cdr", schema_name=kind, schema_encoding="ros2msg",
                             schema_text=definition(kind)))
track = filter.feed(Batch([0] * len(times), times, times, list(range(1, 1 + len(times))), payloads).messages())
beside = filter.beside()
Outputs(plan).encode(track, beside)
recent = remember(no_samples(plan), [seen(track)])
assess(plan, estimate=filter.estimate, ledger=filter.ledger, recent=recent, losses={})
new = sorted(set(signatures()) - set(before))
print(json.dumps({"fused": filter.ledger["odom"].fused, "smoothed": len(beside.smoothed), "new": new}))
"""


def test_warm_up_compiles_everything() -> None:
    """In a process of its own, so that no other test has warmed anything."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, timeout=300)
    assert json.loads(done.stdout) == {"fused": 4, "smoothed": 1, "new": []}
