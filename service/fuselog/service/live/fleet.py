"""The filters of a service on a Zenoh session: subscriptions, threads, recordings, and their orderly end."""

import re
import secrets
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal, TypeVar

import zenoh

from fuselog.fusion import Estimate, load_plan
from fuselog.fusion.captures import ByPattern, Captures
from fuselog.fusion.commands import Command, CommandError, Configure
from fuselog.fusion.intake import TF_STATIC
from fuselog.replay.recording import RecordingStatus
from fuselog.service.live.checkpoints import read_checkpoint, remove_checkpoint, write_checkpoint
from fuselog.service.live.group import Group, Subscription, make_group
from fuselog.service.live.inbox import Inbox
from fuselog.service.live.member import Member, Snapshot
from fuselog.service.live.outbox import Outbox, Post
from fuselog.service.live.ownership import Claim
from fuselog.service.live.runner import Runner, Unknown
from fuselog.service.live.sources import Progress
from fuselog.service.live.warm import warm_up, warm_up_for
from fuselog.service.progress import tell_progress
from fuselog.service.recording.filter_recorder import FilterRecorder
from fuselog.service.ros_keys import announce_node
from fuselog.service.streams import Announcements, Hearsay, stream_types
from fuselog.service.threads import Worker, WorkerError
from fuselog.service.zenoh_door import subscribe, subscribe_reliably

_PUBLISH_S = 10.0  # for what is left at the end
_STUCK_S = 10.0  # a turn of the filters that takes longer is a failure of liveness
_ANSWER_S = 2.0  # for a question to a filter
_PROGRESS_S = 1.5

T = TypeVar("T")


