"""A filter from raw messages to a track: intake, order and engine in one hand."""

import hashlib
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Literal, NamedTuple

import numpy as np

from fuselog.fusion.commands import Answer, Command, CommandError, Configure, Reset, SetState
from fuselog.fusion.engine import Engine, Estimate, Snapshot
from fuselog.fusion.events import Events, blank_events
from fuselog.fusion.intake import Intake
from fuselog.fusion.intake.feeds import Ints
from fuselog.fusion.ledger import Ledger, make_ledger
from fuselog.fusion.plan import Plan
from fuselog.fusion.preparation import Change, Preparation, Prepared
from fuselog.fusion.sealed import CheckpointError, Tree, seal, unseal
from fuselog.fusion.shadow import Shadow, is_optimal
from fuselog.fusion.smoothing import FixedLag
from fuselog.fusion.ticks import Ticked, Ticks
from fuselog.fusion.track import Track, join_tracks
from fuselog.schemas import FuselogError, Messages

Order = Literal["by_stamp", "as_received"]


class Beside(NamedTuple):
    """What a filter gave beside its rows; None where there was nothing."""

    smoothed: Track | None = None
    ticks: Ticked | None = None
    settled: Track | None = None
    answers: tuple[Answer, ...] = ()


_NOTHING = Beside()


@dataclass(slots=True)
class _Given:
    """What was not asked for yet."""

    smoothed: list[Track] = field(default_factory=list[Track])
    settled: list[Track] = field(default_factory=list[Track])
    answers: list[Answer] = field(default_factory=list[Answer])


