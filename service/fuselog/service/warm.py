"""Everything compiled before the first sample comes."""

import numpy as np

from fuselog.fusion import Filter, Outputs, Plan
from fuselog.schemas import Messages


def warm_up(plan: Plan) -> None:
    """Compile the kernels of a plan, or load them from the cache: no sample and no result waits for it later."""
    integers = np.empty(0, np.int64)
    nothing = Messages(
        stream=np.empty(0, np.int32),
        data=np.empty(0, np.uint8),
        start=integers,
        length=integers,
        log_time=integers,
        publish_time=integers,
        sequence=integers,
    )
    track = Filter(plan, order="as_received").feed(nothing)
    Outputs(plan).encode(track)
