"""The REST interface: health and state of filters, read from snapshots."""

import time
from collections.abc import Awaitable, Callable, Mapping
from http import HTTPStatus
from importlib.metadata import version
from typing import Annotated, Any

from fastapi import FastAPI, HTTPException, Path, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException as StarletteHTTPException

from fuselog.service.live.member import Snapshot
from fuselog.service.rest.answers import (
    FiltersAnswer,
    HealthAnswer,
    Probe,
    Problem,
    StateAnswer,
    filter_answer,
    health_answer,
    state_answer,
)

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")

Look = Callable[[], Snapshot]
FilterId = Annotated[str, Path(pattern=r"^[A-Za-z0-9_.-]{1,64}$", description="as the configuration says: id")]


def create_app(
    filters: Mapping[str, Look],
    *,
    alive: Callable[[], bool],
    ready: Callable[[], bool],
    hosts: tuple[str, ...] | None = LOOPBACK,
) -> FastAPI:
    """The interface over ``filters``, each a function that gives its newest snapshot.

    ``alive``: the filter's thread turns. ``ready``: compiled and connected. Requests for other ``hosts`` than these
    are refused, so that no page of the web reads this through a name of its own; None allows all.
    """
    app = FastAPI(
        title="fuselog",
        version=version("fuselog"),
        docs_url=None,  # the pages would load scripts from the internet
        redoc_url=None,
        responses={400: _problem_of("Host not allowed"), 422: _problem_of("Parameter not valid")},
    )
    app.add_exception_handler(StarletteHTTPException, _http_problem)
    app.add_exception_handler(RequestValidationError, _validation_problem)
    _add_probes(app, alive, ready)
    _add_filters(app, filters)

    @app.middleware("http")
    async def only_for_hosts(request: Request, call_next: Callable[[Request], Awaitable[Response]]) -> Response:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        host = request.headers.get("host", "")
        if hosts is not None and _without_port(host) not in hosts:
            return _problem(400, f"this service does not answer for host {host!r}")
        return await call_next(request)

    return app


def _add_probes(app: FastAPI, alive: Callable[[], bool], ready: Callable[[], bool]) -> None:
    probes = (("live", alive, "the filter does not turn"), ("ready", ready, "not ready yet"))
    for name, passes, otherwise in probes:
        app.get(
            f"/health/{name}",
            response_model=Probe,
            responses={503: _problem_of("The probe fails")},
            tags=["health"],
            operation_id=name,
            summary=f"Whether the service is {name}",
        )(_probe(passes, otherwise))


def _probe(passes: Callable[[], bool], otherwise: str) -> Callable[[], Probe]:
    def probe() -> Probe:
        if not passes():
            raise HTTPException(503, otherwise)
        return Probe(status="ok")

    return probe


def _add_filters(app: FastAPI, filters: Mapping[str, Look]) -> None:
    def snapshot(name: str) -> Snapshot:
        if name not in filters:
            raise HTTPException(404, f"there is no filter {name!r}; there are {', '.join(filters)}")
        return filters[name]()

    missing: dict[int | str, dict[str, Any]] = {404: _problem_of("No such filter")}

    @app.get("/api/v1/filters", tags=["filters"], operation_id="filters")
    def list_filters() -> FiltersAnswer:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """All filters."""
        return FiltersAnswer(filters=[filter_answer(look()) for look in filters.values()])

    @app.get("/api/v1/filters/{id}/health", tags=["filters"], operation_id="health", responses=missing)
    def filter_health(id: FilterId) -> HealthAnswer:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """What is wrong with a filter, and why. A degraded filter is still alive and ready."""
        return health_answer(snapshot(id), now=time.monotonic())

    @app.get("/api/v1/filters/{id}/state", tags=["filters"], operation_id="state", responses=missing)
    def filter_state(id: FilterId) -> StateAnswer:  # pyright: ignore[reportUnusedFunction]  registered by its decorator
        """The newest estimate."""
        return state_answer(snapshot(id))


def _problem_of(description: str) -> dict[str, Any]:
    content = {"application/problem+json": {"schema": Problem.model_json_schema()}}
    return {"description": description, "content": content}


def _problem(status: int, detail: str, headers: Mapping[str, str] | None = None) -> JSONResponse:
    problem = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail)
    return JSONResponse(
        problem.model_dump(), status_code=status, media_type="application/problem+json", headers=headers
    )


def _http_problem(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, StarletteHTTPException)
    return _problem(error.status_code, str(error.detail), error.headers)


def _validation_problem(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    details = [f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors()]
    return _problem(422, "; ".join(details))


def _without_port(host: str) -> str:
    """``[::1]:8080`` is ``[::1]``, ``localhost:8080`` is ``localhost``."""
    if host.startswith("["):
        return host.partition("]")[0] + "]"
    return host.partition(":")[0].lower()
