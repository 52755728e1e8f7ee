"""The time at which things come, in an order that nobody who sets the clock can turn around."""

import time
from collections.abc import Callable


def ahead_ns() -> int:
    """How far the machine's clock is ahead of the monotonic one."""
    return time.time_ns() - time.monotonic_ns()


def never_back() -> Callable[[], int]:
    """A clock (ns) that shows the machine's time and, where that is set back, goes on from before at its own pace.

    Not for several threads at once.
    """
    ahead = ahead_ns()

    def now_ns() -> int:
        nonlocal ahead
        ahead = max(ahead, ahead_ns())  # too little if held up between, never too much
        return ahead + time.monotonic_ns()

    return now_ns
