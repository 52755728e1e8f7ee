"""A recording of what comes: whoever has something puts it aside, and one thread of its own writes it."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby
from typing import NamedTuple

import numpy as np
import zenoh
from numpy.typing import NDArray

from fuselog.fusion import Output
from fuselog.fusion.outputs import COMMAND
from fuselog.replay import Schema
from fuselog.replay.recording import Recording, RecordingStatus
from fuselog.schemas import Messages
from fuselog.service.live.sources import Progress
from fuselog.service.recording.declared import OUTPUT
from fuselog.service.recording.sampled import Describe, Sampled, SampledStreams
from fuselog.service.recording.selection import Selection
from fuselog.service.recording.spool import Arrived, Spool
from fuselog.service.threads import Worker

_GATHER_S = 0.02  # writing many messages at once costs little more than writing one
_TURN_S = 0.1
_PROGRESS_S = 1.5

Topics = tuple[Output, ...]


class Results(NamedTuple):
    """Messages of a filter, whose streams are numbered as ``topics``."""

    topics: Topics
    messages: Messages


Item = Sampled | Results


class Recorder:
    """Records from construction to ``finish``. No method but ``finish`` waits; what there is no room for is counted.

    ``snapshot``, when set, asks for a snapshot. ``ended`` is called when the thread is over, whatever the reason.
    ``capacity_bytes`` may wait in memory for the thread.
    """

    def __init__(
        self,
        recording: Recording,
        describe: Describe,
        *,
        selection: Selection,
        snapshot: threading.Event | None = None,
        ended: Callable[[], None] = lambda: None,
        capacity_bytes: int = 64 << 20,
    ) -> None:
        self._recording = recording
        self._streams = SampledStreams(recording, describe, selection)
        self._outputs: dict[Topics, NDArray[np.int32]] = {}  # the channels of a filter's results
        self._spool: Spool[Item] = Spool(capacity_bytes=capacity_bytes)
        self._dropped: Counter[tuple[int, str]] = Counter()  # by subscription and key; outputs are of none, -1
        self._lock = threading.Lock()
        self._snapshot = snapshot or threading.Event()
        self._finishing = False
        self._status = recording.status()
        self._progress: dict[str, dict[str, Progress]] = {}
        self._turns = 0
        self._turned = threading.Condition()
        self._worker = Worker("recorder", self._run, ended)

    @property
    def status(self) -> RecordingStatus:
        """The recording as it was a moment ago."""
        if self._worker.error is None:
            return self._status
        reason = f"{type(self._worker.error).__name__}: {self._worker.error}".splitlines()[0]
        return replace(self._status, state="stopped", reason=reason)

    def put(self, subscription: int, sample: zenoh.Sample, *, turned_away: bool = False) -> None:
        """Take a sample; called on the network thread. ``turned_away``: the service had no room for it."""
        if not self._spool.put(Sampled(subscription, sample, turned_away), len(sample.payload)):
            self._drop({(subscription, str(sample.key_expr)): 1})

    def put_outputs(self, topics: Topics, messages: Messages) -> None:
        """Take what ``Outputs.encode`` made of ``topics``; called on the thread of the filter."""
        if len(messages) and not self._spool.put(Results(topics, messages), len(messages.data)):
            counts = np.bincount(messages.stream).tolist()
            self._drop({(-1, output.topic): n for output, n in zip(topics, counts, strict=False)})

    def progress(self, source: str) -> tuple[list[str], dict[str, Progress]]:
        """The keys of a publisher (hexadecimal) that are recorded, and how far each is, after all that has come."""
        with self._turned:
            seen = self._turns + 2  # the turn under way may have begun before
            self._turned.wait_for(lambda: self._turns >= seen or not self._worker.alive, _PROGRESS_S)
        counts = self._progress.get(source, {})
        return list(counts), counts

    def finish(self) -> RecordingStatus:
        """Write what has come and close the files -> how it ended."""
        self._finishing = True
        while not self._worker.join(1.0):
            pass
        return self.status

    def _drop(self, counts: dict[tuple[int, str], int]) -> None:
        with self._lock:
            self._dropped.update(counts)

    def _run(self) -> None:
        try:
            while not self._turn():
                pass
        finally:  # whatever went wrong, what has come so far is a whole log
            self._recording.close()
            self._status = self._recording.status()

    def _turn(self) -> bool:
        """Write what has come -> whether that was all there will be."""
        finishing = self._finishing
        arrived = self._spool.take(0.0 if finishing else _TURN_S)
        self._account()
        for of_filter, several in groupby(arrived, lambda each: isinstance(each.item, Results)):
            self._write(list(several), of_filter=of_filter)
        if self._snapshot.is_set():
            self._snapshot.clear()
            self._recording.snapshot()
        self._recording.tick()
        with self._turned:
            self._status, self._progress = self._recording.status(), self._streams.progress()
            self._turns += 1
            self._turned.notify_all()
        if arrived and not finishing:
            time.sleep(_GATHER_S)
        return finishing and not arrived

    def _write(self, arrived: Sequence[Arrived[Item]], *, of_filter: bool) -> None:
        if of_filter:
            for results, arrival_ns in arrived:
                assert isinstance(results, Results)
                self._recording.write(self._numbered(results, arrival_ns))
        else:
            samples = [Arrived(item, arrival_ns) for item, arrival_ns in arrived if isinstance(item, Sampled)]
            self._recording.write(self._streams.messages(samples))

    def _numbered(self, results: Results, arrival_ns: int) -> Messages:
        """Results as messages of the recording's channels, by the time at which they were made.

        A command lies where it was given among the samples, for there a run of the log follows it.
        """
        topics, messages = results
        if topics not in self._outputs:
            self._outputs[topics] = np.array([_declare(self._recording, output) for output in topics], np.int32)
        commands = np.array([output.schema_name == COMMAND for output in topics])
        return replace(
            messages,
            stream=self._outputs[topics][messages.stream],
            log_time=np.where(commands[messages.stream], messages.publish_time, arrival_ns),
        )

    def _account(self) -> None:
        with self._lock:
            dropped, self._dropped = self._dropped, Counter[tuple[int, str]]()
        for (subscription, key), count in dropped.items():
            if subscription < 0:
                self._recording.drop(key, "queue", count)
            else:
                self._streams.drop(subscription, key, count)


def _declare(recording: Recording, output: Output) -> int:
    schema = Schema(output.schema_name, "ros2msg", output.schema_text.encode())
    number = recording.add_channel(output.topic, schema, metadata=OUTPUT)
    assert number is not None  # nothing was declared before
    return number
