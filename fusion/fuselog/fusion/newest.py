"""The newest entry of a history by itself: what is left when a command ends the lag window, and what it changes."""

import math
from collections.abc import Mapping
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.kernel.memory import begin_history, empty_history, move_history, rest_input
from fuselog.fusion.kernel.rotations import quaternions_from_rpy, rpy_from_quaternions
from fuselog.fusion.kernel.tables import History
from fuselog.fusion.plan import Plan

Floats = NDArray[np.float64]

_FLAT = 1e-6  # least |cos(pitch)| by which rates of roll and yaw are told apart


def begin(plan: Plan, capacity: int) -> History:
    """The history of a filter that has seen nothing."""
    u = rest_input(list(plan.card.rest.values()))
    return begin_history(plan.kernel, plan.tables, capacity, plan.x, plan.P, plan.known, u)


def begin_again(plan: Plan, history: History, capacity: int) -> History:
    """The same, with the counts of a filter that has seen something."""
    anew = begin(plan, capacity)
    anew.counts[:] = history.counts
    return anew


def newest_alone(plan: Plan, history: History, capacity: int) -> History:
    """The newest entry as the base of a history: nothing can come before it."""
    alone = empty_history(plan.kernel, plan.tables, capacity)
    move_history(history, int(history.cursor[1]), alone)
    return alone


def carry_over(before: Plan, after: Plan, history: History, capacity: int) -> History:
    """``newest_alone`` under another plan of the same states and sensors; what was learned of noises begins anew.

    The moment of the entry goes on with the last variant of the gain, the one without conditions.
    """
    alone, fresh = newest_alone(before, history, capacity), begin(after, capacity)
    kernel, variants = after.kernel, len(after.tables.gain) // after.tables.S
    alone = alone._replace(learned=fresh.learned)
    alone.marks[kernel.VARIANT] = variants - 1
    if after.tables.gap_ns < 0:  # without reacquisition there is no end of one, either
        alone.marks[kernel.ACQUIRING] = 0
    return alone


def put_states(plan: Plan, history: History, values: Mapping[str, float], sd: Mapping[str, float]) -> None:
    """Set states of the newest entry, in their units, to what has these standard deviations and no covariance.

    Roll, pitch and yaw of a model with a quaternion are set in it. Its covariance is of small turns about the body's
    axes: with all three given, the standard deviations are of these; with fewer, of the angles themselves, and those
    not given keep theirs.
    """
    kernel: ModuleType = plan.kernel
    N, LD, tail = kernel.N, kernel.LD, int(history.cursor[1])
    row = history.state[tail * kernel.ROW : (tail + 1) * kernel.ROW]
    P = row[kernel.COVARIANCE : kernel.COVARIANCE + LD * LD].reshape(LD, LD)[:N, :N]
    index = [plan.states.index(name) for name in values]
    turn = slice(kernel.ROTATION, kernel.ROTATION + 3)
    rotated = kernel.ROTATION >= 0 and any(turn.start <= i < turn.stop for i in index)
    by_angle = rotated and not {*range(turn.start, turn.stop)} <= {*index}
    if by_angle:
        _change(P, turn, _angles_from_turns(row[turn]))
    for i, name in zip(index, values, strict=True):
        angle = plan.card.states[name] == "rad"
        row[i] = _wrapped(values[name]) if angle else values[name]
        row[kernel.KNOWN + i] = 1.0
        P[i, :] = P[:, i] = 0.0
        P[i, i] = sd.get(name, 1.0) ** 2
    if by_angle:
        _change(P, turn, _turns_from_angles(row[turn]))
    if rotated:
        row[N : N + 4] = quaternions_from_rpy(row[turn][np.newaxis])[0]
        row[turn] = rpy_from_quaternions(row[N : N + 4][np.newaxis])[0]


def _wrapped(angle: float) -> float:
    """The same angle in (-pi, pi]."""
    return angle if -math.pi < angle <= math.pi else math.pi - (math.pi - angle) % (2 * math.pi)


def _change(P: Floats, part: slice, T: Floats) -> None:
    """P of the states with T e in place of the part's e, exactly symmetric."""
    P[part, :] = T @ P[part, :]
    P[:, part] = P[:, part] @ T.T
    P[:] = (P + P.T) / 2


def _turns_from_angles(rpy: Floats) -> Floats:
    """The turn about the body's axes (rad) by small changes of roll, pitch and yaw (Diebel 2006, equation 68)."""
    roll, pitch = rpy[:2]
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    return np.array([[1.0, 0.0, -sp], [0.0, cr, sr * cp], [0.0, -sr, cr * cp]])


def _angles_from_turns(rpy: Floats) -> Floats:
    """The inverse of ``_turns_from_angles``; where the pitch is +-90 deg, that of an attitude close to it."""
    roll, pitch = rpy[:2]
    sr, cr, sp = np.sin(roll), np.cos(roll), np.sin(pitch)
    cp = np.copysign(max(abs(np.cos(pitch)), _FLAT), np.cos(pitch))
    return np.array([[1.0, sr * sp / cp, cr * sp / cp], [0.0, cr, -sr], [0.0, sr / cp, cr / cp]])
