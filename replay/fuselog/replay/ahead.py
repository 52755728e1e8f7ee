"""An iterator run in a thread of its own, some items ahead of who takes them."""

from collections import deque
from collections.abc import Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

_T = TypeVar("_T")


class _End:
    """Comes after the last item."""


_END = _End()


def ahead(items: Iterable[_T], depth: int) -> Generator[_T]:
    """The same items, or the exception that making one raised; at most ``depth`` are made and not taken."""
    source = iter(items)
    thread = ThreadPoolExecutor(1, "ahead")
    try:
        waiting: deque[Future[_T | _End]] = deque(thread.submit(next, source, _END) for _ in range(depth))
        while not isinstance(item := waiting.popleft().result(), _End):
            waiting.append(thread.submit(next, source, _END))
            yield item
    finally:
        thread.shutdown(cancel_futures=True)
