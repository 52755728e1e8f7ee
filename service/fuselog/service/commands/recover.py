"""``fuselog recover``: what can be read of a damaged log, as a sound one."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fuselog.service.console import print_json, printable
from fuselog.service.limits import with_limits

if TYPE_CHECKING:
    from fuselog.replay.mcap_file.decompress import Limits
    from fuselog.replay.recover import Recovery


@with_limits
def recover(
    log: Annotated[Path, typer.Argument(help="The damaged MCAP log; it is not changed.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Where to write what can be read (MCAP).")],
    *,
    trust_damaged: Annotated[
        bool, typer.Option("--trust-damaged", help="Take also what a checksum says is wrong.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the output if it is there.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    limits: "Limits",
) -> None:
    """Rescue all that can be read of a log, down to the readable part of a chunk that the file cuts.

    The output is read back before it appears. Exits 0 when nothing was lost, 3 when anything was, and 1
    without an output when nothing could be read.
    """
    from fuselog.replay.recover import recover as rescue  # noqa: PLC0415  slow to import

    if output.exists() and log.exists() and output.samefile(log):
        raise typer.BadParameter("it is the input", param_hint="--output")
    if output.exists() and not force:
        raise typer.BadParameter(f"{printable(str(output))} is there already (--force)", param_hint="--output")
    found = rescue(log, output, limits=limits, trust_damaged=trust_damaged, force=force)
    if as_json:
        print_json(found.to_json())
    else:
        _print(found)
    if found.lossy:
        raise typer.Exit(3)


def _print(found: "Recovery") -> None:
    names = [printable(topic.topic) for topic in found.topics]
    wide = max([5, *map(len, names)])
    typer.echo(f"{'topic':{wide}}  {'kept':>9} {'known lost':>10}  type")
    for name, topic in zip(names, found.topics, strict=True):
        typer.echo(f"{name:{wide}}  {topic.kept:>9} {topic.lost:>10}  {printable(topic.type)}")
    for damage in found.damages:
        where = f"bytes {damage.begin} to {damage.end}" if damage.end else "all of the log"
        known = f" ({damage.messages} messages)" if damage.messages else ""
        typer.echo(f"{'lost' if damage.lost else 'mended'}: {where}: {printable(damage.reason)}{known}")
    more = f", {found.attachments} attachments, {found.metadata} metadata records"
    typer.echo(f"wrote {printable(found.output)}: {found.messages} messages{more}, read back with the same hash")
