"""Pictures as inline SVG that is readable on light and on dark pages, the same bytes every time."""
# matplotlib is partly typed.
# pyright: reportUnknownMemberType=false, reportMissingImports=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

import importlib.util
import io
import re
from collections.abc import Mapping
from html import escape
from types import MappingProxyType
from typing import Any

from fuselog.replay.articles.result import Panel, Picture
from fuselog.schemas import FuselogError

_INK = "#010203"  # becomes the colour of the page's text
_WIDE, _HIGH = 11.0, 3.1  # inches, of a row of panels
_MAP = 0.55  # width of a map, of that of another panel
_STYLES = MappingProxyType(
    {
        "truth": {"color": _INK, "linewidth": 1.1, "zorder": 3},
        "measured": {"color": "#8b94a3", "linestyle": "none", "marker": ".", "markersize": 3.5, "zorder": 1},
        "fused": {"color": "#2f7fe0", "linewidth": 1.5, "zorder": 4},
        "other": {"color": "#d9822b", "linewidth": 1.2, "zorder": 2},
        "wrong": {"color": "#d64550", "linewidth": 1.2, "zorder": 2},
    }
)
_LOOK: Mapping[str, Any] = MappingProxyType(
    {
        "svg.fonttype": "none",
        "font.size": 9,
        "axes.edgecolor": _INK,
        "axes.labelcolor": _INK,
        "axes.linewidth": 0.6,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": "#8b94a3",
        "grid.alpha": 0.25,
        "grid.linewidth": 0.5,
        "text.color": _INK,
        "xtick.color": _INK,
        "ytick.color": _INK,
        "axes.unicode_minus": True,
        "legend.frameon": False,
        "path.simplify": True,
    }
)


class PicturesError(FuselogError):
    """matplotlib is not installed."""

    def __init__(self) -> None:
        super().__init__("pictures need matplotlib: pip install 'fuselog[pictures]'")


def check_pictures() -> None:
    """Raise ``PicturesError`` if pictures cannot be drawn."""
    if importlib.util.find_spec("matplotlib") is None:
        raise PicturesError


def draw(picture: Picture) -> str:
    """A picture as an ``<svg>`` element."""
    import matplotlib as mpl  # noqa: PLC0415  an extra, and slow to import
    from matplotlib.backends.backend_svg import FigureCanvasSVG  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    look: dict[Any, Any] = {**_LOOK, "svg.hashsalt": picture.name}
    with mpl.rc_context(look):
        figure = Figure(figsize=(_WIDE, _HIGH), layout="constrained")
        FigureCanvasSVG(figure)
        ratios = [_MAP if panel.plan else 1.0 for panel in picture.panels]
        axes = figure.subplots(1, len(picture.panels), squeeze=False, width_ratios=ratios)[0]
        for panel, axis in zip(picture.panels, axes, strict=True):
            _plot(panel, axis)
        written = io.StringIO()
        figure.savefig(written, format="svg", transparent=True, metadata={"Date": None})
    return _inline(written.getvalue(), picture)


def _plot(panel: Panel, axis: Any) -> None:
    for line in panel.lines:
        axis.plot(line.x, line.y, label=line.label, **_STYLES[line.role])
    axis.set(xlabel=panel.x, ylabel=panel.y)
    if panel.plan:
        axis.set_aspect("equal", adjustable="box")
    axis.margins(x=0.01)
    axis.legend(
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=len(panel.lines),
        fontsize=8,
        handlelength=1.4,
        columnspacing=1.0,
        borderaxespad=0.2,
    )


def _inline(svg: str, picture: Picture) -> str:
    """Without what belongs to a file; as wide as the page allows, and named for those who cannot see it."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    box = re.search(r'viewBox="[^"]*"', svg)
    assert box is not None
    labels = ", ".join(dict.fromkeys(line.label for panel in picture.panels for line in panel.lines))
    head = f'<svg {box.group()} role="img" aria-label="{escape(f"{picture.name}: {labels}")}">'
    return (head + svg[svg.index(">") + 1 :]).replace(_INK, "currentColor")
