"""A guard against clocks that jump ahead: one wrong stamp must not make everything after it late."""

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Decision, Events
from fuselog.fusion.kept import take_into
from fuselog.fusion.kernel.tables import NEVER, Bytes, Ints
from fuselog.schemas.compiled import kernel

_CONFIRMATIONS = 3  # samples in a row that make a jump a fact: the log paused, or the clock was set
_FUSED, _CLOCK = int(Decision.FUSED), int(Decision.INVALID_CLOCK)


class ClockGuard:
    """Marks samples whose stamp jumps ahead of the newest by more than ``max_step_ns`` as ``INVALID_CLOCK``.

    When several in a row agree on the new time, and no sample of the old one comes between, the jump is believed.
    It depends on stamps and on the order of arrival only.
    """

    def __init__(self, max_step_ns: int) -> None:
        self._max_step_ns = max_step_ns
        self._memory = np.array([NEVER, NEVER, 0])  # newest, newest of the jump, how many confirm it

    @property
    def newest(self) -> int:
        """The newest stamp that was believed, or ``NEVER``."""
        return int(self._memory[0])

    def save(self) -> Ints:
        """What ``load`` takes."""
        return self._memory

    def load(self, memory: Ints) -> None:
        """Remember what another did; raises ``ValueError`` where that cannot be."""
        take_into(self._memory, memory)

    def mark(self, events: Events) -> None:
        """Take events in arrival order and set the fault of those that jump."""
        _mark(self._memory, self._max_step_ns, events.t_ns, events.fault)


@kernel
def _mark(memory: Ints, max_step: int, t_ns: NDArray[np.int64], fault: Bytes) -> None:
    newest, ahead, confirmed = memory[0], memory[1], memory[2]
    for e in range(len(t_ns)):
        if fault[e] != _FUSED:
            continue
        t = t_ns[e]
        if newest == NEVER or t <= newest + max_step:
            confirmed = 0
        else:
            confirmed = confirmed + 1 if confirmed and abs(t - ahead) <= max_step else 1
            ahead = t
            if confirmed <= _CONFIRMATIONS:
                fault[e] = _CLOCK
                continue
            confirmed = 0
        newest = max(newest, t)
    memory[0], memory[1], memory[2] = newest, ahead, confirmed
