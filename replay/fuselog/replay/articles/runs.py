"""Many runs of one system through fuselog's filter, as if each were a log of its own."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuselog.fusion import Engine, Plan, Stream, Track, compile_plan, parse_config
from fuselog.fusion.intake import Intake
from fuselog.replay.signals import Signal, encode
from fuselog.schemas import definition

Floats = NDArray[np.float64]

_TRUTH = "/ground_truth"
_PAUSE_NS = 10_000_000_000  # between two runs, whose messages are encoded and decoded together


def plan_of(**configuration: Any) -> Plan:
    """The plan of a configuration; models of this package are named ``models.py:...``."""
    name = str(Path(__file__).with_name("configuration"))
    return compile_plan(*parse_config(json.dumps({"fuselog": 1, **configuration}), name=name))


@dataclass(frozen=True, slots=True, kw_only=True)
class Runs:
    """The signals of each run, truth included, and the track that a filter made of them."""

    signals: Sequence[Sequence[Signal]]
    tracks: Sequence[Track]

    def truth(self, column: int = 0) -> Floats:
        """One number of the truth (runs, n), from the second stamp on: at the first nothing is measured."""
        return np.stack([_of(run, _TRUTH).values[1:, column] for run in self.signals])

    def estimate(self, state: str) -> Floats:
        """The estimates (runs, n) of a state at the same stamps."""
        return np.stack([track[state][row] for track, row in zip(self.tracks, self._rows, strict=True)])

    def variance(self, state: str) -> Floats:
        """The filter's own variances (runs, n)."""
        return np.stack([track.variance(state)[row] for track, row in zip(self.tracks, self._rows, strict=True)])

    def error(self, state: str, column: int = 0) -> Floats:
        """Estimate less truth (runs, n)."""
        return self.estimate(state) - self.truth(column)

    def absorbed(self, sensor: str) -> Floats:
        """The shares of the innovation (n,) that the first run took from a sensor's first number."""
        return self.tracks[0].absorbed[self.tracks[0].of(sensor), 0]

    def nees(self, states: Sequence[str], errors: Sequence[Floats]) -> Floats:
        """e' P^-1 e (runs, n) of the errors (runs, n) of all the filter's states."""
        e = np.stack(errors, axis=-1)
        rows = zip(self.tracks, self._rows, strict=True)
        P = np.stack([_covariances(track, row, states) for track, row in rows])
        return np.einsum("rni,rni->rn", e, np.linalg.solve(P, e[..., np.newaxis])[..., 0])

    @property
    def _rows(self) -> list[NDArray[np.int64]]:
        """For each run the last row at or before each stamp of the truth but the first."""
        return [
            np.searchsorted(track.t_ns, _of(run, _TRUTH).t_ns[1:], side="right") - 1
            for run, track in zip(self.signals, self.tracks, strict=True)
        ]


def times(n: int, dt: float) -> Floats:
    """dt, 2 dt, ... n dt: when things are measured."""
    return np.arange(1, n + 1, dtype=np.float64) * dt


def simulate_runs(
    signals: Callable[[Any, float, np.random.Generator], list[Signal]],
    parameters: Any,
    duration: float,
    runs: int,
    *,
    seed: int,
) -> list[list[Signal]]:
    """A scenario's signals again and again, each run with noise of its own; more runs do not change the first."""
    return [signals(parameters, duration, np.random.default_rng([seed, run])) for run in range(runs)]


def fuse_runs(plan: Plan, signals: Sequence[Sequence[Signal]]) -> Runs:
    """Every run through a filter that starts anew: the rows that ``reprocess`` gives for its log, bit for bit.

    All runs are encoded and decoded together, for that is quicker, a pause apart; the engine then takes them one by
    one, in stamp order. All runs have the same topics.
    """
    named = {sensor.settings.topic for sensor in plan.sensors}
    topics = [signal.topic for signal in signals[0] if signal.topic in named]
    first = int(_of(signals[0], _TRUTH).t_ns[0])
    apart = max(int(signal.t_ns[-1] - first) for run in signals for signal in run if len(signal.t_ns)) + _PAUSE_NS
    whole = [_join([_of(run, topic) for run in signals], apart) for topic in topics]
    intake = Intake(plan)
    connect(intake, whole)
    events = intake.take(encode(whole, range(len(whole)))).events
    events = events.take(np.lexsort((events.sensor, events.t_ns)))
    begins = np.searchsorted(events.t_ns, first + apart * np.arange(len(signals) + 1) - _PAUSE_NS // 2)
    engine = Engine(plan, window_ns=0)
    fresh = engine.snapshot()
    tracks: list[Track] = []
    for run, (begin, end) in enumerate(pairwise(begins.tolist())):
        engine.restore(fresh)
        tracks.append(_earlier(engine.advance(events.take(slice(begin, end))), run * apart))
    return Runs(signals=signals, tracks=tracks)


def connect(intake: Intake, signals: Sequence[Signal]) -> None:
    """Open a stream for each signal; its number is its place."""
    for number, signal in enumerate(signals):
        intake.open(number, _stream(signal))


def _of(run: Sequence[Signal], topic: str) -> Signal:
    return next(signal for signal in run if signal.topic == topic)


def _join(parts: Sequence[Signal], apart: int) -> Signal:
    return replace(
        parts[0],
        t_ns=np.concatenate([part.t_ns + run * apart for run, part in enumerate(parts)]),
        values=np.concatenate([part.values for part in parts]),
    )


def _stream(signal: Signal) -> Stream:
    return Stream(
        topic=signal.topic,
        encoding="cdr",
        schema_name=signal.schema_name,
        schema_encoding="ros2msg",
        schema_text=definition(signal.schema_name),
    )


def _earlier(track: Track, by_ns: int) -> Track:
    return replace(track, t_ns=track.t_ns - by_ns, stamp_ns=track.stamp_ns - by_ns, arrival_ns=track.arrival_ns - by_ns)


def _covariances(track: Track, rows: NDArray[np.int64], states: Sequence[str]) -> Floats:
    """P (n, N, N) of these rows, in the order of ``states``."""
    order = [track.states.index(state) for state in states]
    upper = np.triu_indices(len(track.states))
    P = np.zeros((len(rows), len(track.states), len(track.states)))
    P[:, upper[0], upper[1]] = P[:, upper[1], upper[0]] = track.P[rows]
    return P[:, order][:, :, order]
