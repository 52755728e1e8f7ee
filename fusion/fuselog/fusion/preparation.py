"""The first half of a filter: raw messages and commands into ordered events. It knows nothing of the estimate."""

from typing import NamedTuple

import numpy as np

from fuselog.fusion.changes import changed_plan, check_state
from fuselog.fusion.commands import Command, CommandError, Configure, Reset, SetState
from fuselog.fusion.events import Decision, Events, blank_events
from fuselog.fusion.intake import ClockGuard, Intake, StampOrder
from fuselog.fusion.intake.feeds import Floats, Ints
from fuselog.fusion.kept import take_whole
from fuselog.fusion.kernel.tables import NEVER
from fuselog.fusion.plan import Plan
from fuselog.fusion.sealed import Tree
from fuselog.schemas import ConfigError, Messages


class Change(NamedTuple):
    """A command that can be followed."""

    command: Command
    plan: Plan  # from here on
    after_ns: int  # when the last message before it was received, 0 before the first
    asked_ns: int


class Prepared(NamedTuple):
    """What a batch gave: events in their order, the lever arm (m) of each sensor placed by it; then a command.

    ``settled`` are the events that nothing can come before any more, in the total order, where somebody asked for them.
    """

    events: Events
    levers: dict[int, Floats]
    settled: Events | None = None
    change: Change | None = None


class Preparation:
    """Decodes, binds and orders. ``hold`` gives events in the order of stamps, ``settle`` beside them those settled."""

    def __init__(self, plan: Plan, *, hold: bool, settle: bool) -> None:
        self.intake = Intake(plan)
        self.after_ns = 0  # the latest time at which a message was received
        self._plan = plan
        self._clock = _clock(plan)
        self._order = _order(plan) if hold else None
        self._settling = _order(plan) if settle and not hold else None
        self._settle = settle
        self._floor = NEVER  # what is older came too late for a command

    def take(self, messages: Messages) -> Prepared:
        """A batch of messages, in the order of arrival."""
        return self.arrange(*self.intake.take(messages), messages.log_time)

    def arrange(self, events: Events, levers: dict[int, Floats], received_ns: Ints) -> Prepared:
        """What the intake made of messages that were received then."""
        if len(received_ns):
            self.after_ns = max(self.after_ns, int(received_ns.max()))
        self._clock.mark(events)
        if self._floor != NEVER:
            late = (events.fault == Decision.FUSED) & (events.t_ns < self._floor)
            events.fault[late] = Decision.LATE
        if self._order is not None:
            events = self._order.push(events)
        return Prepared(events, levers, self._settled(events))

    def rest(self) -> Prepared:
        """What was still held back for its order."""
        events = blank_events(0, self._plan.tables.M) if self._order is None else self._order.finish()
        if self._settling is not None:
            return Prepared(events, {}, self._settling.finish())
        return Prepared(events, {}, self._settled(events))

    def obey(self, command: Command, asked_ns: int | None = None) -> Prepared:
        """Release what is held back, and end the lag window; raises ``CommandError``, and does nothing, where it must.

        After ``Reset`` the next sample may have any stamp, as the first one had.
        """
        plan = self._plan_after(command)
        rest = self.rest()
        self._plan, self._floor = plan, self._clock.newest
        if isinstance(command, Reset):
            self._clock, self._floor = _clock(plan), NEVER
            self._order = None if self._order is None else _order(plan)
            self._settling = None if self._settling is None else _order(plan)
        asked_ns = self.after_ns if asked_ns is None else asked_ns
        return rest._replace(change=Change(command, plan, self.after_ns, asked_ns))

    def waiting(self) -> list[int]:
        """How many samples of each sensor are held back."""
        held = np.array(self.intake.pending)
        if self._order is not None:
            held += np.bincount(self._order.pending.sensor, minlength=len(held))
        return held.tolist()

    def save(self) -> Tree:
        """What ``load`` takes."""
        return {
            "intake": self.intake.save(),
            "after_ns": self.after_ns,
            "clock": self._clock.save(),
            "floor": self._floor,
            "order": None if self._order is None else self._order.save(),
            "settling": None if self._settling is None else self._settling.save(),
        }

    def load(self, tree: Tree) -> None:
        """Become what another with the same plan was; raises as ``Intake.load``."""
        self.intake.load(tree["intake"])
        self._clock.load(tree["clock"])
        self.after_ns, self._floor = take_whole(tree["after_ns"]), take_whole(tree["floor"])
        for order, kept in ((self._order, tree["order"]), (self._settling, tree["settling"])):
            if order is not None:
                order.load(kept, self._plan.tables)

    def _settled(self, events: Events) -> Events | None:
        if self._settling is not None:
            return self._settling.push(events)
        return events if self._settle else None

    def _plan_after(self, command: Command) -> Plan:
        match command:
            case Reset():
                return self._plan
            case SetState():
                check_state(self._plan, command)
                return self._plan
            case Configure(text):
                plan = changed_plan(self._plan, text)
                try:
                    self.intake.configure(plan)
                except ConfigError as error:
                    raise CommandError("; ".join(error.problems)) from error
                return plan


def _clock(plan: Plan) -> ClockGuard:
    return ClockGuard(round(plan.config.lag.max_step * 1e9))


def _order(plan: Plan) -> StampOrder:
    return StampOrder(plan.tables.window_ns, plan.tables.M)
