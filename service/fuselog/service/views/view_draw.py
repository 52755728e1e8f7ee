"""The few things that a recording is drawn with, each sent to Rerun as whole columns."""

from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Color = tuple[int, int, int]

_MOST_VERTICES: Final = 50_000  # of a path; a longer one is thinned
_ELLIPSES: Final = 60  # of a path


class Drawing:
    """A recording to draw on. Times are stamps in ns; rows that are not finite are left out."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def line(self, at: str, t_ns: Ints, values: Floats, *, color: Color, label: str, width: float = 1.5) -> None:
        """Numbers (n,) over time, joined."""
        self._scalars(at, t_ns, values[:, np.newaxis], rr.SeriesLines(colors=color, widths=width, names=label))

    def dots(self, at: str, t_ns: Ints, values: Floats, *, color: Color, label: str, size: float = 1.5) -> None:
        """Numbers (n,) over time, each for itself."""
        style = rr.SeriesPoints(colors=color, markers="circle", marker_sizes=size, names=label)
        self._scalars(at, t_ns, values[:, np.newaxis], style)

    def band(self, at: str, t_ns: Ints, low: Floats, high: Floats, *, color: Color, label: str) -> None:
        """Two limits (n,) over time, thin; one entry in the legend with the line of the same label."""
        style = rr.SeriesLines(colors=[color] * 2, widths=[0.5] * 2, names=[label] * 2)
        self._scalars(at, t_ns, np.stack([low, high], axis=1), style)

    def points(self, at: str, positions: Floats, *, color: Color, radius: float) -> None:
        """Positions (n, 3) at all times."""
        if len(positions):
            points = rr.Points3D(positions, colors=color, radii=rr.Radius.ui_points(radius))
            self._stream.log(at, points, static=True)

    def path(self, at: str, t_ns: Ints, positions: Floats, *, color: Color, width: float) -> None:
        """The whole way (n, 3) as a line, and a point that moves along it."""
        few = slice(None, None, len(positions) // _MOST_VERTICES + 1)
        positions, t_ns = positions[few], t_ns[few]
        if not len(positions):
            return
        way = rr.LineStrips3D([positions], colors=color, radii=rr.Radius.ui_points(width))
        self._stream.log(f"{at}/path", way, static=True)
        style = rr.Points3D.from_fields(colors=color, radii=rr.Radius.ui_points(4))
        self._stream.log(f"{at}/position", style, static=True)
        self._stream.send_columns(f"{at}/position", [_time(t_ns)], rr.Points3D.columns(positions=positions))

    def ellipses(self, at: str, positions: Floats, covariances: Floats, *, color: Color) -> None:
        """Horizontal 2 sigma ellipses of some of the positions (n, 3), by covariances (n, 2, 2)."""
        few = slice(None, None, len(positions) // _ELLIPSES + 1)
        spread, axes = np.linalg.eigh(covariances[few])
        turn = np.linspace(0, 2 * np.pi, 33)
        circle = 2 * np.stack([np.cos(turn), np.sin(turn)])
        strips = np.repeat(positions[few][:, np.newaxis], len(turn), axis=1)
        scaled = axes * np.sqrt(np.maximum(spread, 0))[:, np.newaxis, :]
        strips[:, :, :2] += (scaled @ circle).transpose(0, 2, 1)
        lines = rr.LineStrips3D(list(strips), colors=_dark(color), radii=rr.Radius.ui_points(1))
        self._stream.log(at, lines, static=True)

    def _scalars(self, at: str, t_ns: Ints, values: Floats, style: rr.SeriesLines | rr.SeriesPoints) -> None:
        """Rows of as many numbers (n, k) as the style has series."""
        good = np.flatnonzero(np.isfinite(values).all(axis=1))
        columns = rr.Scalars.columns(scalars=values[good].ravel())
        self._stream.log(at, style, static=True)
        rows = columns.partition(np.full(len(good), values.shape[1]))
        self._stream.send_columns(at, [_time(t_ns[good])], rows)


def _time(t_ns: Ints) -> rr.TimeColumn:
    return rr.TimeColumn("stamp", timestamp=t_ns.astype("datetime64[ns]"))


def _dark(color: Color) -> Color:
    return color[0] * 6 // 10, color[1] * 6 // 10, color[2] * 6 // 10
