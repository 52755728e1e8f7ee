"""The one thread that owns all filters of a service: takes what has come, brings it to its filters, shows snapshots."""

import math
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import TypeVar, cast

from fuselog.fusion.captures import Captures
from fuselog.schemas import FuselogError
from fuselog.service.live.feeding import Feeding
from fuselog.service.live.group import Group, Subscription
from fuselog.service.live.inbox import Arrival, Inbox, Request
from fuselog.service.live.member import Member, Snapshot
from fuselog.service.live.sources import Run

_WATCH_EVERY_S = 0.25  # from one judgement of a filter's health to the next while samples come
_ATTEND_SHARE = 0.1  # of the time, most for all judgements then
_GATHER_S = 0.004  # most that a turn waits for more to come, where turns are what takes the time
_QUIET_S = 0.02  # without samples, then snapshots are renewed at once
_MOST_UNKNOWN = 1000
_MOST_ENDED = 100

T = TypeVar("T")
Make = Callable[[Group, Captures], Member]
Target = tuple[Member, int]  # and the number of the key there


@dataclass(frozen=True, slots=True)
class Unknown:
    """Samples that belong to no filter: how many, and the last keys with the reason of each."""

    samples: int
    keys: Mapping[str, str]


class Runner:
    """Feeds the filters of some groups from the inbox until ``stop``, then finishes what is there.

    A filter begins with the first sample whose key has a new name in it, and ends after ``fleet.expire`` without any.
    ``heartbeat`` is the monotonic time (s) of the last turn.
    """

    def __init__(
        self, groups: Sequence[Group], inbox: Inbox, make: Make, *, flush: Callable[[], None], shown: Callable[[], None]
    ) -> None:
        """``flush`` lets go out what filters have given away; ``shown`` is called when there are new snapshots."""
        self.inbox = inbox
        self._make, self._flush, self._shown, self._feeding = make, flush, shown, Feeding()
        self._subscriptions = [each for group in groups for each in group.subscriptions]
        self._keys = [each.pattern.key for each in self._subscriptions]
        self._members: dict[str, Member] = {}
        self._ids: dict[tuple[Group, Captures], str] = {}
        self._routes: dict[tuple[int, str], list[Target]] = {}
        self.missed: Counter[int] = Counter()  # by subscription: what the network could not bring any more
        self._unknown: OrderedDict[str, str] = OrderedDict()
        self._unknown_samples = 0
        self._impossible: OrderedDict[tuple[Group, Captures], str] = OrderedDict()
        self._ended: OrderedDict[str, Snapshot] = OrderedDict()
        self._stopping = False
        self.last_checkpoints: list[tuple[Group, str, bytes]] = []  # when ``run`` is over
        self._stale: set[str] = set()  # ids whose snapshot is old
        self._attend_from = self._predict_from = 0.0  # monotonic s
        self.heartbeat = time.monotonic()
        self.snapshots: Mapping[str, Snapshot] = {}
        self.ended: Mapping[str, Snapshot] = {}
        self.unknown = Unknown(0, {})
        for group in groups:
            if not group.names:
                self._begin(group, ())
        self._show()

    @property
    def subscriptions(self) -> list[Subscription]:
        """What to subscribe to, by number."""
        return self._subscriptions

    def ask(self, id: str, question: Callable[[Member], T]) -> "Future[T]":
        """Have a question answered by the thread that owns the filter, after all that has come."""
        future: Future[T] = Future()

        def do() -> None:
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(question(self._members[id]))
                    self._members[id].watched = 0.0  # what it may have changed is shown first
                except Exception as error:  # whoever asked gets it
                    future.set_exception(error)
                self._stale.add(id)

        self.inbox.ask(do)
        return future

    def ask_all(self, question: Callable[[Sequence[Member]], T]) -> "Future[T]":
        """The same of all filters at once."""
        future: Future[T] = Future()

        def do() -> None:
            if future.set_running_or_notify_cancel():
                future.set_result(question([*self._members.values()]))

        self.inbox.ask(do)
        return future

    def group_of(self, id: str) -> Group | None:
        """The group of a filter; None where there is none, or none any more. May be called on any thread."""
        member = self._members.get(id)
        return None if member is None else member.group

    def stop(self) -> None:
        """Let ``run`` end when the inbox is empty."""
        self._stopping = True

    def run(self) -> None:
        """Turn after turn until ``stop``."""
        tidied = heard = 0.0
        while True:
            stopping = self._stopping
            wait_s = _QUIET_S if self._stale or stopping else _WATCH_EVERY_S
            arrivals = self.inbox.take(min(wait_s, max(self._predict_from - time.monotonic(), 0)))
            self.heartbeat = begun = time.monotonic()
            if arrivals:
                heard = begun
            self._turn(arrivals)
            self._predict()
            self._flush()
            now = time.monotonic()
            if now - tidied > _WATCH_EVERY_S:
                self._expire(now)
                tidied = now
            self._attend(now, quiet=begun - heard >= _QUIET_S)
            self._flush()
            if stopping and not arrivals:
                break
            if arrivals and not stopping and len(arrivals) < self.inbox.capacity // 16:
                time.sleep(max(now + min(now - begun, _GATHER_S) - time.monotonic(), 0.0))
        self.last_checkpoints = [
            (member.group, id, member.checkpoint())
            for id, member in self._members.items()
            if member.group.plan.config.checkpoint is not None
        ]
        for id in [*self._members]:
            self._end(id)
        self._show()

    def _turn(self, arrivals: Sequence[Arrival | Request]) -> None:
        """Bring samples to their filters, several at once, and do what was asked at its place among them."""
        batches: dict[Member, list[Run]] = {}
        for of, items in groupby(arrivals, itemgetter(0)):  # the subscription, or what is asked
            if not isinstance(of, int):
                for item in cast(Iterable[Request], items):
                    self._feed(batches)
                    item.do()
            elif self._keys[of]:
                self._send(of, self._keys[of], cast(list[Arrival], [*items]), batches)
            else:
                for key, some in groupby(cast(Iterable[Arrival], items), _key_of):
                    self._send(of, key, [*some], batches)
        self._feed(batches)

    def _send(self, subscription: int, key: str, run: list[Arrival], batches: dict[Member, list[Run]]) -> None:
        """Samples of a key to their filters."""
        for member, number in self._routes.get((subscription, key)) or self._find(subscription, key, len(run)):
            batches.setdefault(member, []).append((number, run))

    def _feed(self, batches: dict[Member, list[Run]]) -> None:
        self._feeding.feed(batches)
        self._stale.update(member.id for member in batches)
        batches.clear()

    def _find(self, subscription: int, key: str, count: int) -> list[Target]:
        """Which filters so many samples are for; none for those of an unknown key, which are counted."""
        mine = self._subscriptions[subscription]
        group, plain = mine.group, mine.plain(key)
        captures = mine.pattern.match(plain)
        if captures is None:
            return self._refuse(key, count, "no filter can have this name")
        if not mine.pattern.names:
            targets = [(m, m.keys.index(plain)) for m in self._members.values() if m.group is group]
            if targets:
                self._routes[subscription, key] = targets
            return targets or self._refuse(key, count, "there is no filter yet that it belongs to")
        identity = (group, captures)
        if identity not in self._ids:
            reason = self._refusal(group, captures) or self._try(group, captures)
            if reason:
                return self._refuse(key, count, reason)
        member = self._members[self._ids[identity]]
        self._routes[subscription, key] = [(member, member.keys.index(plain))]
        return self._routes[subscription, key]

    def _refusal(self, group: Group, captures: Captures) -> str:
        """Why there can be no such filter; empty when there can."""
        if (group, captures) in self._impossible:
            return self._impossible[group, captures]
        most = group.plan.config.fleet.most
        if sum(member.group is group for member in self._members.values()) >= most:
            return f"there are {most} filters already (fleet: most)"
        name = group.id_of(captures)
        return f"there is a filter {name!r} already" if name in self._members else ""

    def _refuse(self, key: str, count: int, reason: str) -> list[Target]:
        self._unknown_samples += count
        self._unknown[key] = reason
        self._unknown.move_to_end(key)
        if len(self._unknown) > _MOST_UNKNOWN:
            self._unknown.popitem(last=False)
        return []

    def _try(self, group: Group, captures: Captures) -> str:
        """Begin a filter with a name that somebody has put into a key -> why there can be none."""
        try:
            self._begin(group, captures)
        except FuselogError as error:
            self._impossible[group, captures] = str(error)
            if len(self._impossible) > _MOST_UNKNOWN:
                self._impossible.popitem(last=False)
            return str(error)
        return ""

    def _begin(self, group: Group, captures: Captures) -> None:
        member = self._make(group, captures)
        name = member.id
        self._members[name] = member
        self._ids[group, captures] = name
        self._ended.pop(name, None)
        self._forget_routes(group)
        self._predict_from = 0.0

    def _end(self, name: str) -> None:
        member = self._members.pop(name)
        member.finish()
        self._ids = {identity: id for identity, id in self._ids.items() if id != name}
        self._forget_routes(member.group)
        self._ended[name] = member.snapshot
        if len(self._ended) > _MOST_ENDED:
            self._ended.popitem(last=False)

    def _forget_routes(self, group: Group) -> None:
        numbers = {n for n, each in enumerate(self._subscriptions) if each.group is group}
        self._routes = {route: to for route, to in self._routes.items() if route[0] not in numbers}

    def _expire(self, now: float) -> None:
        for name, member in [*self._members.items()]:
            if member.group.names and now - (member.last_arrival or now) > member.group.plan.config.fleet.expire:
                self._end(name)
                self._show()

    def _predict(self) -> None:
        """Have filters predict to the machine's time where that is due."""
        if time.monotonic() < self._predict_from:
            return
        self._predict_from = math.inf
        for member in self._members.values():
            due = member.predict_when_due(time.monotonic())
            self._predict_from = min(self._predict_from, due)

    def _attend(self, now: float, *, quiet: bool) -> None:
        """Judge filters and show them anew when it is time, until something comes.

        While samples come, one in a turn, and for no more than a share of the time: many filters are judged less often.
        """
        if not quiet and now < self._attend_from:
            return
        due = [
            (member.watched, id)
            for id, member in self._members.items()
            if now - member.watched > _WATCH_EVERY_S or (quiet and id in self._stale)
        ]
        for _, id in sorted(due):
            member = self._members[id]
            self._turn_away(member)
            member.watch()
            self._stale.discard(id)
            if not quiet or not self.inbox.empty:
                break
        if due:
            self._show()
            self._attend_from = now + (time.monotonic() - now) / _ATTEND_SHARE

    def _turn_away(self, member: Member) -> None:
        shed, oversized = self._of(self.inbox.shed, member), self._of(self.inbox.oversized, member)
        lost = {(n, self._subscriptions[n].pattern.expression): count for n, count in [*self.missed.items()]}
        member.turn_away(shed=shed, oversized=oversized, missed=self._of(lost, member))

    def _of(self, counted: Mapping[tuple[int, str], int], member: Member) -> list[int]:
        """How many of each key of a filter."""
        counts = Counter[str]()
        for (subscription, key), count in [*counted.items()]:
            if self._subscriptions[subscription].group is member.group:
                counts[self._subscriptions[subscription].plain(key)] += count
        return [counts[key] for key in member.keys]

    def _show(self) -> None:
        self.snapshots = {name: member.snapshot for name, member in self._members.items()}
        self.ended = dict(self._ended)
        self.unknown = Unknown(self._unknown_samples, dict(self._unknown))
        self._shown()


def _key_of(arrival: Arrival) -> str:
    return str(arrival[1].key_expr)
