"""``fuselog verify``: proof that live and offline are the same bytes."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fuselog.service.console import print_json, stderr
from fuselog.service.limits import with_limits

if TYPE_CHECKING:
    from fuselog.replay.mcap_file.decompress import Limits
    from fuselog.service.verify import Difference, Verdict


@with_limits
def verify(
    config: Annotated[Path, typer.Argument(help="The fusion configuration (YAML).")],
    logs: Annotated[list[str], typer.Argument(metavar="LOG...", help="MCAP logs, or folders of rosbag2, as one.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    *,
    limits: "Limits",
) -> None:
    """Fuse a log offline and by a service over Zenoh, and compare every byte that they publish.

    Exit 4 when anything differs; the first message that does is shown.
    """
    from fuselog.fusion import load_plan  # noqa: PLC0415  slow to import
    from fuselog.replay import open_log  # noqa: PLC0415  slow to import
    from fuselog.service.verify import verify as compare  # noqa: PLC0415  slow to import

    plan = load_plan(config)
    with open_log(*logs, limits=limits) as log:
        verdict = compare(log, plan, say=stderr.print)
        losses = log.losses
    if as_json:
        print_json(verdict.to_json())
    else:
        _print(verdict)
    for loss in losses:
        stderr.print(f"lost: {loss}")
    if not verdict.equal:
        raise typer.Exit(4)
    if losses:
        raise typer.Exit(3)


def _print(verdict: "Verdict") -> None:
    for topic, kept in verdict.topics.items():
        typer.echo(f"{topic:32} {kept['messages']:>9} messages  sha256 {kept['sha256'][:16]}")
    for difference in verdict.differences:
        _show(difference)
    said = "equal: live and offline are the same bytes" if verdict.equal else "live and offline differ"
    typer.echo(f"{said} ({verdict.messages} messages fused)")


def _show(difference: "Difference") -> None:
    when = "" if difference.t_ns is None else f" at {difference.t_ns / 1e9:.9f} s"
    typer.echo(f"{difference.topic}: message {difference.message}{when} differs")
    live, offline = difference.live, difference.offline
    if live is None or offline is None:
        return
    for name in live.keys() | offline.keys():
        if live.get(name) != offline.get(name):
            typer.echo(f"  {name:24} live {live.get(name)!r}  offline {offline.get(name)!r}")
