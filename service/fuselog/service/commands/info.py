"""``fuselog info``: what a log holds."""

from typing import Annotated, Any

import typer

from fuselog.service.console import print_json


def info(
    logs: Annotated[list[str], typer.Argument(metavar="LOG...", help="MCAP logs, or folders of rosbag2: read as one.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Read whole logs; list topics with types, counts, rates and gaps, and everything that is damaged."""
    from fuselog.replay import open_log  # noqa: PLC0415  slow to import
    from fuselog.replay.survey import survey  # noqa: PLC0415  slow to import

    with open_log(*logs) as opened:
        found = survey(opened).to_json()
    if as_json:
        print_json(found)
    else:
        _print(found)
    if found["losses"]:
        raise typer.Exit(3)


def _print(found: dict[str, Any]) -> None:
    typer.echo(f"{found['path']}: {found['messages']} messages in {found['seconds']:.3f} s")
    wide = max([5, *(len(topic["topic"]) for topic in found["topics"])])
    typer.echo(f"{'topic':{wide}}  {'messages':>9} {'rate Hz':>9} {'longest gap s':>14}  type")
    for topic in found["topics"]:
        rate = f"{topic['rate_hz']:.2f}" if topic["rate_hz"] else "-"
        gap = f"{topic['longest_gap_s']:.3f}" if topic["longest_gap_s"] is not None else "-"
        typer.echo(f"{topic['topic']:{wide}}  {topic['messages']:>9} {rate:>9} {gap:>14}  {topic['type']}")
    for loss in found["losses"]:
        typer.echo(f"lost: {loss['path']}: byte {loss['offset']}: {loss['reason']}")
