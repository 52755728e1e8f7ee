"""Small tables for people: as text in a terminal, as HTML in a notebook."""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from html import escape
from typing import NamedTuple

_MOST_ROWS = 60


class Shown(NamedTuple):
    """A title, the names of the columns and their rows; what holds numbers is aligned to the right."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    right: frozenset[int] = frozenset()

    def text(self) -> str:
        """As lines of text, at most 60 rows."""
        rows = [self.head, *self.rows[:_MOST_ROWS]]
        wide = [max(len(row[k]) for row in rows) for k in range(len(self.head))]
        lines = [self.title] + ["  ".join(self._padded(row, wide)).rstrip() for row in rows if self.rows]
        return "\n".join(lines + self._rest())

    def html(self) -> str:
        """As an HTML table; everything in it is escaped."""
        head = "".join(f"<th>{escape(name)}</th>" for name in self.head)
        body = "".join(
            "<tr>" + "".join(self._cell(k, cell) for k, cell in enumerate(row)) + "</tr>"
            for row in self.rows[:_MOST_ROWS]
        )
        rest = "".join(f"<p>{escape(line)}</p>" for line in self._rest())
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>" if self.rows else ""
        return f"<div><p>{escape(self.title)}</p>{table}{rest}</div>"

    def _padded(self, row: Sequence[str], wide: Sequence[int]) -> list[str]:
        return [f"{cell:>{wide[k]}}" if k in self.right else f"{cell:{wide[k]}}" for k, cell in enumerate(row)]

    def _cell(self, column: int, cell: str) -> str:
        style = ' style="text-align: right"' if column in self.right else ""
        return f"<td{style}>{escape(cell)}</td>"

    def _rest(self) -> list[str]:
        return [f"... and {len(self.rows) - _MOST_ROWS} more"] if len(self.rows) > _MOST_ROWS else []


def clock(t_ns: int) -> str:
    """A time to the millisecond, UTC, such as ``2016-10-22 21:17:18.803 UTC``; seconds where it is no year of ours."""
    if not 10**18 <= t_ns < 1 << 62:  # before 2001: a clock that was never set, or a simulation
        return f"{t_ns * 1e-9:.3f} s"
    at = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=t_ns // 1000)
    return at.strftime("%Y-%m-%d %H:%M:%S.%f")[:-3] + " UTC"
