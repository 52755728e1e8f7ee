"""A line of JSON for every attempt to change something: who, what, and how it ended."""

import json
import logging
import sys
import time
from datetime import UTC, datetime
from typing import Any

_LOG = logging.getLogger("fuselog.audit")
_MOST_BODY = 2048  # bytes of a body that are kept
_REFUSED_EVERY_S = 1.0  # of those who may not, most lines


class Audit:
    """Writes to the logger ``fuselog.audit``. What nobody known attempts can be much: most of that is only counted."""

    def __init__(self) -> None:
        self._unwritten = 0
        self._refused_at = -_REFUSED_EVERY_S

    def write(self, *, who: str | None, client: str, method: str, path: str, status: int, body: bytes) -> None:
        """One attempt. ``who``: the name of the token; ``path`` without its query."""
        line: dict[str, Any] = {
            "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "who": who,
            "client": client,
            "what": f"{method} {path[:256]}",
            "status": status,
            "result": "done" if status < 400 else "refused",
        }
        if who is None:
            now = time.monotonic()
            if now - self._refused_at < _REFUSED_EVERY_S:
                self._unwritten += 1
                return
            self._refused_at = now
        elif body:
            line["body"] = body[:_MOST_BODY].decode("utf-8", "replace")
        if self._unwritten:
            line["unwritten"], self._unwritten = self._unwritten, 0
        _LOG.info(json.dumps(line))


def audited() -> bool:
    """Whether the lines can be seen."""
    return bool(_LOG.handlers)


def audit_to_stderr() -> None:
    """Let the lines be seen."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("audit %(message)s"))
    _LOG.addHandler(handler)
    _LOG.setLevel(logging.INFO)
    _LOG.propagate = False
