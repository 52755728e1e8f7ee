"""Runs as a Rerun recording: path, states, innovations, NIS and gains over the stamps."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fuselog.fusion import Decision
from fuselog.fusion.gate import chi_square_quantile
from fuselog.fusion.plan.readings import PARTS, SAME_QUANTITY
from fuselog.replay import Log, open_log
from fuselog.replay.measured import BEACON, Measured, read_measured
from fuselog.replay.results import Decisions, Results
from fuselog.replay.truth import Truth, read_truth
from fuselog.service.errors import OutputError
from fuselog.service.runs import Run, load_runs
from fuselog.service.views.view_draw import Color, Drawing
from fuselog.service.views.view_layout import Shown, layout

Floats = NDArray[np.float64]

RAW: Color = (150, 150, 150)
TRUTH: Color = (70, 200, 110)
REFUSED: Color = (235, 70, 70)
RUNS: tuple[Color, ...] = ((80, 160, 255), (255, 160, 50), (190, 120, 255), (60, 210, 210))
_BOUND = 0.95  # probability of the line in a plot of NIS


def write_recording(
    path: Path, *, outs: Sequence[Path], log: Log | Path | None = None, truth: str | None = None
) -> None:
    """Write a recording (.rrd) of output logs, with what was measured and true from the ``log`` they were made from.

    ``truth`` is a topic with poses or fixes; by default one whose name says so. All is over the timeline ``stamp``,
    and comes with its layout. Raises ``LogError``, ``ConfigError``, and ``OutputError`` where it cannot be written.
    """
    runs = load_runs(outs, RUNS)
    measured: dict[str, Measured] = {}
    true = None
    if log is not None:
        with nullcontext(log) if isinstance(log, Log) else open_log(log) as opened:
            measured = read_measured(opened, runs[0].plan)
            true = _truth(opened, runs[0].results, truth)
    _require_writable(path)
    with rr.RecordingStream("fuselog", recording_id=path.stem) as stream:
        stream.save(path, default_blueprint=layout(_shown(runs, measured, true)))
        drawing = Drawing(stream)
        _draw_measured(drawing, measured, runs[0].plan.states)
        if true is not None:
            _draw_truth(drawing, true, runs[0].plan.states)
        for run in runs:
            _draw_run(drawing, run)
        stream.flush()


def _require_writable(path: Path) -> None:
    try:
        path.open("wb").close()
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error


def _truth(log: Log, results: Results, topic: str | None) -> Truth | None:
    named = (name for name, at in log.topics.items() if "truth" in name and at[0].schema.name in PARTS)
    found = topic or next(named, None)
    return None if found is None else read_truth(log, found, datum=results.datum)


def _shown(runs: Sequence[Run], measured: Mapping[str, Measured], true: Truth | None) -> Shown:
    first, states = runs[0], runs[0].plan.states
    seen = [state for state in states if any(state in sensor.values for sensor in measured.values())]
    known = [state for state in states if true is not None and _name(state) in true.values]
    numbers = first.numbers
    return Shown(
        runs=tuple(run.name for run in runs),
        units=dict(first.plan.card.states),
        main_states=tuple(dict.fromkeys([*seen, *known, *states]))[:2],
        states={state: _span_of_state(first, measured, state) for state in states},
        numbers={(sensor, name): _span_of_innovation(found, i) for sensor, name, i, found in numbers},
        nis={sensor: (0.0, 3.5 * _bound(found)) for sensor, _, _, found in numbers},
        gains=(0.0, 1.2 * max((_percentile(found.absorbed[:, i], 98) for *_, i, found in numbers), default=1.0)),
        path=_positions(first.states),
    )


def _draw_measured(drawing: Drawing, measured: Mapping[str, Measured], states: Sequence[str]) -> None:
    for sensor, found in measured.items():
        for name in (name for name in found.values if name in states):
            at = f"log/measured/{sensor}/{name}"
            drawing.dots(at, found.t_ns, found.values[name], color=RAW, label=f"{sensor}, raw")
        drawing.points(f"log/measured/{sensor}/position", _positions(found.values), color=RAW, radius=1.5)
        if set(BEACON) <= set(found.values):
            places = np.unique(np.stack([found.values[axis] for axis in BEACON], axis=1), axis=0)
            drawing.points(f"log/measured/{sensor}/beacons", places, color=RAW, radius=6)


def _draw_truth(drawing: Drawing, true: Truth, states: Sequence[str]) -> None:
    drawing.path("log/truth", true.t_ns, _positions(true.values), color=TRUTH, width=3.5)
    for state in (state for state in states if _name(state) in true.values):
        values = true.values[_name(state)]
        drawing.line(f"log/truth/states/{state}", true.t_ns, values, color=TRUTH, label="truth", width=3)


def _draw_run(drawing: Drawing, run: Run) -> None:
    at, t_ns, states = f"runs/{run.name}", run.results.t_ns, run.states
    positions = _positions(states)
    drawing.path(at, t_ns, positions, color=run.color, width=1.5)
    if len(positions):
        drawing.ellipses(f"{at}/ellipses", positions, run.horizontal_covariance, color=run.color)
    for state, value in states.items():
        reach = 2 * run.sd(state)
        drawing.band(f"{at}/states/{state}/band", t_ns, value - reach, value + reach, color=run.color, label=run.name)
        drawing.line(f"{at}/states/{state}/estimate", t_ns, value, color=run.color, label=run.name)
    for sensor, name, i, found in run.numbers:
        number, reach = f"{sensor}.{name}", 2 * np.sqrt(found.innovation_variance[:, i])
        innovations = f"{at}/innovations/{number}"
        drawing.dots(f"{innovations}/samples", found.t_ns, found.innovation[:, i], color=run.color, label=run.name)
        drawing.band(f"{innovations}/band", found.t_ns, -reach, reach, color=run.color, label=run.name)
        gain, label = found.absorbed[:, i], f"{run.name} {number}"
        drawing.line(f"{at}/gains/{number}", found.t_ns, gain, color=run.color, label=label)
    for sensor, found in {sensor: found for sensor, *_, found in run.numbers}.items():
        _draw_nis(drawing, run, sensor, found)


def _draw_nis(drawing: Drawing, run: Run, sensor: str, found: Decisions) -> None:
    at, refused = f"runs/{run.name}/nis/{sensor}", np.flatnonzero(found.decision != Decision.FUSED)
    drawing.dots(f"{at}/samples", found.t_ns, found.nis, color=run.color, label=run.name)
    if len(refused):
        stamps, label = found.t_ns[refused], f"{run.name}, not used"
        drawing.dots(f"{at}/unused", stamps, found.nis[refused], color=REFUSED, label=label, size=4)
    ends, dof = found.t_ns[[0, -1]], _dof(found)
    drawing.line(f"bounds/{sensor}/dof", ends, np.full(2, float(dof)), color=RAW, label=f"mean wanted: {dof}")
    drawing.line(f"bounds/{sensor}/upper", ends, np.full(2, _bound(found)), color=REFUSED, label=f"{_BOUND:.0%}")


def _span_of_state(run: Run, measured: Mapping[str, Measured], state: str) -> tuple[float, float]:
    """What an axis should show, without the transient at the start."""
    value, reach = run.states[state], 2 * run.sd(state)
    parts = [value - reach, value + reach, *(m.values[state] for m in measured.values() if state in m.values)]
    low, high = min(_percentile(part, 1) for part in parts), max(_percentile(part, 99) for part in parts)
    margin = 0.15 * max(high - low, 1e-6)
    return low - margin, high + margin


def _span_of_innovation(found: Decisions, i: int) -> tuple[float, float]:
    reach = 4 * float(np.sqrt(max(_percentile(found.innovation_variance[:, i], 50), 1e-18)))
    return -reach, reach


def _percentile(values: Floats, percent: float) -> float:
    good = values[np.isfinite(values)]
    return float(np.percentile(good, percent)) if len(good) else 0.0


def _dof(found: Decisions) -> int:
    return max(int(found.dof.max(initial=1)), 1)


def _bound(found: Decisions) -> float:
    return chi_square_quantile(_BOUND, _dof(found))


def _positions(values: Mapping[str, Floats]) -> Floats:
    """Positions (n, 3) in m; none where x or y is missing."""
    if "x" not in values or "y" not in values:
        return np.empty((0, 3))
    return np.stack([values["x"], values["y"], values.get("z", np.zeros_like(values["x"]))], axis=1)


def _name(state: str) -> str:
    """How a truth calls a state."""
    return SAME_QUANTITY.get(state, state)
