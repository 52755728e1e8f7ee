"""A service whose filters are real ones, run over a log: what they showed is streamed, step by step."""

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fastapi import Request, Response
from fastapi.responses import JSONResponse, StreamingResponse
from fuselog.service.rest.api import create_app

from fuselog.fusion import Filter, Plan, compile_plan, parse_config
from fuselog.fusion.health import Losses, Recent, no_samples, remember
from fuselog.replay import open_log
from fuselog.replay.reprocess import open_inputs
from fuselog.service.live.runner import Snapshot
from fuselog.service.page.page import add_page
from fuselog.service.rest.answers import health_answer, state_answer
from fuselog.service.rest.http import HttpServer, bind

Frames = list[Snapshot]


def frames_of(config: str, log: Path, *, blind: tuple[str, float] | None = None, step_s: float = 0.5) -> Frames:
    """What a filter shows before a log and after each step; ``blind``: a topic, and when it falls silent (s)."""
    plan = compile_plan(*parse_config(config))
    filter, recent = Filter(plan, order="as_received"), no_samples(plan)
    frames = [_snapshot(plan, filter, recent)]
    with open_log(log) as opened:
        topics = open_inputs(opened, filter)
        first = opened.time_range[0]
        silent = {c.id for c in opened.channels.values() if blind is not None and c.topic == blind[0]}
        for messages in opened.batches(topics):
            elapsed = (messages.log_time - first) / 1e9
            for n in range(int(elapsed[0] / step_s), int(elapsed[-1] / step_s) + 1):
                now = (elapsed >= n * step_s) & (elapsed < (n + 1) * step_s)
                if blind is not None and n * step_s >= blind[1]:
                    now &= [stream not in silent for stream in messages.stream]
                recent = remember(recent, filter.feed(messages.take(now.nonzero()[0])))
                frames.append(_snapshot(plan, filter, recent))
    return frames


def _snapshot(plan: Plan, filter: Filter, recent: Recent) -> Snapshot:
    return Snapshot(
        plan=plan,
        estimate=filter.estimate,
        ledger=filter.ledger,
        recent=recent,
        optimality_ratio=filter.optimality_ratio,
        losses={},
        progress={},
        unpublished=0,
        last_arrival=time.monotonic(),
    )


@dataclass
class StatusService:
    """Serves the page, the interface and the stream on a port of its own while it is entered.

    ``filters``: frames by id. ``token``: who has none is refused. ``cut`` and ``hold`` are set to end streams, and to
    let them fall silent.
    """

    filters: Mapping[str, Frames]
    token: str | None = None
    every_s: float = 0.1
    cut: threading.Event = field(default_factory=threading.Event)
    hold: threading.Event = field(default_factory=threading.Event)
    url: str = ""

    def __enter__(self) -> "StatusService":
        looks = {id: (lambda frames=frames: frames[-1]) for id, frames in self.filters.items()}
        app = create_app(looks, alive=lambda: True, ready=lambda: True)
        add_page(app)
        app.router.add_route("/api/v1/stream", self._stream)
        self._listener = bind("127.0.0.1", 0)
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self._server = HttpServer(app, self._listener)
        self._thread = threading.Thread(target=self._server.run)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.cut.set()
        self._server.stop()
        self._thread.join(20)
        self._listener.close()

    async def _stream(self, request: Request) -> Response:
        if self.token is not None and request.headers.get("authorization") != f"Bearer {self.token}":
            problem = {"title": "Unauthorized", "status": 401, "detail": "no such token"}
            return JSONResponse(problem, 401, media_type="application/problem+json")
        return StreamingResponse(self._events(), media_type="text/event-stream")

    async def _events(self) -> AsyncIterator[str]:
        longest = max(map(len, self.filters.values()))
        changes: dict[str, list[dict[str, Any]]] = {name: [] for name in self.filters}
        before: dict[str, str] = {}
        n = 0
        while not self.cut.is_set():
            if not self.hold.is_set():
                shown = {name: frames[min(n, len(frames) - 1)] for name, frames in self.filters.items()}
                answers = {id(snapshot): _told(snapshot) for snapshot in shown.values()}  # many show the same one
                told = {name: dict(answers[id(snapshot)]) for name, snapshot in shown.items()}
                for name, one in told.items():
                    health, was = one["health"], before.get(name)
                    if was not in (None, health["status"]):
                        why = health["reasons"][0] if health["reasons"] else ""
                        change = {"t_ns": health["t_ns"], "from": was, "to": health["status"], "reason": why}
                        changes[name].append(change)
                    before[name] = health["status"]
                    one["changes"] = changes[name]
                yield f"event: health\r\ndata: {json.dumps({'t': time.time(), 'filters': told})}\r\n\r\n"
                n += 1
            await asyncio.sleep(self.every_s if n < longest else 0.5)


def _told(snapshot: Snapshot) -> dict[str, Any]:
    return {
        "model": snapshot.plan.card.name,
        "states": list(snapshot.plan.states),
        "health": health_answer(snapshot, now=time.monotonic()).model_dump(mode="json"),
        "state": state_answer(snapshot).model_dump(mode="json"),
    }


def with_losses(frames: Frames, losses: dict[str, Losses]) -> Frames:
    """The same with samples lost before the filter."""
    return [replace(frame, losses=losses) for frame in frames]
