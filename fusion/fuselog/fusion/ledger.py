"""The ledger: every sample that was received is accounted for, sensor by sensor, exactly."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

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


def make_ledger(plan: Plan, received: Sequence[int], pending: NDArray[np.int64], counts: NDArray[np.int64]) -> Ledger:
    """The accounts of all sensors, from what came in, what is held, and ``counts`` (S, decisions)."""
    reasons = [d for d in Decision if d.invalid]
    return {
        sensor.name: Account(
            received=received[i],
            fused=int(counts[i, Decision.FUSED]),
            gated=int(counts[i, Decision.GATED]),
            late=int(counts[i, Decision.LATE]),
            duplicate=int(counts[i, Decision.DUPLICATE]),
            skipped=int(counts[i, Decision.SKIPPED]),
            disabled=int(counts[i, Decision.DISABLED]),
            pending=int(pending[i]),
            invalid={d.name.removeprefix("INVALID_").lower(): int(counts[i, d]) for d in reasons},
        )
        for i, sensor in enumerate(plan.sensors)
    }


def sum_accounts(ledger: Ledger) -> Account:
    """One account for all sensors."""
    accounts = list(ledger.values())
    reasons = {reason for account in accounts for reason in account.invalid}
    invalid = {d: sum(account.invalid[d] for account in accounts) for d in sorted(reasons)}
    counts = [field.name for field in fields(Account) if field.name != "invalid"]
    return Account(invalid=invalid, **{name: sum(getattr(account, name) for account in accounts) for name in counts})
