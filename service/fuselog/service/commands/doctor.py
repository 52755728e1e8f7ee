"""``fuselog doctor``: what is wrong with a log."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuselog.service.console import print_json, printable
from fuselog.service.limits import with_limits

if TYPE_CHECKING:
    from fuselog.replay.doctor import Finding
    from fuselog.replay.mcap_file.decompress import Limits

_COLUMNS = (
    ("messages", "messages", "d"),
    ("rate_hz", "rate Hz", ".2f"),
    ("longest_gap_s", "longest s", ".3f"),
    ("gaps", "gaps", "d"),
    ("jitter_s", "jitter s", ".4f"),
    ("skew_s", "skew s", ".4f"),
    ("drift_ppm", "drift ppm", ".0f"),
    ("late", "late", "d"),
    ("stamps_late", "stamps late", "d"),
    ("duplicate_stamps", "duplicates", "d"),
)


@with_limits
def doctor(
    log: Annotated[Path, typer.Argument(help="The MCAP log.")],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    limits: "Limits",
) -> None:
    """Read the whole log; list rhythm and clocks of each topic, all that is wrong, and what to do about it.

    Exits 3 when data are lost or damaged.
    """
    from fuselog.replay.doctor import examine  # noqa: PLC0415  slow to import

    found = examine(log, limits=limits)
    if as_json:
        print_json(found.to_json())
    else:
        typer.echo(f"{printable(str(log))}: {found.messages} messages, {found.bytes} bytes")
        _print_topics(found.topics)
        _print_findings(found.findings)
    if not found.sound:
        raise typer.Exit(3)


def _print_topics(topics: list[dict[str, Any]]) -> None:
    wide = max([5, *(len(printable(topic["topic"])) for topic in topics)])
    typer.echo(f"{'topic':{wide}}" + "".join(f"  {title:>11}" for _, title, _ in _COLUMNS))
    for topic in topics:
        cells = (_cell(topic[name], form) for name, _, form in _COLUMNS)
        typer.echo(f"{printable(topic['topic']):{wide}}" + "".join(f"  {cell:>11}" for cell in cells))


def _cell(value: float | None, form: str) -> str:
    return "-" if value is None or value != value else format(value, form)  # noqa: PLR0124  NaN


def _print_findings(findings: "list[Finding]") -> None:
    for finding in findings:
        when = "" if finding.t_ns is None else f", from {finding.t_ns * 1e-9:.3f} s"
        times = f" ({finding.count})" if finding.count > 1 else ""
        typer.echo(f"{finding.severity}: {printable(finding.place)}: {printable(finding.text)}{times}{when}")
        typer.echo(f"  {finding.advice}")
    errors = sum(finding.severity == "error" for finding in findings)
    warnings = sum(finding.severity == "warning" for finding in findings)
    typer.echo(f"{errors} errors, {warnings} warnings, {len(findings) - errors - warnings} notes")
