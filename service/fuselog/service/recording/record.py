"""Zenoh recorded into a log, from the first subscription to an orderly end."""

import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import zenoh

from fuselog.fusion.config.settings import RecordSettings
from fuselog.replay.recording import Account, Recording, RecordingStatus, RecordOptions
from fuselog.service.progress import tell_progress
from fuselog.service.recording.declared import describe
from fuselog.service.recording.recorder import Recorder
from fuselog.service.recording.selection import Selection
from fuselog.service.streams import Hearsay
from fuselog.service.zenoh_door import subscribe

_LOOK_S = 0.1
_REPORT_S = 1.0


def options_of(settings: RecordSettings, *, resume: bool = False) -> RecordOptions:
    """What the configuration says of a recording; times in ns."""
    return RecordOptions(
        compression=settings.compression,
        durability=settings.durability,
        max_bytes=settings.max_size,
        max_ns=_ns(settings.max_duration),
        snapshot_ns=_ns(settings.snapshot),
        snapshot_bytes=settings.snapshot_memory,
        latched=tuple(settings.latched),
        resume=resume,
    )


def record(
    session: zenoh.Session,
    recording: Recording,
    selection: Selection,
    *,
    types: Mapping[str, str],
    stop: threading.Event,
    snapshot: threading.Event,
    duration_s: float | None,
    report: Callable[[RecordingStatus], None],
) -> RecordingStatus:
    """Record until ``stop`` is set, ``duration_s`` is over, or the disk takes no more -> how it ended.

    ``types``: by key, of those that do not tell. ``report`` is called every second. A disk that is full at a snapshot
    ends nothing.
    """
    recorder = Recorder(
        recording, partial(describe, Hearsay(session), types), selection=selection, snapshot=snapshot, ended=stop.set
    )
    unsubscribe = [subscribe(session, key, partial(recorder.put, number)) for number, key in enumerate(selection.keys)]
    # A player waits for the answer before it leaves, and the network keeps the order: nothing is under way then.
    unsubscribe.append(tell_progress(session, f"recorder-{session.zid()}", recorder.progress))
    started = reported = time.monotonic()
    while not stop.wait(_LOOK_S) and (duration_s is None or time.monotonic() - started < duration_s):
        status = recorder.status
        if status.state == "stopped" and not recording.on_demand:
            break
        if time.monotonic() - reported >= _REPORT_S:
            reported = time.monotonic()
            report(status)
    for end in unsubscribe:
        end()
    return recorder.finish()


def status_json(status: RecordingStatus) -> dict[str, Any]:
    """A status as plain data."""
    return {
        "state": status.state,
        "reason": status.reason,
        "files": list(status.files),
        "bytes": status.bytes,
        "durable_until": status.durable_until,
        **_account_json(status.total),
        "topics": {topic: _account_json(account) for topic, account in status.accounts.items()},
    }


def _account_json(account: Account) -> dict[str, Any]:
    return {
        "received": account.received,
        "written": account.written,
        "waiting": account.waiting,
        "expired": account.expired,
        "dropped": {"queue": account.queue, "disk": account.disk, "limit": account.limit},
        "missed": account.missed,
    }


def _ns(seconds: float | None) -> int | None:
    return None if seconds is None else round(seconds * 1e9)
