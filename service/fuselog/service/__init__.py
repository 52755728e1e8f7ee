"""Zenoh, FastAPI, threads and the command line."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fuselog.service.rest.app import create_app

__all__ = ["create_app"]


def __getattr__(name: str) -> Any:
    """``create_app``, imported when it is asked for, so that commands which serve nothing start fast."""
    if name != "create_app":
        raise AttributeError(name)
    from fuselog.service.rest.app import create_app  # noqa: PLC0415  see above

    return create_app
