"""The layout of a recording: an overview first, then every state, innovation, NIS and gain."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

Span = tuple[float, float]  # of an axis

_STRIP = 4.0  # a path this many times longer than wide is shown across the whole window
_FIELD = 0.95  # height of what an eye sees, a little less, for each metre that it is away


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """What there is to see, and what its axes span at first."""

    runs: tuple[str, ...]
    units: Mapping[str, str]  # by state
    main_states: tuple[str, ...]  # those of the overview
    states: Mapping[str, Span]
    numbers: Mapping[tuple[str, str], Span]  # innovations by sensor and number
    nis: Mapping[str, Span]  # by sensor
    gains: Span
    path: NDArray[np.float64]  # (n, 3) m; none for a model without a position


def layout(shown: Shown) -> rrb.Blueprint:
    """Tabs: overview, states, innovations, consistency."""
    nis = [_nis(shown, sensor, legend=True) for sensor in shown.nis]
    return rrb.Blueprint(
        rrb.Tabs(
            _overview(shown),
            rrb.Grid(*(_state(shown, state) for state in shown.states), name="States"),
            rrb.Grid(*(_innovation(shown, *n, legend=True) for n in shown.numbers), name="Innovations"),
            rrb.Grid(*nis, _gains(shown, legend=True), name="NIS and gains"),
        ),
        rrb.TimePanel(timeline="stamp", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _overview(shown: Shown) -> rrb.Vertical | rrb.Horizontal:
    states = [_state(shown, state) for state in shown.main_states]
    innovations = [_innovation(shown, *number, legend=False) for number in list(shown.numbers)[:2]]
    nis = [_nis(shown, sensor, legend=False) for sensor in list(shown.nis)[:1]]
    below = rrb.Horizontal(*innovations, *nis, _gains(shown, legend=False))
    if not len(shown.path):
        return rrb.Vertical(rrb.Horizontal(*states), below, row_shares=[4, 3], name="Overview")
    length, width = np.ptp(shown.path, axis=0)[:2]
    if length > _STRIP * width:
        path = _path(shown, aspect=11.0)
        return rrb.Vertical(path, rrb.Horizontal(*states), below, row_shares=[1.5, 4, 3], name="Overview")
    path = _path(shown, aspect=1.0)
    upper = rrb.Horizontal(path, rrb.Vertical(*states), column_shares=[1, 1])
    return rrb.Vertical(upper, below, row_shares=[5, 2], name="Overview")


def _path(shown: Shown, *, aspect: float) -> rrb.Spatial3DView:
    """The way from above, all of it in a view ``aspect`` times as wide as high."""
    low, high = shown.path.min(axis=0), shown.path.max(axis=0)
    middle, (length, width, _) = (low + high) / 2, high - low
    above = max(length / aspect, width, 1.0) / _FIELD
    return rrb.Spatial3DView(
        origin="/",
        contents=["+ /**", "- /bounds/**"],
        name="Path from above (m), ellipses 2σ",
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=middle + np.array([0, 0, above]), look_target=middle, eye_up=(0, 1, 0), kind="Orbital"
        ),
    )


def _state(shown: Shown, state: str) -> rrb.TimeSeriesView:
    contents = [f"+ /log/measured/{sensor}/{name}" for sensor, name in shown.numbers if name == state]
    contents += [f"+ /log/truth/states/{state}", *(f"+ /runs/{run}/states/{state}/**" for run in shown.runs)]
    return _plot(f"{state} ({shown.units[state]}) ± 2σ", contents, shown.states[state], legend=True)


def _innovation(shown: Shown, sensor: str, number: str, *, legend: bool) -> rrb.TimeSeriesView:
    contents = [f"+ /runs/{run}/innovations/{sensor}.{number}/**" for run in shown.runs]
    span = shown.numbers[sensor, number]
    return _plot(f"Innovation {sensor}.{number} in ± 2σ", contents, span, legend=legend)


def _nis(shown: Shown, sensor: str, *, legend: bool) -> rrb.TimeSeriesView:
    contents = [f"+ /bounds/{sensor}/**", *(f"+ /runs/{run}/nis/{sensor}/**" for run in shown.runs)]
    return _plot(f"NIS {sensor}, 95 % below red", contents, shown.nis[sensor], legend=legend)


def _gains(shown: Shown, *, legend: bool) -> rrb.TimeSeriesView:
    contents = [f"+ /runs/{run}/gains/**" for run in shown.runs]
    return _plot("Share of innovation absorbed", contents, shown.gains, legend=legend)


def _plot(name: str, contents: list[str], span: Span, *, legend: bool) -> rrb.TimeSeriesView:
    always = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=name,
        axis_x=rrb.TimeAxis(view_range=always),
        axis_y=rrb.ScalarAxis(range=span),
        plot_legend=rrb.PlotLegend(corner="RightTop", visible=legend),
    )
