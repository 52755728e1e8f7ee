"""Sensors that measure the same and say different things."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion.health.findings import Finding
from fuselog.fusion.health.measure import FEWEST
from fuselog.fusion.health.window import Recent, Window
from fuselog.fusion.kernel.tables import Role
from fuselog.fusion.plan import Plan

_COMPARED = 50  # samples of each of two sensors that measure the same
_LOOKED_AT = 200  # of which those are the last that were tried
_APART = 5.0  # standard deviations of their mean difference from which they disagree


def disagreements(plan: Plan, recent: Recent) -> dict[str, list[Finding]]:
    """By sensor: pairs that measure the same, and whose innovations have long been apart."""
    found: dict[str, list[Finding]] = {}
    measuring = [s for s in plan.sensors if s.role == Role.MEASURES and s.settings.kind == "state"]
    for a, b in combinations(measuring, 2):
        for name in (name for name in a.names if name in b.names):
            apart = _apart(*(_last(recent[s.rank], s.names.index(name)) for s in (a, b)))
            if apart is not None:
                reason = f"{a.name} and {b.name} disagree on {name} by {apart.difference:.3g} "
                reason += f"({apart.sigmas:.0f} sigma) for {apart.samples} samples: slip, a scale or a bias?"
                found.setdefault(a.name, []).append(Finding(f"disagree_{b.name}_{name}", "degraded", reason))
    return found


class _Apart(NamedTuple):
    difference: float  # of the means, in the number's unit
    sigmas: float  # of that
    samples: int  # of the sensor with fewer


class _Last(NamedTuple):
    """The last innovations of one number that were tried, and their variances."""

    stamp_ns: NDArray[np.int64]
    innovation: NDArray[np.float64]
    variance: NDArray[np.float64]


def _last(window: Window, number: int) -> _Last:
    variance = window.variance[-_LOOKED_AT:, number]
    tried = np.flatnonzero(np.isfinite(variance))[-_COMPARED:]
    stamps, innovations = window.stamp_ns[-_LOOKED_AT:], window.innovation[-_LOOKED_AT:, number]
    return _Last(stamps[tried], innovations[tried], variance[tried])


def _apart(a: _Last, b: _Last) -> _Apart | None:
    """How far the means are apart, over the time that both cover; None where they may be the same.

    Differences within one standard deviation of a single one are left alone, however long they last.
    """
    if min(len(a.stamp_ns), len(b.stamp_ns)) < FEWEST:
        return None
    begin, end = max(a.stamp_ns.min(), b.stamp_ns.min()), min(a.stamp_ns.max(), b.stamp_ns.max())
    inside = [(one.stamp_ns >= begin) & (one.stamp_ns <= end) for one in (a, b)]
    samples = int(min(np.count_nonzero(keep) for keep in inside))
    if samples < FEWEST:
        return None
    means = [float(one.innovation[keep].mean()) for one, keep in zip((a, b), inside, strict=True)]
    variances = [float(one.variance[keep].mean()) for one, keep in zip((a, b), inside, strict=True)]
    counts = [int(np.count_nonzero(keep)) for keep in inside]
    difference = means[0] - means[1]
    sigmas = abs(difference) / float(np.sqrt(variances[0] / counts[0] + variances[1] / counts[1]))
    if sigmas < _APART or abs(difference) < float(np.sqrt(sum(variances))):
        return None
    return _Apart(difference, sigmas, samples)
