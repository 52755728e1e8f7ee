"""The REST interface over snapshots that the test makes: answers, problems, hosts, and its own description."""

import asyncio
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi import FastAPI

from fuselog.fusion import Filter, compile_plan, parse_config
from fuselog.fusion.health import Losses, assess, no_samples
from fuselog.fusion.report import estimate_json
from fuselog.service.live.member import Snapshot
from fuselog.service.rest.api import create_app

CONFIG = """\
fuselog: 1
id: robot-1
model: {name: constant_velocity}
initial: {state: {x: 0.1, y: 0.2, vx: 1.0000000000000002, vy: 3.0e-310}}
sensors:
  gps: {topic: /gps, fuse: [x, y], noise: {x: 1, y: 1}}
"""
ROBOT = "/api/v1/filters/robot-1"


@pytest.fixture(scope="module")
def snapshot() -> Snapshot:
    """A filter that has seen nothing."""
    plan = compile_plan(*parse_config(CONFIG))
    filter = Filter(plan, order="as_received")
    recent = no_samples(plan)
    return Snapshot(
        plan=plan,
        estimate=filter.estimate,
        ledger=filter.ledger,
        recent=recent,
        health=assess(plan, estimate=filter.estimate, ledger=filter.ledger, recent=recent, losses={}),
        changes=(),
        losses={},
        progress={},
        unpublished=0,
        last_arrival=None,
    )


@dataclass(frozen=True)
class Client:
    """Asks an application, without a network."""

    app: FastAPI

    def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        """One request, and its answer."""

        async def ask() -> httpx.Response:
            transport = httpx.ASGITransport(app=self.app)
            async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1:8080") as client:
                return await client.request(method, path, **options)

        return asyncio.run(ask())

    def get(self, path: str, **options: Any) -> httpx.Response:
        """GET."""
        return self.request("GET", path, **options)


@pytest.fixture
def client(snapshot: Snapshot) -> Callable[..., Client]:
    """A client of an interface that shows ``shown``."""

    def make(shown: Snapshot = snapshot, *, alive: bool = True, ready: bool = True) -> Client:
        return Client(create_app({"robot-1": lambda: shown}, alive=lambda: alive, ready=lambda: ready))

    return make


Make = Callable[..., Client]


def test_state_has_every_digit(client: Make, snapshot: Snapshot) -> None:
    """What Python reads back from the JSON is the same float, even a subnormal one."""
    answer = client().get(f"{ROBOT}/state")
    assert answer.status_code == 200
    assert answer.json() == json.loads(json.dumps(estimate_json(snapshot.plan, snapshot.estimate)))
    assert answer.json()["state"] == {"x": 0.1, "y": 0.2, "vx": 1.0000000000000002, "vy": 3.0e-310}
    assert answer.json()["t_ns"] is None


def test_a_filter_that_waits(client: Make) -> None:
    """Initializing is not degraded, and what was not examined is null."""
    health = client().get(f"{ROBOT}/health").json()
    assert health["status"] == "initializing"
    assert health["reasons"] == ["gps: no sample on /gps yet", "nothing has been fused yet"]
    assert (health["finite"], health["positive"], health["idle_s"]) == (True, True, None)
    gps = health["sensors"]["gps"]
    assert (gps["nis"], gps["age_s"], gps["period_s"], gps["last_stamp_ns"]) == (None, None, None, None)
    assert client().get("/api/v1/filters").json()["filters"][0] == {
        "id": "robot-1",
        "model": "constant_velocity",
        "states": ["x", "y", "vx", "vy"],
        "sensors": ["gps"],
        "status": "initializing",
    }


def test_a_broken_filter_still_answers(client: Make, snapshot: Snapshot) -> None:
    """A state that is not finite: null in JSON, diverged with the reason, alive and ready."""
    broken = replace(snapshot.estimate, t_ns=5, x=np.array([np.nan, np.inf, 0.0, 1.0]))
    plan, ledger, losses = snapshot.plan, snapshot.ledger, {"gps": Losses(1, 2, 3, "of no type")}
    health = assess(plan, estimate=broken, ledger=ledger, recent=snapshot.recent, losses=losses)
    lost = replace(snapshot, estimate=broken, unpublished=3, losses=losses, health=health)
    answers = client(lost)
    assert answers.get(f"{ROBOT}/state").json()["state"] == {"x": None, "y": None, "vx": 0.0, "vy": 1.0}
    health = answers.get(f"{ROBOT}/health").json()
    assert health["status"] == "diverged"
    assert health["reasons"] == [
        "3 results not published: subscribers are too slow",
        "the state is not finite",
        "the covariance is not positive semi-definite",
        "gps: 3 samples of unusable type: of no type",
        "gps: 1 samples shed: the filter cannot keep up",
        "gps: 2 samples missed on the way here",
    ]
    assert answers.get("/health/live").status_code == 200
    assert answers.get("/health/ready").status_code == 200


@pytest.mark.parametrize("probe", ["live", "ready"])
def test_probes(client: Make, probe: str) -> None:
    """200 when all is well, 503 with a problem else."""
    assert client().get(f"/health/{probe}").json() == {"status": "ok"}
    answer = client(alive=False, ready=False).get(f"/health/{probe}")
    assert answer.status_code == 503
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["title"] == "Service Unavailable"


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/api/v1/filters/other/health", 404),
        ("/api/v1/filters/other/state", 404),
        ("/api/v1/filters/a%20b/state", 422),
        (f"/api/v1/filters/{'x' * 65}/state", 422),
        ("/api/v1/filters//state", 404),
        ("/nothing", 404),
        ("/docs", 404),
        ("/redoc", 404),
    ],
)
def test_problems(client: Make, path: str, status: int) -> None:
    """Errors are RFC 9457 problems."""
    answer = client().get(path)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert problem["status"] == status
    assert problem["type"] == "about:blank"
    assert problem["detail"]


def test_nothing_can_be_changed(client: Make) -> None:
    """Reading only."""
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        answer = client().request(method, f"{ROBOT}/state")
        assert answer.status_code == 405
        assert answer.headers["allow"] == "GET"
        assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize(
    ("host", "status"),
    [("127.0.0.1:8080", 200), ("localhost", 200), ("[::1]:8080", 200), ("evil.example", 400), ("127.0.0.1.evil", 400)],
)
def test_hosts(client: Make, host: str, status: int) -> None:
    """A page of the web that resolves its own name to loopback gets nothing."""
    assert client().get("/api/v1/filters", headers={"host": host}).status_code == status


def test_openapi_describes_what_there_is(client: Make) -> None:
    """Every operation with its answers; the description needs nothing from outside."""
    description = client().get("/openapi.json").json()
    assert set(description["paths"]) == {
        "/health/live",
        "/health/ready",
        "/api/v1/filters",
        "/api/v1/filters/{id}/health",
        "/api/v1/filters/{id}/state",
    }
    state = description["paths"]["/api/v1/filters/{id}/state"]["get"]
    assert state["responses"]["200"]["content"]["application/json"]["schema"] == {
        "$ref": "#/components/schemas/StateAnswer"
    }
    assert set(state["responses"]) == {"200", "400", "404", "422"}
    assert "application/problem+json" in state["responses"]["422"]["content"]
