"""A filter on a Zenoh session: its subscriptions, its two threads, and its orderly end."""

import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import zenoh

from fuselog.fusion import Outputs, Plan
from fuselog.fusion.config import Problem
from fuselog.service.live.outbox import Outbox
from fuselog.service.live.runner import Runner, Snapshot
from fuselog.service.live.warm import warm_up
from fuselog.service.progress import answer_progress
from fuselog.service.recording.filter_recorder import FilterRecorder
from fuselog.service.streams import learn
from fuselog.service.threads import Worker, WorkerError
from fuselog.service.transport import TransportError, key_of
from fuselog.service.zenoh_door import subscribe

_PUBLISH_S = 10.0  # for what is left at the end
_STUCK_S = 10.0  # a turn of the filter that takes longer is a failure of liveness


class LiveFilter:
    """Compiles a plan and fuses what comes on its topics, from construction to ``finish``.

    ``ended`` is called when one of its threads is over, whatever the reason, but for that of the recording, which may
    fail without harm; ``snapshot``, when set, asks it for a snapshot. Raises ``ConfigError`` for topics that cannot be
    keys of Zenoh.
    """

    def __init__(
        self,
        plan: Plan,
        session: zenoh.Session,
        *,
        ended: Callable[[], None],
        snapshot: threading.Event | None = None,
    ) -> None:
        check_topics(plan)
        warm_up(plan)
        outputs = Outputs(plan)
        self._outbox = Outbox(session, outputs, source=secrets.token_bytes(16))
        self._runner = Runner(plan, self._outbox, learn=partial(learn, session))
        self._recorder: FilterRecorder | None = None
        if plan.config.record is not None:
            asked = snapshot or threading.Event()
            self._recorder = FilterRecorder(plan.config.record, plan, session, outputs, asked)
            self._outbox.record = self._recorder.put_outputs
        self._publishing = Worker("publisher", self._outbox.run, ended)
        self._fusing = Worker("filter", self._runner.run, ended)
        self._unsubscribe = [
            subscribe(session, key, partial(self._take, number)) for number, key in enumerate(self._runner.keys)
        ]
        # Last, for a player takes the answer as a sign that all subscriptions have been announced before.
        self._fall_silent = answer_progress(
            session, plan.config.id, self._runner.keys, lambda: self.snapshot().progress
        )

    def snapshot(self) -> Snapshot:
        """The filter as it was a moment ago."""
        now = self._runner.snapshot
        return now if self._recorder is None else replace(now, recording=self._recorder.status)

    @property
    def alive(self) -> bool:
        """Whether the filter turns and results leave; a filter that has diverged is alive."""
        turns = time.monotonic() - self._runner.heartbeat < _STUCK_S
        return turns and self._fusing.alive and self._publishing.alive

    def finish(self) -> None:
        """Take no more, fuse and publish what has come; raises ``WorkerError`` for a thread that failed."""
        self._fall_silent()
        for unsubscribe in self._unsubscribe:
            unsubscribe()
        self._runner.stop()
        while not self._fusing.join(1.0):
            pass
        self._outbox.finish()
        self._publishing.join(_PUBLISH_S)
        if self._recorder is not None:
            self._recorder.finish()
        for worker in (self._fusing, self._publishing):
            if worker.error is not None:
                raise WorkerError(worker) from worker.error

    def _take(self, number: int, sample: zenoh.Sample) -> None:
        """A sample of key ``number``, on the network thread; recorded first, for the filter may hold it up."""
        if self._recorder is not None:
            self._recorder.put(sample)
        self._runner.inbox.put(number, sample)


def check_topics(plan: Plan) -> None:
    """Raise ``ConfigError`` for every topic that cannot be a key of Zenoh."""
    places = {("sensors", sensor.name, "topic"): sensor.settings.topic for sensor in plan.sensors}
    problems: list[Problem] = []
    for place, topic in [*places.items(), (("output", "estimate"), plan.config.output.estimate)]:
        try:
            key_of(topic)
        except TransportError as error:
            problems.append(Problem(place, str(error)))
    if problems:
        raise plan.source.complain(problems)
