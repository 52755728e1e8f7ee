"""What filters receive and publish, recorded as their configuration wants; nothing of it can hold up a filter."""

import threading
import time
from collections.abc import Mapping
from functools import partial
from typing import Literal

import zenoh

from fuselog.fusion.config.settings import RecordSettings
from fuselog.replay.recording import Recording, RecordingError, RecordingStatus
from fuselog.schemas import LogError, Messages
from fuselog.service.recording.declared import describe
from fuselog.service.recording.record import options_of
from fuselog.service.recording.recorder import Recorder, Topics
from fuselog.service.recording.selection import Selection
from fuselog.service.streams import Hearsay

_RETRY_S = 10.0

Order = Literal["start", "stop", "snapshot"]


class FilterRecorder:
    """Records from construction to ``finish``. A recording that stops by itself is tried again every ten seconds.

    ``put`` and ``put_outputs`` never wait; the other methods belong to other threads than those of the filters.
    ``types`` are those of keys whose publishers do not tell.
    """

    def __init__(
        self, settings: RecordSettings, hearsay: Hearsay, types: Mapping[str, str], snapshot: threading.Event
    ) -> None:
        self._settings, self._snapshot = settings, snapshot
        self._describe = partial(describe, hearsay, types)
        self._lock = threading.Lock()  # of what starts and stops
        self._recorder: Recorder | None = None
        self._last: RecordingStatus = _nothing("")
        self._wanted, self._tried = True, 0.0
        self._start()

    @property
    def status(self) -> RecordingStatus:
        """The recording as it was a moment ago, or the last one."""
        recorder = self._recorder
        return self._last if recorder is None else recorder.status

    def put(self, sample: zenoh.Sample, let_in: bool) -> None:
        """Take what comes, and whether filters get it."""
        recorder = self._recorder
        if recorder is not None:
            recorder.put(0, sample, turned_away=not let_in)

    def put_outputs(self, topics: Topics, messages: Messages) -> None:
        """Take what a filter publishes."""
        recorder = self._recorder
        if recorder is not None:
            recorder.put_outputs(topics, messages)

    def command(self, order: Order) -> RecordingStatus:
        """Start, stop, or write a snapshot -> how it stands then; waits for the disk where it stops."""
        with self._lock:
            if order == "snapshot":
                self._snapshot.set()
            elif order == "stop":
                self._wanted = False
                self._stop()
            elif self.status.state != "recording":
                self._stop()
                self._start()
                self._wanted = True
        return self.status

    def tend(self) -> None:
        """Try again where it stopped by itself: the disk may have room now."""
        with self._lock:
            stopped = self._wanted and self.status.state == "stopped"
            if stopped and time.monotonic() - self._tried >= _RETRY_S:
                self._stop()
                self._start()

    def finish(self) -> None:
        """Write what has come, and close the file."""
        with self._lock:
            self._stop()

    def _start(self) -> None:
        self._tried = time.monotonic()
        try:
            recording = Recording(self._settings.path, options_of(self._settings, resume=True))
        except (RecordingError, LogError) as error:
            self._last = _nothing(str(error))
            return
        self._recorder = Recorder(recording, self._describe, selection=Selection(), snapshot=self._snapshot)

    def _stop(self) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            self._last = recorder.finish()


def _nothing(reason: str) -> RecordingStatus:
    return RecordingStatus(state="stopped", reason=reason, files=(), bytes=0, durable_until=None, accounts={})
