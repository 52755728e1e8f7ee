"""Runs as a Rerun recording: path, states, innovations, NIS and gains over the stamps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from fuselog.fusion.gate import chi_square_quantile
from fuselog.fusion.track import unpack
from fuselog.replay import open_log
from fuselog.service.runs import Decisions, Run, Series, load_measured, load_run, load_truth
from fuselog.service.view_layout import Shown, layout

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Color = tuple[int, int, int]

RAW: Color = (150, 150, 150)
TRUTH: Color = (70, 200, 110)
REFUSED: Color = (235, 70, 70)
RUNS: tuple[Color, ...] = ((80, 160, 255), (255, 160, 50), (190, 120, 255), (60, 210, 210))
_MOST_VERTICES = 50_000  # of a path; a longer one is thinned
_ELLIPSES = 60  # of a path
_PROBABILITY = 0.95  # of the bounds on NIS


def write_recording(
    path: Path, *, outs: Sequence[Path], log: Path | None = None, truth: str | None = None
) -> None:
    """Write a recording (.rrd) of output logs ``outs``, over the ``log`` that they were made from where it is given.

    ``truth`` is a topic with poses or fixes; by default one whose name says so. All is over the timeline ``stamp``,
    and comes with its layout. Raises ``LogError`` and ``ConfigError``.
    """
    runs = [load_run(out) for out in outs]
    measured: dict[str, Series] = {}
    true = None
    if log is not None:
        with open_log(log) as opened:
            measured = load_measured(opened, runs[0].plan)
            true = load_truth(opened, runs[0], truth)
    with rr.RecordingStream("fuselog", recording_id=path.stem) as to:
        to.save(path, default_blueprint=layout(_shown(runs, measured, true)))
        to.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        _log_measured(to, measured, runs[0].plan.states)
        if true is not None:
            _log_truth(to, true)
        for run, color in zip(runs, _colors(len(runs)), strict=True):
            _log_run(to, run, color)
        to.flush()


def _shown(runs: Sequence[Run], measured: Mapping[str, Series], true: Series | None) -> Shown:
    plan = runs[0].plan
    seen = [state for state in plan.states if any(state in series.names for series in measured.values())]
    known = [state for state in plan.states if true is not None and state in true.names]
    return Shown(
        runs=tuple(run.name for run in runs),
        states=dict(plan.card.states),
        main_states=tuple(dict.fromkeys([*seen, *known, *plan.states]))[:2],
        numbers=tuple((d.sensor, name) for d in runs[0].decisions for name in d.names),
        path=_positions(runs[0].states),
    )


def _colors(count: int) -> list[Color]:
    return [RUNS[i % len(RUNS)] for i in range(count)]


def _log_measured(to: rr.RecordingStream, measured: Mapping[str, Series], states: Sequence[str]) -> None:
    for sensor, series in measured.items():
        for name in series.names:
            if name in states:
                style = rr.SeriesPoints(
                    colors=RAW, markers="circle", marker_sizes=1.6, names=f"{sensor}, raw"
                )
                _send(to, f"measured/{sensor}/{name}", series.t_ns, series[name], style)
        if {"x", "y"} <= set(series.names):
            points = _positions(series)
            to.log(
                f"measured/{sensor}/position",
                rr.Points3D(points, colors=RAW, radii=rr.Radius.ui_points(2)),
                static=True,
            )
        if "beacon_x" in series.names:
            places = np.unique(series.values[:, -3:], axis=0)
            beacons = rr.Points3D(places, colors=RAW, radii=rr.Radius.ui_points(6))
            to.log(f"measured/{sensor}/beacons", beacons, static=True)


def _log_truth(to: rr.RecordingStream, true: Series) -> None:
    _log_path(to, "truth", true, TRUTH, width=3.0)
    for state in true.names:
        _send(
            to,
            f"truth/states/{state}",
            true.t_ns,
            true[state],
            rr.SeriesLines(colors=TRUTH, widths=2.5, names="truth"),
        )


def _log_run(to: rr.RecordingStream, run: Run, color: Color) -> None:
    _log_path(to, run.name, run.states, color, width=1.5)
    _log_ellipses(to, run, color)
    for state in run.plan.states:
        value, reach = run.states[state], 2 * run.sd(state)
        at = f"{run.name}/states/{state}"
        _send(to, at, run.states.t_ns, value, rr.SeriesLines(colors=color, widths=1.5, names=run.name))
        _send_pair(
            to, f"{at}/band", run.states.t_ns, value - reach, value + reach, _faint(color), f"{run.name} ± 2σ"
        )
    for decisions in run.decisions:
        _log_decisions(to, run.name, decisions, color)


def _log_decisions(to: rr.RecordingStream, run: str, made: Decisions, color: Color) -> None:
    for column, name in enumerate(made.names):
        number, reach = f"{made.sensor}.{name}", 2 * made.innovation_sd[:, column]
        points = rr.SeriesPoints(colors=color, markers="circle", marker_sizes=1.6, names=run)
        _send(to, f"{run}/innovations/{number}", made.t_ns, made.innovation[:, column], points)
        _send_pair(
            to, f"{run}/innovations/{number}/band", made.t_ns, -reach, reach, _faint(color), f"{run} ± 2σ"
        )
        line = rr.SeriesLines(colors=color, widths=1.5, names=f"{run} {number}")
        _send(to, f"{run}/gains/{number}", made.t_ns, made.absorbed[:, column], line)
    nis = rr.SeriesPoints(colors=color, markers="circle", marker_sizes=1.6, names=run)
    _send(to, f"{run}/nis/{made.sensor}", made.t_ns, made.nis, nis)
    refused = np.flatnonzero(made.decision != 0)
    if len(refused):
        cross = rr.SeriesPoints(colors=REFUSED, markers="cross", marker_sizes=4, names=f"{run}, not used")
        _send(to, f"{run}/nis/{made.sensor}/refused", made.t_ns[refused], made.nis[refused], cross)
    if len(made.t_ns):
        dof, ends = len(made.names), made.t_ns[[0, -1]]
        for label, level in ((f"dof {dof}", float(dof)), ("95 %", chi_square_quantile(_PROBABILITY, dof))):
            line = rr.SeriesLines(colors=RAW, widths=1.0, names=label)
            _send(to, f"bounds/nis/{made.sensor}/{label}", ends, np.full(2, level), line)


def _log_path(to: rr.RecordingStream, at: str, states: Series, color: Color, *, width: float) -> None:
    """The whole way as a line, and a point that moves along it."""
    points = _positions(states)
    if not len(points):
        return
    few = slice(None, None, len(points) // _MOST_VERTICES + 1)
    to.log(
        f"{at}/path",
        rr.LineStrips3D([points[few]], colors=color, radii=rr.Radius.ui_points(width)),
        static=True,
    )
    to.log(f"{at}/position", rr.Points3D.from_fields(colors=color, radii=rr.Radius.ui_points(5)), static=True)
    to.send_columns(f"{at}/position", [_time(states.t_ns[few])], rr.Points3D.columns(positions=points[few]))


def _log_ellipses(to: rr.RecordingStream, run: Run, color: Color) -> None:
    """Horizontal 2 sigma ellipses along the path."""
    points, names = _positions(run.states), run.plan.states
    if not len(points):
        return
    turn = np.linspace(0, 2 * np.pi, 33)
    circle, plane = 2 * np.stack([np.cos(turn), np.sin(turn)]), [names.index("x"), names.index("y")]
    strips: list[Floats] = []
    for row in range(0, len(points), len(points) // _ELLIPSES + 1):
        spread, axes = np.linalg.eigh(unpack(run.covariance[row], len(names))[np.ix_(plane, plane)])
        strip = np.tile(points[row], (len(turn), 1))
        strip[:, :2] += ((axes * np.sqrt(np.maximum(spread, 0))) @ circle).T
        strips.append(strip)
    lines = rr.LineStrips3D(strips, colors=_faint(color), radii=rr.Radius.ui_points(1))
    to.log(f"{run.name}/ellipses", lines, static=True)


def _positions(states: Series) -> Floats:
    """Positions (n, 3) in m; none for a model without x and y."""
    if not {"x", "y"} <= set(states.names):
        return np.empty((0, 3))
    z = states["z"] if "z" in states.names else np.zeros(len(states.t_ns))
    return np.stack([states["x"], states["y"], z], axis=1)


def _send(
    to: rr.RecordingStream, at: str, t_ns: Ints, values: Floats, style: "rr.SeriesLines | rr.SeriesPoints"
) -> None:
    """One number over time; rows without one are left out."""
    good = np.flatnonzero(np.isfinite(values))
    to.log(at, style, static=True)
    to.send_columns(at, [_time(t_ns[good])], rr.Scalars.columns(scalars=values[good]))


def _send_pair(
    to: rr.RecordingStream, at: str, t_ns: Ints, low: Floats, high: Floats, color: Color, name: str
) -> None:
    """Two numbers over time, drawn alike."""
    good = np.flatnonzero(np.isfinite(low) & np.isfinite(high))
    both = np.stack([low[good], high[good]], axis=1)
    to.log(at, rr.SeriesLines(colors=[color, color], widths=[0.8, 0.8], names=[name, name]), static=True)
    columns = rr.Scalars.columns(scalars=both.ravel()).partition(np.full(len(good), 2))
    to.send_columns(at, [_time(t_ns[good])], columns)


def _time(t_ns: Ints) -> rr.TimeColumn:
    return rr.TimeColumn("stamp", timestamp=t_ns.astype("datetime64[ns]"))


def _faint(color: Color) -> Color:
    return color[0] * 6 // 10, color[1] * 6 // 10, color[2] * 6 // 10
