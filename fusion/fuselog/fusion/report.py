"""Results as plain data for JSON; numbers keep every digit."""

from dataclasses import asdict
from typing import Any

from fuselog.fusion.engine import Estimate
from fuselog.fusion.ledger import Ledger
from fuselog.fusion.plan import Plan
from fuselog.fusion.plan.gains import variants


def ledger_json(ledger: Ledger) -> dict[str, dict[str, Any]]:
    """The accounts by sensor."""
    return {name: asdict(account) for name, account in ledger.items()}


def steady_gains(plan: Plan) -> list[str]:
    """The gains that were computed when the configuration was loaded, a line for each state that has any."""
    modes = [variant.mode for _, variant in variants(plan.config, [])]
    S, M, N = plan.tables.S, plan.tables.M, len(plan.states)
    tables, lines = plan.tables.table.reshape(-1, S, M, N), list[str]()
    for index in (i for i, mode in enumerate(modes) if mode == "steady_state"):
        lines.append("steady gain" + (f" of schedule.{index}" if len(modes) > 1 else "") + ":")
        for f, state in enumerate(plan.states):
            numbers = [
                f"{sensor.name}.{name} {tables[index, sensor.rank, row, f]:.6g}"
                for sensor in plan.sensors
                for row, name in enumerate(sensor.names)
                if tables[index, sensor.rank, row, f]
            ]
            lines += [f"  {state}: {', '.join(numbers)}"] if numbers else []
    return lines


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