class Fleet:
    """Compiles the plans and fuses what comes on their topics, from construction to ``finish``.

    Raises ``TransportError`` where another service publishes the same estimates.

    ``ended`` is called when one of its threads is over, whatever the reason, but for those of recordings, which may
    fail without harm; ``snapshot``, when set, asks them for a snapshot; ``shown`` is called when filters are shown
    anew.
    """

    def __init__(
        self,
        groups: Sequence[Group],
        session: zenoh.Session,
        *,
        ended: Callable[[], None],
        snapshot: threading.Event | None = None,
        shown: Callable[[], None] = lambda: None,
    ) -> None:
        self._claim = Claim(session, [group.plan.config.output.estimate for group in groups])
        for group in groups:
            warm_up(group.plan)
        self._claim.hold()
        self.session, self._groups = session, groups
        self._post, self._told = Post(), Announcements(session, outputs=True)
        domains = {group.ros_domain for group in groups}
        self._leave = [announce_node(session, domain=domain) for domain in domains if domain is not None]
        self._source = secrets.token_bytes(16)
        self._saved_at: dict[Group, float] = {}
        self._unsaved: dict[str, str] = {}  # filters whose last checkpoint could not be written, and why
        self._hearsay, asked = Hearsay(session), snapshot or threading.Event()
        self._recorders = {group: recorder for group in groups if (recorder := _recorder(group, self._hearsay, asked))}
        self._runner = Runner(groups, Inbox(), self._make, flush=self._post.flush, shown=shown)
        self._publishing = Worker("publisher", self._post.run, ended)
        self._fusing = Worker("filter", self._runner.run, ended)
        self._unsubscribe = [self._subscribe(number, each) for number, each in enumerate(self._runner.subscriptions)]
        # Last, for a player takes the answer as a sign that all subscriptions have been announced before.
        self._fall_silent = [
            tell_progress(session, _plain(group.plan.config.id), partial(self._progress, group)) for group in groups
        ]

    @property
    def alive(self) -> bool:
        """Whether the filters turn and results leave; a filter that has diverged is alive."""
        turns = time.monotonic() - self._runner.heartbeat < _STUCK_S
        return turns and self._fusing.alive and self._publishing.alive

    @property
    def unknown(self) -> Unknown:
        """Samples that belong to no filter."""
        return self._runner.unknown

    def snapshots(self) -> Mapping[str, Snapshot]:
        """The filters as they were a moment ago."""
        return {id: self._with_files(id, snapshot) for id, snapshot in self._runner.snapshots.items()}

    def ended(self) -> Mapping[str, Snapshot]:
        """The last snapshot of filters that expired, or that ``finish`` ended."""
        return self._runner.ended

    def estimate_at(self, id: str, t_ns: int) -> Estimate:
        """As ``Served``."""
        return self._answer(id, lambda member: member.filter.estimate_at(t_ns))

    def command(self, id: str, command: Command) -> None:
        """As ``Served``."""
        asked_ns = time.time_ns()
        self._answer(id, lambda member: member.command(command, asked_ns))

    def reload(self) -> list[str]:
        """As ``Served``."""
        fresh = [(group, make_group(load_plan(group.plan.source.name))) for group in self._groups]
        for group, new in fresh:
            if new.patterns != group.patterns or new.plan.config.id != group.plan.config.id:
                raise CommandError(f"{group.plan.source.name}: id or topics are others; restart the service for that")
        done: list[str] = []
        for group, new in fresh:
            if new.plan.source.text == group.plan.source.text:
                continue
            warm_up_for(new.plan, group.plan)
            for id in [id for id in self._runner.snapshots if self._runner.group_of(id) is group]:
                self.command(id, Configure(new.plan.source.text))
                done.append(f"{id} goes on with {group.plan.source.name} as it is now")
            group.plan = new.plan
        return done

    def record(self, id: str, what: Literal["start", "stop", "snapshot"]) -> RecordingStatus:
        """As ``Served``."""
        if id not in self._runner.snapshots:
            raise KeyError(id)
        recorder = self._recorder_of(id)
        if recorder is None:
            raise CommandError("the configuration has no section record")
        return recorder.command(what)

    def tend(self) -> None:
        """What is to be done now and then, and may wait for a disk; called on a thread that may."""
        for recorder in self._recorders.values():
            recorder.tend()
        self._save_some()
        self._forget_expired()

    def finish(self) -> None:
        """Take no more, fuse and publish what has come; raises ``WorkerError`` for a thread that failed."""
        for silence in self._fall_silent:
            silence()
        for unsubscribe in self._unsubscribe:
            unsubscribe()
        self._runner.stop()
        while not self._fusing.join(1.0):
            pass
        for group, id, data in self._runner.last_checkpoints:
            self._save(group, id, data)
        self._post.finish()
        self._publishing.join(_PUBLISH_S)
        self._claim.end()
        for leave in self._leave:
            leave()
        for recorder in self._recorders.values():
            recorder.finish()
        for worker in (self._fusing, self._publishing):
            if worker.error is not None:
                raise WorkerError(worker) from worker.error

    def _make(self, group: Group, captures: Captures) -> Member:
        """A filter of a group, and what it publishes with; called on the thread of the filters."""
        plan = group.plan_of(captures)
        outbox = Outbox(self.session, self._post, self._told, plan, source=self._source)
        recorder = self._recorders.get(group)
        if recorder is not None:
            outbox.record = partial(recorder.put_outputs, outbox.topics)
        member = Member(group, captures, plan, outbox, learn=self._hearsay.learn)
        saved = _saved(group, member.id)
        if saved is not None:
            member.resume(saved)
        return member

    def _save_some(self) -> None:
        """Put aside the filters whose time it is."""
        due = {group for group in self._groups if _is_due(group, self._saved_at.get(group))}
        if not due:
            return

        def look(members: Sequence[Member]) -> list[tuple[Group, str, bytes]]:
            return [(member.group, member.id, member.checkpoint()) for member in members if member.group in due]

        with suppress(TimeoutError):
            for group, id, data in self._runner.ask_all(look).result(_ANSWER_S):
                self._save(group, id, data)
            self._saved_at |= dict.fromkeys(due, time.monotonic())

    def _forget_expired(self) -> None:
        """A filter that expired begins anew when its topics come back, and its file does not stay for ever."""
        for id, snapshot in self._runner.ended.items():
            if snapshot.plan.config.checkpoint is not None and id not in self._runner.snapshots:
                remove_checkpoint(Path(snapshot.plan.config.checkpoint.folder), id)
                self._unsaved.pop(id, None)

    def _save(self, group: Group, id: str, data: bytes) -> None:
        settings = group.plan.config.checkpoint
        assert settings is not None
        try:
            write_checkpoint(Path(settings.folder), id, data)
            self._unsaved.pop(id, None)
        except OSError as error:  # the filters go on
            self._unsaved[id] = error.strerror or str(error)

    def _subscribe(self, number: int, to: Subscription) -> Callable[[], None]:
        group, topic = to.group, to.pattern.topic
        recorder, take = self._recorders.get(group), partial(self._runner.inbox.put, number)
        if recorder is not None:
            take = partial(take, record=recorder.put)
        topics = {sensor.settings.topic: sensor.settings for sensor in group.plan.sensors}
        latched = to.domain is not None and topic == TF_STATIC  # of ROS 2, which keeps it for who comes later
        if latched or (topic in topics and topics[topic].reliable):
            missed = partial(self._miss, number)
            return subscribe_reliably(self.session, to.expression, take, missed=missed)
        return subscribe(self.session, to.expression, take)

    def _miss(self, number: int, _publisher: str, count: int) -> None:
        """Samples that nobody has any more, on the network thread."""
        self._runner.missed[number] += count

    def _progress(self, group: Group, source: str) -> tuple[list[str], Mapping[str, Progress]]:
        """The keys of a group that one publisher (hexadecimal) feeds, and how far each is, after all that has come."""

        def look(members: Sequence[Member]) -> tuple[list[str], Mapping[str, Progress]]:
            mine = [member for member in members if member.group is group]
            counts = {key: n for member in mine for key, n in member.progress().get(source, {}).items()}
            known = [key for member in mine for key in member.keys]
            return (list(counts) if group.names else known), counts

        try:
            return self._runner.ask_all(look).result(_PROGRESS_S)
        except TimeoutError:
            return [], {}

    def _answer(self, id: str, question: Callable[[Member], T]) -> T:
        """What a filter answers, after all that has come; raises ``KeyError``, or ``CommandError`` when it is stuck."""
        if id not in self._runner.snapshots:
            raise KeyError(id)
        try:
            return self._runner.ask(id, question).result(_ANSWER_S)
        except TimeoutError as error:
            raise CommandError("the filter has not answered in time") from error

    def _recorder_of(self, id: str) -> FilterRecorder | None:
        group = self._runner.group_of(id)
        return None if group is None else self._recorders.get(group)

    def _with_files(self, id: str, snapshot: Snapshot) -> Snapshot:
        """A snapshot with what other threads know."""
        unsaved, recorder = self._unsaved.get(id, ""), self._recorder_of(id)
        if not unsaved and recorder is None:
            return snapshot
        return replace(snapshot, unsaved=unsaved, recording=None if recorder is None else recorder.status)


def _recorder(group: Group, hearsay: Hearsay, snapshot: threading.Event) -> FilterRecorder | None:
    settings = group.plan.config.record
    if settings is None:
        return None
    types = stream_types({sensor.settings.topic: sensor.settings.type for sensor in group.plan.sensors})
    return FilterRecorder(settings, hearsay, ByPattern(types), snapshot)


def _saved(group: Group, id: str) -> bytes | None:
    settings = group.plan.config.checkpoint
    return None if settings is None else read_checkpoint(Path(settings.folder), id)


def _is_due(group: Group, saved_at: float | None) -> bool:
    settings = group.plan.config.checkpoint
    return settings is not None and (saved_at is None or time.monotonic() - saved_at >= settings.every)


def _plain(id: str) -> str:
    """An id as one part of a key of Zenoh."""
    return re.sub(r"[^\w.-]", "_", id)