class Filter:
    """One filter fed with raw messages in arrival order.

    ``as_received`` gives a row at once for every sample, as the live service publishes it, rewinding for late ones.
    ``by_stamp`` holds samples for the lag window and gives rows in stamp order. Both end in one state, bit for bit.
    Fixed-lag smoothing and ``output.settled`` take what has settled, so that they are the same in both; by_stamp gives
    nothing settled, as its rows are.
    """

    def __init__(self, plan: Plan, *, order: Order, compare: bool = False) -> None:
        """``compare`` also follows the samples with the optimal gain, for ``optimality_ratio``, where that differs."""
        self.plan = plan  # of what was applied
        self.order: Order = order
        self.compare = compare
        self._about = _about(plan, order, compare=compare)
        output, live = plan.config.output, order == "as_received"
        self._window_ns = None if live else 0
        settles = plan.config.smooth is not None or (output.settled and live)
        self._ahead = Preparation(plan, hold=not live, settle=settles)
        self.engine = Engine(plan, window_ns=self._window_ns)
        self._shadow = Shadow(plan, window_ns=self._window_ns) if compare and not is_optimal(plan) else None
        self._settled = Engine(plan, window_ns=0) if output.settled and live else None
        self._smoother = FixedLag(plan) if plan.config.smooth is not None else None
        self._ticks = Ticks(plan, output.ticks) if output.ticks is not None else None
        self._given = _Given()

    def warm_up(self) -> None:
        """Compile, or load from the cache, what the first sample, tick or question would have to wait for."""
        self._advance(blank_events(0, self.plan.tables.M))
        self.engine.warm_up()
        if self._smoother is not None:
            self._smoother.warm_up()

    @property
    def alone(self) -> bool:
        """Whether its engine takes events as they come, and nothing goes along with it."""
        followers = (self._ticks, self._shadow, self._settled, self._smoother)
        return self.order == "as_received" and all(each is None for each in followers)

    @property
    def intake(self) -> Intake:
        """Where streams are opened."""
        return self._ahead.intake

    def feed(self, messages: Messages) -> Track:
        """Take a batch; returns the rows that it settled."""
        return self.apply(self.prepare(messages))

    def prepare(self, messages: Messages) -> Prepared:
        """The first half of ``feed``: decode, bind and order. Touches nothing that ``apply`` touches."""
        return self._ahead.take(messages)

    def arrange(self, events: Events, received_ns: Ints) -> Prepared:
        """The rest of ``prepare``, of events that its intake has given."""
        return self._ahead.arrange(events, {}, received_ns)

    def command(self, command: Command, t_ns: int | None = None) -> Track:
        """Follow a command, after everything fed before it and at the filter's newest time; returns rows it settled.

        The lag window ends there: what is older and comes later is late, and what was held back for its order is
        released first. Only after ``Reset`` a stamp may be any. ``t_ns`` is when it was asked for (by default when the
        last message was received) and has no effect but in its answer. Raises ``CommandError`` for one that cannot be
        followed.
        """
        try:
            taken = self.prepare_command(command, t_ns)
        except CommandError as error:
            after = self._ahead.after_ns
            self._answer(Change(command, self.plan, after, after if t_ns is None else t_ns), str(error))
            raise
        return self.apply(taken)

    def prepare_command(self, command: Command, t_ns: int | None = None) -> Prepared:
        """The first half of ``command``, as ``prepare``; raises ``CommandError``."""
        return self._ahead.obey(command, t_ns)

    def rest(self) -> Prepared:
        """What was still held back for its order."""
        return self._ahead.rest()

    def apply(self, taken: Prepared) -> Track:
        """The second half of ``feed``: move the estimate, in the order in which batches were prepared."""
        for rank, lever in taken.levers.items():
            for follower in self._followers():
                follower.place(rank, lever)
        if taken.settled is not None:
            if self._smoother is not None:
                self._given.smoothed.append(self._smoother.advance(taken.settled))
            if self._settled is not None:
                self._given.settled.append(self._settled.advance(taken.settled))
        track = self._advance(taken.events)
        if taken.change is not None:
            self._answer(taken.change)
            self._obey(taken.change)
        return track

    def finish(self) -> Track:
        """The rows of what was still held back for its order."""
        return self.apply(self.rest())

    def beside(self) -> Beside:
        """What there is beside the rows, since this was last asked."""
        if self.alone and not self._given.answers:
            return _NOTHING
        given, self._given = self._given, _Given()
        return Beside(
            smoothed=join_tracks(given.smoothed) if given.smoothed else None,
            ticks=None if self._ticks is None else self._ticks.take(),
            settled=join_tracks(given.settled) if given.settled else None,
            answers=tuple(given.answers),
        )

    def checkpoint(self) -> bytes:
        """All that the filter remembers, for ``restore`` by a filter of the same plan, order and version, on any day.

        What ``beside`` has not given yet is not part of it.
        """
        followers: Tree = {
            "engine": self.engine.save(),
            "shadow": None if self._shadow is None else self._shadow.engine.save(),
            "settled": None if self._settled is None else self._settled.save(),
            "smoother": None if self._smoother is None else self._smoother.save(),
            "ticks": None if self._ticks is None else self._ticks.newest,
        }
        return seal(self._about, {"ahead": self._ahead.save(), **followers})

    def restore(self, data: bytes) -> None:
        """Go on where a checkpoint was made; raises ``CheckpointError``, and stays as it is, for one that is not sound.

        The streams that were open are open again, under their numbers: ``intake.streams``.
        """
        tree = unseal(data, self._about)
        try:
            Filter(self.plan, order=self.order, compare=self.compare)._load(tree)
        except CheckpointError:
            raise
        except (ValueError, TypeError, LookupError, OverflowError, AttributeError, FuselogError) as error:
            raise CheckpointError("is not written as this version writes them") from error
        self._load(tree)

    def _load(self, tree: Tree) -> None:
        self._given = _Given()
        self._ahead.load(tree["ahead"])
        self.engine.load(tree["engine"])
        if self._shadow is not None:
            self._shadow.engine.load(tree["shadow"])
        if self._settled is not None:
            self._settled.load(tree["settled"])
        if self._smoother is not None:
            self._smoother.load(tree["smoother"])
        if self._ticks is not None:
            self._ticks.load(tree["ticks"])

    def snapshot(self) -> Snapshot:
        """The engine's."""
        return self.engine.snapshot()

    @property
    def estimate(self) -> Estimate:
        """The newest state."""
        return self.engine.estimate

    def estimate_at(self, t_ns: int) -> Estimate:
        """The state at a time: see ``Engine.estimate_at``."""
        return self.engine.estimate_at(t_ns)

    @property
    def optimality_ratio(self) -> float | None:
        """The variances over those that the optimal gain would have; None where that is not followed."""
        if self._shadow is None or not self.plan.tables.covariance:
            return None
        return self._shadow.ratio(self.engine.estimate)

    @property
    def ledger(self) -> Ledger:
        """What became of every sample, sensor by sensor."""
        return make_ledger(self.plan, self.intake.received, np.array(self._ahead.waiting()), self.engine.counts)

    def _advance(self, events: Events) -> Track:
        if self._shadow is not None:
            self._shadow.engine.advance(events)
        if self._ticks is not None:
            return self._ticks.advance(self.engine, events)
        return self.engine.advance(events)

    def _followers(self) -> list[Engine | FixedLag]:
        """All that have a state of their own."""
        shadow = None if self._shadow is None else self._shadow.engine
        return [each for each in (self.engine, shadow, self._settled, self._smoother) if each is not None]

    def _obey(self, change: Change) -> None:
        for follower in self._followers():
            match change.command:
                case Reset():
                    follower.reset()
                case SetState(state, sd):
                    follower.settle()
                    follower.put(state, sd)
                case Configure():
                    follower.configure(change.plan)
        self.plan = change.plan
        if isinstance(change.command, Reset) and self._ticks is not None:
            self._ticks.reset()
        if isinstance(change.command, Configure):
            self._about = _about(self.plan, self.order, compare=self.compare)
            self._compare_anew()

    def _compare_anew(self) -> None:
        """Begin or end to follow with the optimal gain, where another plan asks for it."""
        if not self.compare or is_optimal(self.plan):
            self._shadow = None
        elif self._shadow is None:
            self._shadow = Shadow(self.plan, window_ns=self._window_ns)
            self._shadow.engine.restore(self.engine.snapshot())

    def _answer(self, change: Change, reason: str = "") -> None:
        t_ns = self.engine.estimate.t_ns
        command, _, after, asked = change
        self._given.answers.append(Answer(command=command, t_ns=t_ns, after_ns=after, asked_ns=asked, reason=reason))


def _about(plan: Plan, order: Order, *, compare: bool) -> dict[str, str]:
    """What a checkpoint must be of, to be a filter's."""
    return {
        "version of fuselog": version("fuselog"),
        "configuration": hashlib.sha256(plan.source.text.encode()).hexdigest(),
        "kernel": plan.kernel.__name__,
        "order": order,
        "gain to compare with": "optimal" if compare else "none",
    }
