"""The REST interface of the live service: an application over the filters that are served."""

from collections.abc import Callable, Collection
from importlib.metadata import version
from typing import Any

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException

from fuselog.service.rest.auth import Access
from fuselog.service.rest.control import add_control
from fuselog.service.rest.filters import add_filters
from fuselog.service.rest.guard import LOOPBACK, OPEN, Guard
from fuselog.service.rest.metrics import FilterMetrics, add_metrics
from fuselog.service.rest.players import add_players
from fuselog.service.rest.probes import Pulse, add_probes
from fuselog.service.rest.problems import Problem, answer_defect, answer_http, answer_validation, documented
from fuselog.service.rest.recent import Recent
from fuselog.service.rest.served import Served
from fuselog.service.rest.shown import Shown
from fuselog.service.rest.stream import Streams, add_stream
from fuselog.service.rest.traffic import Traffic
from fuselog.service.rest.waiting import Waiting

_EVERYWHERE = documented(400, 401, 403, 422, 431, 500, 503)


def create_app(
    served: Served,
    *,
    alive: Callable[[], bool],
    ready: Callable[[], bool],
    access: Access | None = None,
    hosts: Collection[str] | None = LOOPBACK,
    streams: int = 64,
    page: Callable[[FastAPI], None] | None = None,
    current: Callable[[], bool] = lambda: True,
    process: int | None = None,
) -> FastAPI:
    """The interface over ``served``.

    ``alive``: the threads of the filters turn. ``ready``: compiled and connected. ``access``: who may do what; by
    default everybody may read and nobody change. Requests for other ``hosts`` than these are refused, so that no page
    of the web reads this through a name of its own; None allows all. ``streams``: most clients of the stream.
    ``page`` adds what is shown at ``/``. ``current``: ``served`` is of now; the stream is silent while it is not.
    ``process``: whose figures are among the metrics, by default this one's.
    """
    traffic, shown, waiting = Traffic(), Shown(served), Waiting()
    app = FastAPI(
        title="fuselog",
        version=version("fuselog"),
        docs_url=None,  # the pages would load scripts from the internet
        redoc_url=None,
        responses=_EVERYWHERE,
    )
    app.add_exception_handler(HTTPException, answer_http)
    app.add_exception_handler(RequestValidationError, answer_validation)
    app.add_exception_handler(Exception, answer_defect)
    app.state.traffic, app.state.pulse = traffic, Pulse()
    app.state.streams = Streams(shown, traffic, current=current, most=streams)
    add_probes(app, alive=alive, ready=ready, pulse=app.state.pulse)
    add_filters(app, shown, waiting)
    add_control(app, shown, waiting)
    add_players(app, served, waiting)
    add_stream(app, app.state.streams)
    add_metrics(app, [FilterMetrics(shown, traffic)], process)
    if page is not None:
        page(app)
    app.add_middleware(Recent)
    app.add_middleware(Guard, access=access or Access(), hosts=hosts, traffic=traffic)
    _describe(app)
    return app


def _describe(app: FastAPI) -> None:
    """Tokens and problems in the OpenAPI document, which FastAPI does not see: the guard and the handlers do them."""
    plain = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = plain()
            components = document.setdefault("components", {})
            components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
            components.setdefault("schemas", {}).update(_schemas())
            for path, operations in document["paths"].items():
                for operation in operations.values():
                    operation["security"] = [] if path in OPEN else [{"token": []}]
            app.openapi_schema = document
        return app.openapi_schema

    app.openapi = openapi


def _schemas() -> dict[str, Any]:
    schema = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    return {**schema.pop("$defs"), "Problem": schema}
