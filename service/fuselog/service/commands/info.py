"""``fuselog info``: what a log holds."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuselog.service.console import print_json, printable
from fuselog.service.limits import with_limits

if TYPE_CHECKING:
    from fuselog.replay.mcap_file.decompress import Limits


@with_limits
def info(
    logs: Annotated[list[str], typer.Argument(metavar="LOG...", help="MCAP logs, or folders of rosbag2: read as one.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    *,
    limits: "Limits",
) -> None:
    """Read whole logs; list topics with types, counts, rates and gaps, and everything that is damaged."""
    from fuselog.replay import open_log  # noqa: PLC0415  slow to import
    from fuselog.replay.mcap_file.file import McapFile  # noqa: PLC0415  slow to import
    from fuselog.replay.mcap_file.file_layout import describe  # noqa: PLC0415  slow to import
    from fuselog.replay.survey import survey  # noqa: PLC0415  slow to import

    with open_log(*logs, limits=limits) as opened:
        local = [part.path for part in opened.parts if isinstance(part, McapFile) and not part.remote]
        found = survey(opened).to_json() | {"files": [describe(path).to_json() for path in local]}
    if as_json:
        print_json(found)
    else:
        _print(found)
    if found["losses"]:
        raise typer.Exit(3)


def _print(found: dict[str, Any]) -> None:
    typer.echo(f"{printable(found['path'])}: {found['messages']} messages in {found['seconds']:.3f} s")
    for file in found["files"]:
        _print_file(file, named=len(found["files"]) > 1)
    names = [printable(topic["topic"]) for topic in found["topics"]]
    wide = max([5, *map(len, names)])
    typer.echo(f"{'topic':{wide}}  {'messages':>9} {'rate Hz':>9} {'longest gap s':>14}  type")
    for name, topic in zip(names, found["topics"], strict=True):
        rate = f"{topic['rate_hz']:.2f}" if topic["rate_hz"] else "-"
        gap = f"{topic['longest_gap_s']:.3f}" if topic["longest_gap_s"] is not None else "-"
        typer.echo(f"{name:{wide}}  {topic['messages']:>9} {rate:>9} {gap:>14}  {printable(topic['type'])}")
    for loss in found["losses"]:
        typer.echo(printable(f"lost: {loss['path']}: byte {loss['offset']}: {loss['reason']}"))


def _print_file(found: dict[str, Any], *, named: bool) -> None:
    name = f"{found['path']}: " * named
    written = f", profile {found['profile']}" * bool(found["profile"]) + f", by {found['library']}" * bool(
        found["library"]
    )
    typer.echo(printable(f"{name}{found['bytes']} bytes{written}{', truncated' * found['truncated']}"))
    if found["chunks"]:
        kinds = ", ".join(f"{count} {name}" for name, count in found["compression"].items())
        least, median, most = found["chunk_bytes"]
        ratio = found["unpacked_bytes"] / max(found["packed_bytes"], 1)
        sizes = f"{least} to {most} bytes, median {median}, {ratio:.2f} times the packed size"
        typer.echo(printable(f"{found['chunks']} chunks ({kinds}) of {sizes}"))
    for attachment in found["attachments"]:
        about = f"{attachment['name']} ({attachment['media_type']}, {attachment['bytes']} bytes)"
        typer.echo(printable(f"attachment: {about}"))
    for name in found["metadata"]:
        typer.echo(printable(f"metadata: {name}"))
