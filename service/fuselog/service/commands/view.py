"""``fuselog view``: output logs in the Rerun viewer."""

from pathlib import Path
from typing import Annotated

import typer

from fuselog.service.console import stderr


def view(
    outs: Annotated[list[Path], typer.Argument(help="Output logs of reprocess; several are drawn over each other.")],
    log: Annotated[Path | None, typer.Option(help="The log they were made from: raw measurements and truth.")] = None,
    truth: Annotated[
        str | None, typer.Option(help="Topic of the truth in LOG; by default one whose name says so.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The recording; by default beside the first output log."),
    ] = None,
    save_only: Annotated[bool, typer.Option("--save-only", help="Do not open the viewer.")] = False,
) -> None:
    """Write a Rerun recording of output logs and open it."""
    from fuselog.service.views.view import write_recording  # noqa: PLC0415  slow to import
    from fuselog.service.views.viewer import open_viewer  # noqa: PLC0415

    recording = output or outs[0].with_suffix(".rrd")
    write_recording(recording, outs=outs, log=log, truth=truth)
    typer.echo(f"wrote {recording}")
    if not save_only and not open_viewer(recording):
        stderr.print(f"no display here; elsewhere: rerun {recording}")
