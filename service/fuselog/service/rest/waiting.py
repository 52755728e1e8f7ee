"""Work that waits for a filter, on threads of its own: whatever hangs there, the event loop goes on."""

import asyncio
import threading
from collections.abc import Callable
from typing import TypeVar

from fuselog.service.rest.problems import Refused

_T = TypeVar("_T")
_MOST = 16  # at one time


class Waiting:
    """Runs what may wait. A thread whose work never ends keeps its place: after 16 such, nothing more is begun."""

    def __init__(self) -> None:
        self._begun = 0

    async def run(self, work: Callable[[], _T], *, within_s: float) -> _T:
        """What ``work`` returns or raises; ``Refused`` (503) when it takes longer, which does not end it."""
        if self._begun >= _MOST:
            raise Refused(503, "too much waits for the filter", headers={"Retry-After": "1"})
        loop = asyncio.get_running_loop()
        done: asyncio.Future[_T] = loop.create_future()
        self._begun += 1

        def end(settle: Callable[[], None]) -> None:
            self._begun -= 1
            if not done.done():
                settle()

        def go() -> None:
            try:
                result = work()
            except Exception as error:  # whatever it is, it belongs to the request
                _tell(loop, end, lambda error=error: done.set_exception(error))
            else:
                _tell(loop, end, lambda: done.set_result(result))

        threading.Thread(target=go, name="request", daemon=True).start()
        try:
            async with asyncio.timeout(within_s):
                return await done
        except TimeoutError:
            raise Refused(503, f"the filter did not answer within {within_s:g} s; it may still do this") from None


def _tell(
    loop: asyncio.AbstractEventLoop, end: Callable[[Callable[[], None]], None], settle: Callable[[], None]
) -> None:
    try:
        loop.call_soon_threadsafe(end, settle)
    except RuntimeError:
        return  # the server has ended meanwhile
