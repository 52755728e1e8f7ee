"""The status page at ``/``: files out of the wheel, which load nothing from anywhere else."""

from collections.abc import Awaitable, Callable
from hashlib import sha256
from importlib.resources import files

from fastapi import FastAPI, Request, Response

_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_HEADERS = {
    # form-action and no inline anything: a token that is typed in can go nowhere but into the script
    "Content-Security-Policy": "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",  # kept, but asked for again each time: an update shows at the next load
}


def add_page(app: FastAPI) -> None:
    """Serve the page at ``/`` and its parts under ``/page/``; they hold no data, so no token is needed for them."""
    for name, content in assets().items():
        path = "/" if name == "index.html" else f"/page/{name}"
        app.router.add_route(path, _serve(content, _TYPES[name[name.rindex(".") :]]), include_in_schema=False)


def assets() -> dict[str, bytes]:
    """The files of the page by name."""
    return {
        entry.name: entry.read_bytes()
        for entry in files("fuselog.service.page").iterdir()
        if any(entry.name.endswith(suffix) for suffix in _TYPES)
    }


def _serve(content: bytes, media_type: str) -> Callable[[Request], Awaitable[Response]]:
    headers = {**_HEADERS, "ETag": f'"{sha256(content).hexdigest()[:32]}"'}

    async def serve(request: Request) -> Response:
        if headers["ETag"] in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)
        return Response(content, headers=headers, media_type=media_type)

    return serve
