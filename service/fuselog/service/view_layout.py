"""The layout of a recording: an overview first, then every state, innovation, NIS and gain."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """What there is to see."""

    runs: tuple[str, ...]
    states: Mapping[str, str]  # units by name
    main_states: tuple[str, ...]  # those of the overview
    numbers: tuple[tuple[str, str], ...]  # (sensor, measured number)
    path: NDArray[np.float64]  # (n, 3) m


def layout(shown: Shown) -> rrb.Blueprint:
    """Tabs: overview, states, innovations, consistency."""
    sensors = list(dict.fromkeys(sensor for sensor, _ in shown.numbers))
    innovations = [_innovation(shown, *number) for number in shown.numbers]
    consistency = [*(_nis(shown, sensor) for sensor in sensors), _gains(shown)]
    path = [_path(shown)] if len(shown.path) else []
    overview = rrb.Vertical(
        *path,
        rrb.Horizontal(*(_state(shown, state) for state in shown.main_states)),
        rrb.Horizontal(*innovations[:2], *consistency[:1], consistency[-1]),
        row_shares=[*([2.0] if path else []), 4.0, 3.0],
        name="Overview",
    )
    return rrb.Blueprint(
        rrb.Tabs(
            overview,
            rrb.Grid(*(_state(shown, state) for state in shown.states), name="States"),
            rrb.Grid(*innovations, name="Innovations"),
            rrb.Grid(*consistency, name="NIS and gains"),
        ),
        rrb.TimePanel(timeline="stamp", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _path(shown: Shown) -> rrb.Spatial3DView:
    """The way from above."""
    low, high = shown.path.min(axis=0), shown.path.max(axis=0)
    middle, size = (low + high) / 2, float(max((high - low)[:2].max(), 1.0))
    return rrb.Spatial3DView(
        origin="/",
        contents=["+ /**", *(f"- /**/{plot}/**" for plot in ("states", "innovations", "nis", "gains"))],
        name="Path from above (m) with 2σ ellipses",
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=middle + np.array([0, 0, size]), look_target=middle, eye_up=(0, 1, 0), kind="Orbital"
        ),
    )


def _state(shown: Shown, state: str) -> rrb.TimeSeriesView:
    raw = [f"+ /measured/{sensor}/{name}" for sensor, name in shown.numbers if name == state]
    ours = [f"+ /{run}/states/{state}/**" for run in shown.runs]
    return _plot(f"{state} ({shown.states[state]}) ± 2σ", [*raw, f"+ /truth/states/{state}", *ours])


def _innovation(shown: Shown, sensor: str, name: str) -> rrb.TimeSeriesView:
    contents = [f"+ /{run}/innovations/{sensor}.{name}/**" for run in shown.runs]
    return _plot(f"Innovation {sensor}.{name} in ± 2σ", contents)


def _nis(shown: Shown, sensor: str) -> rrb.TimeSeriesView:
    ours = [f"+ /{run}/nis/{sensor}/**" for run in shown.runs]
    return _plot(f"NIS {sensor}", [f"+ /bounds/nis/{sensor}/**", *ours])


def _gains(shown: Shown) -> rrb.TimeSeriesView:
    return _plot("Share of innovation absorbed", [f"+ /{run}/gains/**" for run in shown.runs])


def _plot(name: str, contents: list[str]) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin="/", contents=contents, name=name, plot_legend=rrb.Corner2D.RightTop)
