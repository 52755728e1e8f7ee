"""Errors as RFC 9457 problems: what refuses a request, how it is answered, and how it is documented."""

from collections.abc import Iterable, Mapping, Sequence
from http import HTTPStatus
from typing import Any

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.routing import Match

from fuselog.schemas import ConfigError

PROBLEM_TYPE = "application/problem+json"
_MEANS = {
    400: "The request cannot be read, or is for another host",
    401: "The token is missing or wrong",
    403: "The token's role does not allow this, or there is no token that could",
    404: "There is no such thing",
    408: "The request came too slowly",
    409: "The filter cannot do this as it is",
    413: "The body is larger than 1 MiB",
    415: "The body is no application/json",
    422: "A parameter or the body is not valid",
    431: "The headers are larger than 16 KiB",
    500: "A defect of the service",
    503: "Too much is asked at once, or the filter does not answer in time",
}


class Wrong(BaseModel):
    """One thing that is wrong with a request."""

    place: str = Field(description="in the request, or file:line:column of the configuration")
    detail: str


class Problem(BaseModel):
    """RFC 9457."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    errors: list[Wrong] = Field(
        default_factory=list[Wrong], description="each thing that is wrong, where there are several"
    )


class Refused(HTTPException):
    """A request that is not followed, and why."""

    def __init__(
        self, status: int, detail: str, errors: Iterable[Wrong] = (), headers: Mapping[str, str] | None = None
    ) -> None:
        super().__init__(status, detail, headers)
        self.errors = tuple(errors)


def problem(
    status: int, detail: str, errors: Sequence[Wrong] = (), headers: Mapping[str, str] | None = None
) -> JSONResponse:
    """The answer to a request that failed."""
    content = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail, errors=list(errors))
    return JSONResponse(
        content.model_dump(exclude=None if errors else {"errors"}),
        status_code=status,
        media_type=PROBLEM_TYPE,
        headers=headers,
    )


def documented(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """These statuses, as an OpenAPI document describes them."""
    content = {PROBLEM_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {status: {"description": _MEANS[status], "content": content} for status in statuses}


def not_valid(error: ConfigError) -> Refused:
    """A configuration that is not right, with the place of each problem."""
    parts = [line.partition(": ") for line in error.problems]
    errors = [Wrong(place=place, detail=reason) for place, _, reason in parts]
    return Refused(422, "the configuration would not be right", errors)


def answer_http(request: Request, error: Exception) -> JSONResponse:
    """A refusal, or what the router says; of a method that is not allowed, all that are."""
    assert isinstance(error, HTTPException)
    if error.status_code != HTTPStatus.METHOD_NOT_ALLOWED:
        errors = error.errors if isinstance(error, Refused) else ()
        return problem(error.status_code, error.detail, errors, error.headers)
    routes = [route for route in request.app.routes if route.matches(request.scope)[0] is not Match.NONE]
    allowed = sorted({method for route in routes for method in (getattr(route, "methods", None) or ())})
    return problem(405, f"{request.method} is not for this path", headers={"Allow": ", ".join(allowed)})


def answer_validation(_: Request, error: Exception) -> JSONResponse:
    """What is wrong with the parameters or the body; their values are not repeated."""
    assert isinstance(error, RequestValidationError)
    errors = [Wrong(place=".".join(map(str, each["loc"])), detail=each["msg"]) for each in error.errors()]
    return problem(422, "; ".join(f"{each.place}: {each.detail}" for each in errors[:5]), errors)


def answer_defect(_: Request, __: Exception) -> JSONResponse:
    """A defect, without what it was: that is in the log of the service."""
    return problem(500, "a defect of the service; its log says more")
