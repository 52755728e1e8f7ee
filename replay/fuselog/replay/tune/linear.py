"""The filter about the typical point of a log: one linear step a sample, in the order in which samples come."""
# A matrix keeps the letter of the textbooks when it moves on.
# pyright: reportConstantRedefinition=false

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Plan
from fuselog.fusion.config import Problem, did_you_mean
from fuselog.fusion.design import DesignError, Step, UndetectableError, check_detectable, check_stable, make_step
from fuselog.fusion.design import period_map as error_map
from fuselog.fusion.plan.steady import Nominal, make_round
from fuselog.replay.tune.observed import Observed, measuring_sensors

Floats = NDArray[np.float64]
Order = Sequence[tuple[Fraction, int]]  # time since the sample before (s), rank
Gains = Mapping[int, Floats]  # rank: (n, m), of samples that are applied one after another

_VARIES = {"beacon_range": "the beacon of each sample", "magnetometer": "the field of each sample"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linear:
    """The filter as matrices over one period of all its sensors; n states, those of ``open_loop`` left out."""

    plan: Plan
    seen: Observed
    states: tuple[str, ...]  # (n,)
    index: tuple[int, ...]  # (n,) where they are in the model
    order: Order
    steps: tuple[Step, ...]
    H: Mapping[int, Floats]  # rank: (m, n)

    def steps_of(self, order: Order) -> tuple[Step, ...]:
        """Other schedules of the same filter."""
        full = _full_steps(self.plan, self.seen, order)
        return tuple(_part(step, self.index) for step in full)

    def transitions(self, apart_ns: NDArray[np.int64]) -> list[Floats]:
        """F (n, n) over each of these times."""
        rank = self.order[0][1]
        return [step.F for step in self.steps_of([(Fraction(int(dt), 10**9), rank) for dt in apart_ns])]

    def mean(self, gains: Sequence[Floats]) -> dict[int, Floats]:
        """One gain a sensor, the mean of those (n, m) that its samples have in a period."""
        ranks = [rank for _, rank in self.order]
        return {
            r: np.mean([G for rank, G in zip(ranks, gains, strict=True) if rank == r], axis=0)
            for r in sorted(set(ranks))
        }

    def error_map(self, gains: Gains) -> Floats:
        """What a period makes of an error of the estimate (n, n)."""
        return error_map(self.steps, [gains[rank] for _, rank in self.order])

    def check_stable(self, gains: Gains) -> None:
        """Raise ``DesignError`` where errors of the estimate do not die out."""
        check_stable(self.error_map(gains), states=self.states)

    def refuse(self, reason: str) -> Exception:
        """A ``ConfigError`` at the gain."""
        return self.plan.source.complain([Problem(("gain",), reason)])


def linearise(plan: Plan, seen: Observed, open_loop: Sequence[str]) -> Linear:
    """The filter about ``seen.nominal`` at its rates; ``open_loop`` names states that nothing corrects.

    Raises ``ConfigError`` for unknown ones, for a state that no sensor sees, and where there is no linear filter.
    """
    unknown = [state for state in open_loop if state not in plan.states]
    if unknown:
        reason = f"{plan.card.name} has no state {unknown[0]!r} to leave open{did_you_mean(unknown[0], plan.states)}"
        raise plan.source.complain([Problem(("model", "name"), reason)])
    varying = [
        Problem(("sensors", sensor.name, "kind"), f"no gain can be found for it: it depends on {_VARIES[kind]}")
        for sensor in measuring_sensors(plan)
        if (kind := sensor.settings.kind) in _VARIES
    ]
    if varying:
        raise plan.source.complain(varying)
    try:
        order = schedule({sensor.rank: seen.paces[sensor.name].hz for sensor in measuring_sensors(plan)})
        full = _full_steps(plan, seen, order)
        index = tuple(i for i, state in enumerate(plan.states) if state not in open_loop)
        _check_left_out(plan, full, index)
        steps = tuple(_part(step, index) for step in full)
        linear = Linear(
            plan=plan,
            seen=seen,
            states=tuple(plan.states[i] for i in index),
            index=index,
            order=order,
            steps=steps,
            H={rank: step.H for (_, rank), step in zip(order, steps, strict=True)},
        )
        _check_seen(linear)
    except UndetectableError as error:
        reason = f"{error}; open_loop leaves states that nothing else depends on without a gain"
        raise plan.source.complain([Problem(("model", "name"), reason)]) from error
    except DesignError as error:
        raise plan.source.complain([Problem(("gain",), f"no linear filter to design a gain for: {error}")]) from error
    return linear


def schedule(rates: dict[int, float]) -> list[tuple[Fraction, int]]:
    """Time since the sample before (s) and rank of each sample in one period, given rates (Hz) by rank.

    Raises ``DesignError`` where they have no common period that is short enough.
    """
    around = make_round(rates, 0)
    return list(zip(around.dt, around.rank, strict=True))


def _full_steps(plan: Plan, seen: Observed, order: Order) -> list[Step]:
    tables = plan.tables._replace(sensor=plan.tables.sensor.copy())
    for rank, lever in seen.levers.items():
        tables.sensor[rank * 7 : rank * 7 + 3] = lever
    kernel = plan.kernel
    nominal = Nominal(seen.nominal, plan.x, plan.card, plan.sensors, tables, kernel)
    R = {sensor.rank: seen.noise[sensor.name] for sensor in measuring_sensors(plan)}
    return [make_step(*nominal.move(dt), nominal.seen(rank), R[rank]) for dt, rank in order]


def _part(step: Step, index: Sequence[int]) -> Step:
    at = np.ix_(index, index)
    return replace(step, F=step.F[at], Q=step.Q[at], H=step.H[:, list(index)])


def _check_left_out(plan: Plan, steps: Sequence[Step], index: Sequence[int]) -> None:
    """No state that stays may depend on one that is left out, nor may any sensor."""
    out = [i for i in range(len(plan.states)) if i not in index]
    for i in out:
        if any(step.F[list(index), i].any() or step.H[:, i].any() for step in steps):
            raise DesignError(f"others depend on {plan.states[i]}: it cannot be left open")


def _check_seen(linear: Linear) -> None:
    """Raise ``UndetectableError`` for what no sensor sees in a whole period."""
    moved, rows = np.eye(len(linear.states)), list[Floats]()
    for step in linear.steps:
        moved = step.F @ moved
        rows.append(step.H @ moved)
    check_detectable(moved, np.vstack(rows), states=linear.states)
