"""Results as plain data for JSON; numbers keep every digit."""

from dataclasses import asdict
from typing import Any

from fuselog.fusion.engine import Estimate
from fuselog.fusion.ledger import Ledger
from fuselog.fusion.plan import Plan


def ledger_json(ledger: Ledger) -> dict[str, dict[str, Any]]:
    """The accounts by sensor."""
    return {name: asdict(account) for name, account in ledger.items()}


def estimate_json(plan: Plan, estimate: Estimate) -> dict[str, Any]:
    """Time, state by name, position (m, None where the model has none), and covariance row by row."""
    state = dict(zip(plan.states, estimate.x.tolist(), strict=True))
    position = [state.get(axis, 0.0) for axis in "xyz"] if "x" in state and "y" in state else None
    waiting = [name for name, known in zip(plan.states, estimate.known, strict=True) if not known]
    return {
        "t_ns": estimate.t_ns,
        "state": state,
        "position": position,
        "covariance": estimate.P.tolist(),
        "not_measured_yet": waiting,
    }
