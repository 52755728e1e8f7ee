"""Whether the service lives, is ready, and has started: for who restarts it, by the conventions of Kubernetes."""

import asyncio
import math
import time
from collections.abc import Callable
from typing import Any

from fastapi import FastAPI

from fuselog.service.rest.answers import Probe
from fuselog.service.rest.problems import Refused, documented

STUCK_S = 10.0  # a heartbeat that is older is a failure of liveness


class Pulse:
    """The heartbeat of an event loop."""

    def __init__(self) -> None:
        self.at = math.inf  # monotonic s; of a loop that does not beat nothing is said

    async def beat(self) -> None:
        """Beat until cancelled."""
        while True:
            self.at = time.monotonic()
            await asyncio.sleep(1.0)

    @property
    def age_s(self) -> float:
        """Since it last beat."""
        return max(time.monotonic() - self.at, 0.0)


def add_probes(app: FastAPI, *, alive: Callable[[], bool], ready: Callable[[], bool], pulse: Pulse | None) -> None:
    """A filter that has diverged fails none of them: a restart would destroy the evidence."""
    started = False

    def check_alive() -> None:
        if not alive():
            raise Refused(503, "a filter does not turn")
        if pulse is not None and pulse.age_s > STUCK_S:
            raise Refused(503, f"the server stood still for {pulse.age_s:.0f} s")

    def check_ready() -> None:
        if not ready():
            raise Refused(503, "not ready yet, or ending")

    def check_started() -> None:
        nonlocal started
        started = started or ready()
        if not started:
            raise Refused(503, "still starting")

    _add(app, "/health/live", "live", "Whether the process turns; if not, restart it", check_alive)
    _add(app, "/healthz", "healthz", "The same as /health/live", check_alive)
    _add(app, "/health/ready", "ready", "Whether all is compiled and connected, and nothing is ending", check_ready)
    _add(app, "/health/startup", "startup", "Whether it has been ready once", check_started)


def _add(app: FastAPI, path: str, name: str, summary: str, check: Callable[[], None]) -> None:
    async def probe() -> Any:
        check()
        return Probe(status="ok")

    app.get(path, response_model=Probe, responses=documented(503), tags=["probes"], operation_id=name, summary=summary)(
        probe
    )
