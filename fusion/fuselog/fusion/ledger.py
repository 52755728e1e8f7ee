"""The ledger: every sample that was received is accounted for, sensor by sensor, exactly."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.events import Decision
from fuselog.fusion.plan import Plan


@dataclass(frozen=True, slots=True, kw_only=True)
class Account:
    """received = fused + pending + duplicate + late + gated + skipped + disabled + the sum of invalid."""

    received: int
    fused: int
    gated: int
    late: int
    duplicate: int
    skipped: int
    disabled: int
    pending: int
    invalid: dict[str, int]

    @property
    def balanced(self) -> bool:
        """Whether every sample is accounted for."""
        refused = self.gated + self.late + self.duplicate + self.skipped + self.disabled + sum(self.invalid.values())
        return self.received == self.fused + refused + self.pending


Ledger = dict[str, Account]


_COUNTS = ("fused", "gated", "late", "duplicate", "skipped", "disabled")
_PLACES = [(name, int(Decision[name.upper()])) for name in _COUNTS]
_INVALID = [(d.name.removeprefix("INVALID_").lower(), int(d)) for d in Decision if d.invalid]


def make_ledger(plan: Plan, received: Sequence[int], pending: NDArray[np.int64], counts: NDArray[np.int64]) -> Ledger:
    """The accounts of all sensors, from what came in, what is held, and ``counts`` (S, decisions)."""
    columns = zip(plan.sensors, received, pending.tolist(), counts.tolist(), strict=True)
    return {
        sensor.name: Account(
            received=came,
            pending=held,
            invalid={reason: mine[place] for reason, place in _INVALID},
            **{name: mine[place] for name, place in _PLACES},
        )
        for sensor, came, held, mine in columns
    }


def sum_accounts(ledger: Ledger) -> Account:
    """One account for all sensors."""
    accounts = list(ledger.values())
    reasons = sorted({reason for account in accounts for reason in account.invalid})
    return Account(
        invalid={reason: sum(account.invalid[reason] for account in accounts) for reason in reasons},
        **{name: sum(getattr(account, name) for account in accounts) for name in ("received", "pending", *_COUNTS)},
    )
