"""What requests may say in their paths and queries, and how answers are written."""

import re
from datetime import datetime
from typing import Annotated, Any

import orjson
from fastapi import Path, Query, Request, Response

from fuselog.service.rest.problems import Refused
from fuselog.service.rest.shown import mark_of

_LEAST_NS, _MOST_NS = 0, 2**63 - 1
_RFC3339 = re.compile(r"(\d{4}-\d\d-\d\d)[Tt ](\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?([Zz]|[+-]\d\d:\d\d)")
_TIME = r"^([0-9]{1,19}|[0-9]{4}-[0-9]{2}-[0-9]{2}[Tt ][0-9:]{8}(\.[0-9]{1,9})?([Zz]|[+-][0-9]{2}:[0-9]{2}))$"

_NAME = r"^[^/\\\x00-\x1f\x7f]{1,128}$"
FilterId = Annotated[str, Path(pattern=_NAME, description="as the list of filters says")]
SensorName = Annotated[str, Path(pattern=_NAME, description="as the configuration calls it")]
Sequence = Annotated[int, Path(ge=0, le=_MOST_NS, description="of the sample, as the list of decisions says")]
Time = Annotated[str | None, Query(pattern=_TIME, max_length=40, description="ns since 1970, or RFC 3339")]
Before = Annotated[
    str | None,
    Query(pattern=r"^[0-9]{1,19}-[0-9]{1,6}-[0-9]{1,15}$", description="what `next` of the page before says"),
]


def time_ns(text: str) -> int:
    """A time as ns since 1970; raises ``Refused`` (422)."""
    if text.isdigit():
        ns = int(text)
    elif match := _RFC3339.fullmatch(text):
        day, clock, fraction, zone = match.groups()
        try:
            whole = datetime.fromisoformat(f"{day}T{clock}{zone.upper().replace('Z', '+00:00')}")
            ns = round(whole.timestamp()) * 10**9 + int((fraction or "0").ljust(9, "0"))
        except (ValueError, OverflowError):
            raise Refused(422, f"not a time: {text}") from None
    else:
        raise Refused(422, f"not a time: {text}")
    if not _LEAST_NS <= ns <= _MOST_NS:
        raise Refused(422, f"not a time since 1970 in 64 bits: {text}")
    return ns


def answer(value: dict[str, Any]) -> Response:
    """JSON."""
    return Response(orjson.dumps(value), media_type="application/json")


def answer_unless_known(request: Request, value: dict[str, Any], mark: str | None = None) -> Response:
    """JSON with a weak ETag, or 304 for who has it. ``mark`` in place of one of all that is said."""
    content = orjson.dumps(value)
    tag = f'W/"{mark or mark_of(content)}"'
    asked = request.headers.get("if-none-match", "")
    if asked.strip() == "*" or tag.removeprefix("W/") in (each.strip().removeprefix("W/") for each in asked.split(",")):
        return Response(status_code=304, headers={"ETag": tag})
    return Response(content, media_type="application/json", headers={"ETag": tag})
