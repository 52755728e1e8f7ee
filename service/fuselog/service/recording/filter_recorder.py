"""What a filter receives and publishes, recorded as its configuration wants; nothing of it can hold up the filter."""

import threading
from functools import partial

import zenoh

from fuselog.fusion import Outputs, Plan
from fuselog.fusion.config.settings import RecordSettings
from fuselog.replay.recording import Recording, RecordingError, RecordingStatus
from fuselog.schemas import LogError, Messages
from fuselog.service.recording.declared import describe
from fuselog.service.recording.record import options_of
from fuselog.service.recording.recorder import Recorder
from fuselog.service.recording.selection import Selection
from fuselog.service.streams import stream_types


class FilterRecorder:
    """Records from construction to ``finish``. A recording that cannot begin is "stopped" from the start."""

    def __init__(
        self, settings: RecordSettings, plan: Plan, session: zenoh.Session, outputs: Outputs, snapshot: threading.Event
    ) -> None:
        types = stream_types({sensor.settings.topic: sensor.settings.type for sensor in plan.sensors})
        self._recorder: Recorder | None = None
        try:
            recording = Recording(settings.path, options_of(settings, resume=True))
        except (RecordingError, LogError) as error:
            self._failed = RecordingStatus(
                state="stopped", reason=str(error), files=(), bytes=0, durable_until=None, accounts={}
            )
            return
        self._recorder = Recorder(
            recording,
            partial(describe, session, types),
            selection=Selection(),
            outputs=outputs.topics,
            snapshot=snapshot,
        )

    @property
    def status(self) -> RecordingStatus:
        """The recording as it was a moment ago."""
        return self._failed if self._recorder is None else self._recorder.status

    def put(self, sample: zenoh.Sample) -> None:
        """Take what the filter receives."""
        if self._recorder is not None:
            self._recorder.put(0, sample)

    def put_outputs(self, messages: Messages) -> None:
        """Take what the filter publishes."""
        if self._recorder is not None:
            self._recorder.put_outputs(messages)

    def finish(self) -> None:
        """Write what has come, and close the file."""
        if self._recorder is not None:
            self._recorder.finish()
